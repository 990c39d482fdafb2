"""Trust in a map, from its report on the trajectories that it was built on."""

from dataclasses import dataclass

from rholoc.maps.info import MapInfo


@dataclass(frozen=True)
class Trust:
    """Whether a map's frame poses passed every check.

    Attributes:
        trusted: None if unknown: it came as a table, or an early version built it.
        reasons: failed checks, one line each; or why the poses are trusted.
    """

    trusted: bool | None
    reasons: tuple[str, ...]

    @property
    def reason(self) -> str:
        """The failed checks, or why the poses are trusted, in one line."""
        return " ".join(self.reasons)


def trust_of(info: MapInfo) -> Trust:
    """Trust by the report on a map's trajectories and on its later learning: True only if no check failed."""
    report = info.report
    if all(trajectory.trusted is None for trajectory in report.trajectories):
        return Trust(None, ("The map does not say how its frame poses were checked.",))
    said = [(walk.trusted, walk.why) for walk in report.trajectories]
    said += [(walk.trusted, walk.why or "") for walk in report.learned]
    trusted = all(passed for passed, _ in said if passed is not None)
    whys = [why for passed, why in said if passed is trusted and why]
    return Trust(trusted, tuple(dict.fromkeys(whys)))


def expected_error_m(info: MapInfo) -> float | None:
    """Expected RMS position error of a map [m]; None if unknown or the map is not metric."""
    return info.report.expected_error.rms_m if info.metric and info.report.expected_error else None


def consistency_m(info: MapInfo) -> float | None:
    """Median distance of localized held-out frames from their poses in the walk [m]; None if unknown, or not metric."""
    return info.report.held_out.median_m if info.metric and info.report.held_out else None
