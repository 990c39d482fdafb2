"""Align a trajectory of arbitrary frame and scale with the waypoints' metric frame."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from rholoc.errors import InvalidWaypoints, MappingFailed
from rholoc.geometry import BoolArray, FloatArray, Similarity, umeyama
from rholoc.recordings import Waypoint, check_waypoints_fix_frame

_WAYPOINT_SIGMA_M = 0.02  # of a phone held at a measured point
_ROBUST_FROM = 5  # minimum number of waypoints that can outvote a wrong one
_MAX_RMS_M, _MAX_RMS_OF_WAY = 0.25, 0.005  # maximum RMS residual [m], or as a share of the path between the waypoints
MAX_GAP_S = 0.5  # a waypoint further in time from all posed frames is not used
_AGREEING_M = 0.06  # maximum RMS of the other waypoints without a mistaken one …
_MISTAKE_M = 0.15  # … and minimum residual of the mistaken one
_CLEARER = 2.0  # any other waypoint left out instead must give an RMS this many times larger


@dataclass(frozen=True, eq=False)
class UpMeasurement:
    """An upward direction (3,) in the trajectory's own frame, and its standard deviation [deg]."""

    direction: FloatArray
    sigma_deg: float


@dataclass(frozen=True, eq=False)
class WaypointAlignment:
    """Alignment of a trajectory with its waypoints.

    Attributes:
        similarity: from the trajectory's frame to the waypoints'.
        residuals_m: (W,) distance between path and waypoint; NaN if no frame is near in time.
        mistake: number of the waypoint left out because it contradicts all others, or None.
    """

    similarity: Similarity
    residuals_m: FloatArray
    mistake: int | None = None

    @property
    def worst_m(self) -> float:
        """Largest residual of the used waypoints [m]."""
        used = self.residuals_m if self.mistake is None else np.delete(self.residuals_m, self.mistake)
        return float(np.nanmax(used))


def align_to_waypoints(
    times: FloatArray, positions: FloatArray, waypoints: Sequence[Waypoint], up: UpMeasurement | None = None
) -> WaypointAlignment:
    """Least-squares similarity from the trajectory's frame to the waypoints' frame.

    Fits the waypoints' positions and the upward direction, if measured: nearly collinear waypoints do not fix it. With
    five or more waypoints, one that contradicts all others (a mistyped coordinate) is left out.

    Args:
        times: (N,) seconds, increasing.
        positions: (N, 3) in any frame and scale.
        waypoints: W waypoints with times; those further than ``MAX_GAP_S`` from all ``times`` are left out.
        up: the upward direction in the frame of ``positions``.

    Raises:
        InvalidWaypoints: fewer than three, or collinear.
        MappingFailed: the typical residual (the median of five or more waypoints, else the RMS) exceeds both 25 cm
            and 0.5 % of the path length, or too few waypoints have a frame near in time.
    """
    check_waypoints_fix_frame(waypoints)
    near = _near(times, waypoints)
    _check_enough_near(waypoints, near)
    measured = np.array([waypoint.position for waypoint in waypoints])
    own = positions_at(times, positions, np.array([waypoint.time for waypoint in waypoints]))
    used = np.flatnonzero(near)
    mistake = _mistake([waypoints[i] for i in used.tolist()], own[used])
    if mistake is not None:
        mistake, used = int(used[mistake]), np.delete(used, mistake)
    found = _fit(own[used], measured[used], up)
    residuals = np.where(near, np.linalg.norm(measured - found.points(own), axis=1), np.nan)
    robust = len(used) >= _ROBUST_FROM
    typical = float(np.median(residuals[used])) if robust else float(np.sqrt(np.mean(residuals[used] ** 2)))
    way_m = found.scale * _way(times, positions, waypoints)
    if typical > max(_MAX_RMS_M, _MAX_RMS_OF_WAY * way_m):
        raise MappingFailed(
            f"The camera's path misses the waypoints by {typical:.2f} m.",
            "Check their times and coordinates; walk slower and keep more texture in view.",
        )
    return WaypointAlignment(found, residuals, mistake)


def fix_frame(times: FloatArray, waypoints: Sequence[Waypoint]) -> bool:
    """Whether the waypoints within ``MAX_GAP_S`` of one of ``times`` (N,) [s] fix a frame."""
    try:
        check_waypoints_fix_frame([waypoints[k] for k in np.flatnonzero(_near(times, waypoints)).tolist()])
    except InvalidWaypoints:
        return False
    return True


def _near(times: FloatArray, waypoints: Sequence[Waypoint]) -> BoolArray:
    """Mask (W,) of the waypoints that have one of ``times`` (N,) [s] within ``MAX_GAP_S``."""
    return np.array([np.abs(times - waypoint.time).min() <= MAX_GAP_S for waypoint in waypoints], dtype=np.bool_)


def positions_at(times: FloatArray, positions: FloatArray, at: FloatArray) -> FloatArray:
    """Interpolate ``positions`` (N, 3) at ``times`` (N,) to the times ``at`` (M,) by a cubic spline: (M, 3).

    Times outside are clipped to the first or last; a single position is repeated.
    """
    if len(times) < 2:
        return np.repeat(positions, len(at), axis=0)
    inside = np.clip(at, times[0], times[-1])
    return np.asarray(CubicSpline(times, positions, bc_type="natural")(inside))


def _way(times: FloatArray, positions: FloatArray, waypoints: Sequence[Waypoint]) -> float:
    """Path length from the first to the last waypoint, in the unit of ``positions``."""
    stops = [waypoint.time for waypoint in waypoints]
    between = (times >= min(stops)) & (times <= max(stops))
    return float(np.linalg.norm(np.diff(positions[between], axis=0), axis=1).sum())


def _check_enough_near(waypoints: Sequence[Waypoint], near: BoolArray) -> None:
    """Raise MappingFailed, naming the others, if the waypoints ``near`` (W,) do not fix a frame."""
    if near.all():
        return
    lost = ", ".join(w.name for w, ok in zip(waypoints, near, strict=True) if not ok)
    try:
        check_waypoints_fix_frame([w for w, ok in zip(waypoints, near, strict=True) if ok])
    except InvalidWaypoints as error:
        raise MappingFailed(
            f"No frame near the waypoint {lost} could be placed; the others do not fix a frame.",
            "Keep texture in view and hold the phone still at each waypoint.",
        ) from error


def _fit(own: FloatArray, measured: FloatArray, up: UpMeasurement | None) -> Similarity:
    """Least-squares similarity from ``own`` (W, 3) to ``measured`` (W, 3), robust for many points; ``up`` becomes z."""
    start = umeyama(own, measured)
    if not np.isfinite(start.scale) or start.scale <= 0:
        raise MappingFailed("The camera did not move between the waypoints.", "Check the waypoints' times.")
    centre = own.mean(axis=0)

    def similarity(x: FloatArray) -> Similarity:
        R = Rotation.from_rotvec(x[:3]).as_matrix() @ start.rotation
        scale = start.scale * float(np.exp(x[6]))
        return Similarity(scale, R, start.points(centre[None])[0] + x[3:6] - scale * R @ centre)

    def residuals(x: FloatArray) -> FloatArray:
        now = similarity(x)
        parts = [((now.points(own) - measured) / _WAYPOINT_SIGMA_M).ravel()]
        if up is not None:
            tilt = now.rotation @ up.direction - [0.0, 0.0, 1.0]
            parts.append(tilt / np.radians(up.sigma_deg))
        return np.concatenate(parts)

    robust = len(own) >= _ROBUST_FROM
    return similarity(least_squares(residuals, np.zeros(7), loss="soft_l1" if robust else "linear").x)


def _mistake(waypoints: Sequence[Waypoint], own: FloatArray) -> int | None:
    """Number of the only waypoint that is off by 15 cm or more while all others agree within 6 cm. None otherwise, or
    below five waypoints. ``own`` (W, 3) are the camera's positions at the waypoints.
    """
    if len(waypoints) < _ROBUST_FROM:
        return None
    measured = np.array([waypoint.position for waypoint in waypoints])
    rms_m, off_m = np.full(len(waypoints), np.inf), np.zeros(len(waypoints))
    for left_out in range(len(waypoints)):
        rest = np.delete(np.arange(len(waypoints)), left_out)
        try:
            check_waypoints_fix_frame([waypoints[i] for i in rest.tolist()])
        except InvalidWaypoints:
            continue
        errors = np.linalg.norm(umeyama(own[rest], measured[rest]).points(own) - measured, axis=1)
        rms_m[left_out] = np.sqrt(np.mean(errors[rest] ** 2))
        off_m[left_out] = errors[left_out]
    suspect, next_best = np.argsort(rms_m)[:2]
    is_clear = rms_m[suspect] <= _AGREEING_M and rms_m[next_best] >= _CLEARER * rms_m[suspect]
    return int(suspect) if is_clear and off_m[suspect] >= _MISTAKE_M else None
