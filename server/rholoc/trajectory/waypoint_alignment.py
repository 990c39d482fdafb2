"""A trajectory of arbitrary frame and scale → the waypoints' metric frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from rholoc.errors import InvalidWaypoints, MappingFailed
from rholoc.geometry import FloatArray
from rholoc.recordings import Waypoint, check_waypoints_fix_frame
from rholoc.trajectory.alignment import Similarity, umeyama

_WAYPOINT_SIGMA_M = 0.02  # how well a phone is held to a measured point
_ROBUST_FROM = 5  # waypoints; fewer cannot outvote a wrong one
_MAX_RMS_M = 0.25
_MAX_GAP_S = 0.5  # a waypoint further from any posed frame has no place on the trajectory


@dataclass(frozen=True, eq=False)
class UpMeasurement:
    """An upward direction (3,) in the trajectory's own frame, and how well it is known."""

    direction: FloatArray
    sigma_deg: float


def align_to_waypoints(
    times: FloatArray, positions: FloatArray, waypoints: Sequence[Waypoint], up: UpMeasurement | None = None
) -> tuple[Similarity, FloatArray]:
    """The similarity that takes the trajectory to the waypoints' frame, and the residuals (W,) in metres.

    Least squares over the waypoints' positions and, where measured, the upward direction, which waypoints close to one
    line leave open; robust from five waypoints on.

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
    near = np.array([np.abs(times - waypoint.time).min() <= _MAX_GAP_S for waypoint in waypoints])
    used = [waypoint for waypoint, ok in zip(waypoints, near, strict=True) if ok]
    if len(used) < len(waypoints):
        lost = ", ".join(w.name for w, ok in zip(waypoints, near, strict=True) if not ok)
        try:
            check_waypoints_fix_frame(used)
        except InvalidWaypoints as error:
            raise MappingFailed(
                f"No frame near the waypoint {lost} could be placed; the others do not fix a frame.",
                "Keep texture in view and hold the phone still at each waypoint.",
            ) from error
    measured = np.array([waypoint.position for waypoint in used])
    own = positions_at(times, positions, np.array([waypoint.time for waypoint in used]))
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

    robust = len(used) >= _ROBUST_FROM
    found = similarity(least_squares(residuals, np.zeros(7), loss="soft_l1" if robust else "linear").x)
    all_own = positions_at(times, positions, np.array([waypoint.time for waypoint in waypoints]))
    distances = np.linalg.norm(found.points(all_own) - [waypoint.position for waypoint in waypoints], axis=1)
    typical = float(np.median(distances[near])) if robust else float(np.sqrt(np.mean(distances[near] ** 2)))
    if typical > _MAX_RMS_M:
        raise MappingFailed(
            f"The camera's path misses the waypoints by {typical:.2f} m.",
            "Check their times and coordinates; walk slower and keep more texture in view.",
        )
    return found, np.where(near, distances, np.nan)


def positions_at(times: FloatArray, positions: FloatArray, at: FloatArray) -> FloatArray:
    """Positions (M, 3) at the times ``at`` (M,), by a cubic spline through ``positions`` (N, 3) at ``times`` (N,)."""
    if len(times) < 2:
        return np.repeat(positions, len(at), axis=0)
    inside = np.clip(at, times[0], times[-1])
    return np.asarray(CubicSpline(times, positions, bc_type="natural")(inside))
