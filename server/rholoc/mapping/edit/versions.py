"""The next version of a map that has learned or forgotten, or that somebody corrected."""

from __future__ import annotations

from dataclasses import replace

from rholoc.mapping.build.density_fitting import fit_densities
from rholoc.mapping.build.recursive_densities import with_learned_densities
from rholoc.mapping.build.self_report import map_statistics
from rholoc.maps import Correction, Map, MapInfo
from rholoc.progress import ProgressListener, silent
from rholoc.reports import LearningReport, MapReport

_MAX_CORRECTIONS = 1000  # that a map keeps
_MAX_LESSONS = 10


def as_learned(
    before: Map,
    after: Map,
    learned: LearningReport,
    progress: ProgressListener = silent,
    forgetting: float | None = None,
) -> Map:
    """The next version of a map: ``after``, of ``ray`` form, in the form that ``before`` has, its report brought up.

    ``learned`` says what was learned; the report keeps it. With ``forgetting`` ``observed`` densities go on from where
    they stand, one observation at a time; else all densities are fitted anew.
    """
    report = _brought_up(after, before.info.report)
    report = replace(report, learned=_without_old_lessons((*report.learned, learned)))
    after = replace(after, info=replace(after.info, version=learned.version, report=report))
    if forgetting is not None:
        return with_learned_densities(before, after, forgetting)
    return fit_densities(after, before.info.density, before.densities.degree, progress)


def _without_old_lessons(learned: tuple[LearningReport, ...]) -> tuple[LearningReport, ...]:
    """Without all but the last reports of what was learned from queries: there is one each night."""
    from_queries = [report for report in learned if report.queries is not None]
    old = from_queries[:-_MAX_LESSONS]
    return tuple(report for report in learned if report not in old)


def as_corrected(before: Map, after: Map, correction: Correction) -> Map:
    """The next version of a map that somebody corrected: ``after``, in the form that ``before`` has.

    ``correction`` says what was corrected; the map keeps it.
    """
    if after.info.density is not before.info.density:
        after = fit_densities(after, before.info.density, before.densities.degree)
    return replace(after, info=replace(noted(after.info, correction), report=_brought_up(after, after.info.report)))


def noted(info: MapInfo, correction: Correction) -> MapInfo:
    """A map's description with one correction more."""
    kept = (*info.corrections, correction)[-_MAX_CORRECTIONS:]
    return replace(info, version=correction.version, corrections=kept)


def _brought_up(map_: Map, report: MapReport) -> MapReport:
    """What a map says of itself, with what ``report`` says of how it was made."""
    return replace(
        map_statistics(map_),
        held_out=report.held_out,
        trajectories=report.trajectories,
        coaching=report.coaching,
        learned=report.learned,
    )
