"""The next version of a map that has learned or forgotten."""

from __future__ import annotations

from dataclasses import replace

from rholoc.mapping.fitting import fit_densities
from rholoc.mapping.report import map_statistics
from rholoc.maps import Map
from rholoc.progress import ProgressListener, silent
from rholoc.reports import LearningReport


def as_learned(before: Map, after: Map, learned: LearningReport, progress: ProgressListener = silent) -> Map:
    """The next version of a map: ``after``, of ``ray`` form, in the form that ``before`` has, its report brought up.

    ``learned`` says what was learned; the report keeps it.
    """
    report = before.info.report
    report = replace(
        map_statistics(after),
        held_out=report.held_out,
        trajectories=report.trajectories,
        coaching=report.coaching,
        learned=(*report.learned, learned),
    )
    after = replace(after, info=replace(after.info, version=learned.version, report=report))
    return fit_densities(after, before.info.density, before.densities.degree, progress)
