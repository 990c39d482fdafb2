"""Next version of a map that has learned, forgotten, or been corrected."""

from dataclasses import replace
from datetime import UTC, datetime

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
    """Next version of a map that has learned: ``after`` (``ray`` form) in the form of ``before``, with an updated
    report.

    ``learned`` gives the version and is added to the report. With ``forgetting``, ``observed`` densities are updated
    recursively; without, all densities are fitted again. Raises Cancelled if ``progress`` asks to stop.
    """
    report = _brought_up(after, before.info.report)
    report = replace(report, learned=_without_old_lessons((*report.learned, learned)))
    created = datetime.now(UTC).isoformat(timespec="seconds")
    after = replace(after, info=replace(after.info, version=learned.version, created=created, report=report))
    if forgetting is not None:
        return with_learned_densities(before, after, forgetting)
    return fit_densities(after, before.info.density, before.densities.degree, progress)


def _without_old_lessons(learned: tuple[LearningReport, ...]) -> tuple[LearningReport, ...]:
    """Learning reports: all of recordings, and the last ten from queries, of which there is one a night."""
    from_queries = [report for report in learned if report.queries is not None]
    old = from_queries[:-_MAX_LESSONS]
    return tuple(report for report in learned if report not in old)


def as_corrected(before: Map, after: Map, correction: Correction) -> Map:
    """Next version of a map that was corrected: ``after`` in the form of ``before``, with ``correction`` recorded and
    its statistics updated.
    """
    if after.info.density is not before.info.density:
        after = fit_densities(after, before.info.density, before.densities.degree)
    return replace(after, info=replace(noted(after.info, correction), report=_brought_up(after, after.info.report)))


def noted(info: MapInfo, correction: Correction) -> MapInfo:
    """Description of a map with one more correction (keeps the last 1000), and the correction's version and time."""
    kept = (*info.corrections, correction)[-_MAX_CORRECTIONS:]
    return replace(info, version=correction.version, created=correction.created, corrections=kept)


def _brought_up(map_: Map, report: MapReport) -> MapReport:
    """Report on a map with its statistics updated and the rest taken from ``report``."""
    return replace(
        map_statistics(map_),
        held_out=report.held_out,
        trajectories=report.trajectories,
        coaching=report.coaching,
        learned=report.learned,
    )
