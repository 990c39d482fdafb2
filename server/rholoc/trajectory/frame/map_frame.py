"""Align a reconstruction with the map frame by the most reliable measurements."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from rholoc.errors import MappingFailed
from rholoc.geometry import UP, FloatArray, Similarity, angles_between
from rholoc.recordings import Waypoint
from rholoc.trajectory.frame.upright import rotation_to_upright, up_without_roll
from rholoc.trajectory.frame.waypoint_alignment import UpMeasurement, WaypointAlignment, align_to_waypoints
from rholoc.trajectory.trajectory import Scale

_GRAVITY_SIGMA_DEG = 0.3  # not in the adjustment's covariance: mounting and model errors
_NO_ROLL_SIGMA_DEG = 1.5
_MAX_TILT_DEG = 15.0  # between the waypoints' z axis and the measured upward direction, for them to agree
_MAX_SCALE_SIGMA = 0.1  # relative, of a scale measurement that counts
_MAX_SCALE_CONTRADICTION = 0.15  # between waypoints and another measurement of the scale …
_SIGMAS = 4.0  # … and as many of the measurement's standard deviations
_CLEARER = 2.0  # by how much the best choice of pauses must fit better than the next …
_EXACT_M = 0.02  # … where residuals below this count as this


class ScaleSource(StrEnum):
    """What measured the scale of a reconstruction; values begin a sentence."""

    ACCELEROMETER = "The accelerometer"
    DEPTH = "Depth pictures"
    LENGTH = "A known length"
    ODOMETRY = "Odometry"
    MOUNTING = "The mounting of the cameras"


_WHY_OPEN = {
    ScaleSource.ACCELEROMETER: "the camera hardly sped up or slowed down. Start and stop more often.",
    ScaleSource.DEPTH: "they contradict the pictures. Check their unit, and that each belongs to its picture.",
    ScaleSource.ODOMETRY: "it contradicts the pictures. Check its unit, its axes and its clock.",
    ScaleSource.MOUNTING: "it contradicts the pictures. Check its unit and its direction, and that clocks agree.",
    ScaleSource.LENGTH: "it is too short for the reconstruction. Measure one between places that are further apart.",
}


@dataclass(frozen=True)
class ScaleMeasurement:
    """Measured scale of a reconstruction.

    Attributes:
        source: what measured it.
        ratio: metres in the reconstruction's unit of length.
        sigma: relative standard deviation of the ratio; inf if the measurement does not fix it.
        is_adjusted: whether the reconstruction's covariances include it already.
    """

    source: ScaleSource
    ratio: float
    sigma: float
    is_adjusted: bool = False

    @property
    def usable(self) -> bool:
        """Whether it is certain enough to fix the scale: a relative sigma of at most 0.1."""
        return self.sigma <= _MAX_SCALE_SIGMA

    def contradicts(self, ratio: float, sigma: float = 0.0) -> bool:
        """Whether this (usable) measurement differs from another ``ratio`` by more than 15 % and four standard
        deviations.

        ``sigma`` is the other ratio's relative standard deviation.
        """
        limit = max(_MAX_SCALE_CONTRADICTION, _SIGMAS * float(np.hypot(self.sigma, sigma)))
        return self.usable and abs(self.ratio / ratio - 1) > limit

    def verb(self, singular: str, plural: str) -> str:
        """``singular`` or ``plural``, whichever agrees with the source."""
        return plural if self.source is ScaleSource.DEPTH else singular


@dataclass(frozen=True, eq=False)
class MapFrame:
    """Alignment of a reconstruction with the map frame.

    Attributes:
        similarity: from the reconstruction's frame to the map frame.
        scale: whether lengths in the map frame are metres.
        upright: whether the z axis is known to point up.
        why_up, why_scale: one line each on what fixes them.
        waypoints: with the times at which the camera was there.
        tilt_deg: between the waypoints' z axis and the measured upward direction, or None.
        doubts: reasons not to trust the trajectory, one line each.
        scale_sigma: relative standard deviation of the scale, as far as the adjustment's covariances do not include it.
    """

    similarity: Similarity
    scale: Scale
    upright: bool
    why_up: str
    why_scale: str
    waypoints: tuple[Waypoint, ...] = ()
    tilt_deg: float | None = None
    doubts: tuple[str, ...] = ()
    scale_sigma: float = 0.0


def up_by_gravity() -> tuple[UpMeasurement, str]:
    """Upward direction (z) of a reconstruction levelled by the accelerometer, and one line on it."""
    return UpMeasurement(np.array([0.0, 0.0, 1.0]), _GRAVITY_SIGMA_DEG), "The accelerometer measured gravity."


def up_by_pictures(R_world_camera: FloatArray) -> tuple[UpMeasurement | None, str]:
    """Upward direction from rotations (K, 3, 3) by the no-roll prior, and one line on it; None if the prior fails."""
    prior = up_without_roll(R_world_camera)
    figures = f"the cameras' x axes are {prior.roll_deg:.1f}° off one plane and spread {prior.turn_deg:.0f}° in it"
    if prior.holds:
        return UpMeasurement(prior.direction, _NO_ROLL_SIGMA_DEG), f"By the no-roll prior: {figures}."
    return None, f"Unknown; the no-roll prior does not hold: {figures}."


def frame_of_first_camera(
    T_world_camera: FloatArray,
    up: UpMeasurement | None,
    why_up: str,
    median_depth: float,
    scales: Sequence[ScaleMeasurement] = (),
) -> MapFrame:
    """Map frame at the first of the cameras (N, 4, 4), which looks along x; upright if ``up`` is known, else z is that
    camera's up.

    Args:
        median_depth: of the landmarks, in the cameras' unit; the unit of length if no measurement fixes it.
        scales: scale measurements; the most certain one is used if usable, others that contradict it become doubts.
    """
    best = min(scales, key=lambda one: one.sigma, default=None)
    direction = None if up is None else up.direction
    if best is None or not best.usable:
        why = "Nothing measured fixes the scale; the unit is the median distance of the landmarks."
        if best is not None:
            by = f" ({best.sigma:.0%})" if np.isfinite(best.sigma) else ""
            why = f"{best.source} {best.verb('leaves', 'leave')} the scale open{by}: {_WHY_OPEN[best.source]}"
        similarity = _at_camera(T_world_camera[0], direction, 1 / median_depth)
        return MapFrame(similarity, Scale.ARBITRARY, up is not None, why_up, why)
    why = f"{best.source} {best.verb('fixes', 'fix')} the scale to {best.sigma:.1%}."
    doubts = _scale_contradictions(best.ratio, [one for one in scales if one is not best], best.sigma)
    similarity = _at_camera(T_world_camera[0], direction, best.ratio)
    sigma = 0.0 if best.is_adjusted else best.sigma
    why = " ".join([why, *doubts])
    return MapFrame(similarity, Scale.METRIC, up is not None, why_up, why, doubts=tuple(doubts), scale_sigma=sigma)


def frame_of_waypoints(
    times: FloatArray,
    T_world_camera: FloatArray,
    choices: Iterable[tuple[Waypoint, ...]],
    up: UpMeasurement | None,
    why_up: str,
    scales: Sequence[ScaleMeasurement] = (),
) -> MapFrame:
    """Map frame of the waypoints, from cameras (N, 4, 4) at ``times`` (N,) [s]; upright if ``up`` is within 15° of
    their z axis.

    Args:
        choices: the waypoints with their times; if these are unknown, all possible assignments to pauses. The best is
            used.
        up: upward direction in the frame of the cameras, or None.
        scales: other scale measurements; a contradiction to the waypoints becomes a doubt.

    Raises:
        MappingFailed: the camera's path misses the waypoints in all choices, or there is none.
    """
    waypoints, alignment, next_best_m = _best_choice(times, T_world_camera[:, :3, 3], choices)
    doubts = []
    tilt_deg = None
    if up is not None:
        tilt_deg = float(np.degrees(angles_between(alignment.similarity.rotation @ up.direction, UP)))
        if tilt_deg <= _MAX_TILT_DEG:
            alignment = align_to_waypoints(times, T_world_camera[:, :3, 3], waypoints, up)
        else:
            why_up += f" The waypoints' z axis is {tilt_deg:.0f}° off it, and was left there."
    if next_best_m < _CLEARER * max(alignment.worst_m, _EXACT_M):
        doubts.append("Other pauses than those taken fit the waypoints nearly as well; give the waypoints their times.")
    contradictions = _scale_contradictions(alignment.similarity.scale, scales)
    doubts += contradictions
    upright = tilt_deg is not None and tilt_deg <= _MAX_TILT_DEG
    why_scale = " ".join(["The waypoints fix the scale.", *contradictions])
    return MapFrame(alignment.similarity, Scale.METRIC, upright, why_up, why_scale, waypoints, tilt_deg, tuple(doubts))


def _best_choice(
    times: FloatArray, positions: FloatArray, choices: Iterable[Sequence[Waypoint]]
) -> tuple[tuple[Waypoint, ...], WaypointAlignment, float]:
    """Choice with the least maximum residual, its alignment, and the maximum residual [m] of the next best (inf if
    none). Raises MappingFailed if no choice fits.
    """
    found: list[tuple[float, tuple[Waypoint, ...], WaypointAlignment]] = []
    failure: MappingFailed | None = None
    for waypoints in choices:
        try:
            alignment = align_to_waypoints(times, positions, waypoints)
        except MappingFailed as error:
            failure = failure or error
            continue
        found.append((float(np.nanmax(alignment.residuals_m)), tuple(waypoints), alignment))
    if not found:
        raise failure or MappingFailed("No pauses fit the waypoints.", "Give the waypoints their times.")
    found.sort(key=lambda one: one[0])
    _, waypoints, alignment = found[0]
    return waypoints, alignment, found[1][0] if len(found) > 1 else np.inf


def _scale_contradictions(ratio: float, others: Sequence[ScaleMeasurement], sigma: float = 0.0) -> list[str]:
    """One line for each measurement that contradicts a scale of ``ratio`` m per unit with relative sigma ``sigma``:
    by more than 15 % and four sigmas.
    """
    return [
        f"{one.source} {one.verb('says', 'say')} that the walk is {one.ratio / ratio:.2f} times as large."
        for one in others
        if one.contradicts(ratio, sigma)
    ]


def _at_camera(T_world_camera: FloatArray, up: FloatArray | None, unit: float) -> Similarity:
    """Similarity by the factor ``unit`` to the frame with a camera (4, 4) at its origin, looking along x. z is ``up``
    (3,), or the camera's own up if that is None.
    """
    up = -T_world_camera[:3, 1] if up is None else up
    R = rotation_to_upright(up)
    heading = R @ T_world_camera[:3, 2]
    length = float(np.hypot(heading[0], heading[1]))
    c, s = (heading[0] / length, heading[1] / length) if length > 1e-6 else (1.0, 0.0)
    R = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ R
    return Similarity(unit, R, -unit * R @ T_world_camera[:3, 3])
