"""A trajectory of arbitrary frame and scale → the waypoints' metric frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from rholoc.errors import InvalidWaypoints, MappingFailed
from rholoc.geometry import FloatArray, Similarity, umeyama
from rholoc.recordings import Waypoint, check_waypoints_fix_frame

_WAYPOINT_SIGMA_M = 0.02  # how well a phone is held to a measured point
_ROBUST_FROM = 5  # waypoints; fewer cannot outvote a wrong one
_MAX_RMS_M, _MAX_RMS_OF_WAY = 0.25, 0.005  # by which a walk misses its waypoints, and of the way between them
MAX_GAP_S = 0.5  # a waypoint further from any posed frame has no place on the trajectory
_AGREEING_M = 0.06  # rms of the waypoints left when a mistaken one is taken out …
_MISTAKE_M = 0.15  # … from which that one is at least this far off
_CLEARER = 2.0  # times worse do the others fit without any other one
_ONE_AXIS = 0.9  # the share of the error that lies along the coordinate that is named


@dataclass(frozen=True, eq=False)
class UpMeasurement:
    """An upward direction (3,) in the trajectory's own frame, and how well it is known."""

    direction: FloatArray
    sigma_deg: float


@dataclass(frozen=True, eq=False)
class WaypointAlignment:
    """How a trajectory comes to the waypoints.

    Attributes:
        similarity: from the trajectory's frame to the waypoints'.
        residuals_m: (W,) how far the camera's path misses each waypoint; NaN where it has no place near one.
        mistake: the number of the waypoint that contradicts all others, and was left out, or None.
        explanation: one line on the mistake, or empty.
    """

    similarity: Similarity
    residuals_m: FloatArray
    mistake: int | None = None
    explanation: str = ""

    @property
    def worst_m(self) -> float:
        """The largest residual of the waypoints that were used."""
        used = self.residuals_m if self.mistake is None else np.delete(self.residuals_m, self.mistake)
        return float(np.nanmax(used))


def align_to_waypoints(
    times: FloatArray, positions: FloatArray, waypoints: Sequence[Waypoint], up: UpMeasurement | None = None
) -> WaypointAlignment:
    """The similarity that takes the trajectory to the waypoints' frame.

    Least squares over the waypoints' positions and, where measured, the upward direction, which waypoints close to one
    line leave open. Of five or more, one that contradicts all others (a mistyped coordinate) is found and left out.

    Args:
        times: (N,) seconds, increasing.
        positions: (N, 3) in a frame and scale of their own.
        waypoints: at their times; those further than 0.5 s from all ``times`` are left out.
        up: the upward direction in the frame of ``positions``.

    Raises:
        InvalidWaypoints: fewer than three, or collinear.
        MappingFailed: the trajectory cannot be brought to the waypoints; one of the two is wrong.
    """
    check_waypoints_fix_frame(waypoints)
    near = np.array([np.abs(times - waypoint.time).min() <= MAX_GAP_S for waypoint in waypoints])
    _check_enough_near(waypoints, near)
    measured = np.array([waypoint.position for waypoint in waypoints])
    own = positions_at(times, positions, np.array([waypoint.time for waypoint in waypoints]))
    used = np.flatnonzero(near)
    mistake = _mistake([waypoints[i] for i in used.tolist()], own[used])
    if mistake is not None:
        mistake, used = int(used[mistake]), np.delete(used, mistake)
    found = _fit(own[used], measured[used], up)
    off = measured - found.points(own)
    residuals = np.where(near, np.linalg.norm(off, axis=1), np.nan)
    robust = len(used) >= _ROBUST_FROM
    typical = float(np.median(residuals[used])) if robust else float(np.sqrt(np.mean(residuals[used] ** 2)))
    way_m = found.scale * _way(times, positions, waypoints)
    if typical > max(_MAX_RMS_M, _MAX_RMS_OF_WAY * way_m):
        raise MappingFailed(
            f"The camera's path misses the waypoints by {typical:.2f} m.",
            "Check their times and coordinates; walk slower and keep more texture in view.",
        )
    explanation = "" if mistake is None else _explain(waypoints[mistake], off[mistake])
    return WaypointAlignment(found, residuals, mistake, explanation)


def positions_at(times: FloatArray, positions: FloatArray, at: FloatArray) -> FloatArray:
    """Positions (M, 3) at the times ``at`` (M,), by a cubic spline through ``positions`` (N, 3) at ``times`` (N,)."""
    if len(times) < 2:
        return np.repeat(positions, len(at), axis=0)
    inside = np.clip(at, times[0], times[-1])
    return np.asarray(CubicSpline(times, positions, bc_type="natural")(inside))


def _way(times: FloatArray, positions: FloatArray, waypoints: Sequence[Waypoint]) -> float:
    """How far the camera went from the first to the last of the waypoints, in the unit of ``positions``."""
    stops = [waypoint.time for waypoint in waypoints]
    between = (times >= min(stops)) & (times <= max(stops))
    return float(np.linalg.norm(np.diff(positions[between], axis=0), axis=1).sum())


def _check_enough_near(waypoints: Sequence[Waypoint], near: FloatArray) -> None:
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
    """Which of five or more waypoints all others agree without, if there is exactly one that is far off from them."""
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


def _explain(waypoint: Waypoint, off: FloatArray) -> str:
    """What is wrong with a waypoint that lies ``off`` (3,) metres from where the camera was."""
    text = f"{waypoint.name} is {np.linalg.norm(off):.2f} m off the walk, while all others agree; it was left out."
    axis = int(np.argmax(np.abs(off)))
    if abs(off[axis]) < _ONE_AXIS * np.linalg.norm(off):
        return f"{text} Check its coordinates."
    said = waypoint.position[axis]
    fitting = round(said - float(off[axis]), 2) + 0.0  # without a minus before 0.00
    return f"{text} Check its {'xyz'[axis]}: {said:.2f} is written, {fitting:.2f} would fit."
