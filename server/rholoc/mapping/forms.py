"""The ``ray`` form that learning works on, and the way back to the form that a map has."""

from __future__ import annotations

from dataclasses import replace

from rholoc.mapping.report import map_statistics
from rholoc.mapping.tensor_fit import fit_map_tensors
from rholoc.maps import DensityKind, Map
from rholoc.progress import ProgressListener, silent
from rholoc.reports import LearningReport


def ray_form(map_: Map) -> Map:
    """The map without its tensors: they are a function of what it remembers."""
    return replace(map_, info=replace(map_.info, density=DensityKind.RAY), fitted=None)


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
    if before.fitted is not None:
        after = fit_map_tensors(after, before.fitted.degree, progress)
    return after
