"""The paper's own method: integrate the IMU between waypoints."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation, Slerp

from rholoc.errors import MappingFailed
from rholoc.geometry import FloatArray, pose_matrix
from rholoc.recordings import GRAVITY, Imu, Waypoint, check_waypoints_fix_frame
from rholoc.recordings.walk.stillness import pauses
from rholoc.trajectory.frame.upright import rotation_to_upright
from rholoc.trajectory.inertial.gyroscope import orientations

_PAUSE_S = 0.6  # the camera rests this long around a waypoint
_LEG_SIGMA_M = 0.3  # error of an integrated leg at its end
_LEVEL_SIGMA = 0.3  # m/s², of the horizontal specific force at rest
_BIAS_SIGMA = 0.02  # rad/s, of the gyroscope
_NOT_A_WAYPOINT_S = 1.0  # a pause further than this from all waypoints is a rest on the way


def integrate_between_waypoints(imu: Imu, waypoints: Sequence[Waypoint], at: FloatArray) -> FloatArray:
    """Poses T_map_camera (N, 4, 4) at times ``at`` (N,) [s], all between the first and the last waypoint.

    The velocity is zero at waypoints and other pauses. Between rests the acceleration is integrated twice. A velocity
    left at a rest is removed as a constant acceleration error, a displacement left at a waypoint as a position error
    linear in time (paper, section 3). Tilt comes from gravity at the first waypoint, heading from the waypoints,
    gyroscope bias from the ends of the legs and from gravity at every waypoint.

    Raises:
        InvalidWaypoints: the waypoints do not fix a frame.
        MappingFailed: the IMU's mounting is unknown, its acceleration excludes gravity, it does not cover the
            waypoints or has no readings at one, or two of them have one time.
    """
    check_waypoints_fix_frame(waypoints)
    if imu.R_camera_imu is None or not imu.includes_gravity:
        raise MappingFailed(
            "The IMU alone cannot place this recording: its mounting or gravity is not known.",
            "Choose poses 'visual-inertial'.",
        )
    ordered = sorted(waypoints, key=lambda waypoint: waypoint.time)
    stops = np.array([waypoint.time for waypoint in ordered])
    places = np.array([waypoint.position for waypoint in ordered])
    if imu.times[0] > stops[0] or imu.times[-1] < stops[-1]:
        raise MappingFailed("The IMU does not cover the waypoints.", "Record the IMU for the whole walk.")
    rests = _rests(imu, stops)
    near = [np.abs(imu.times - stop) <= _PAUSE_S / 2 for stop in stops]
    for waypoint, here in zip(ordered, near, strict=True):
        if not here.any():
            raise MappingFailed(
                f"The IMU has no readings at the waypoint {waypoint.name}.", "Record it without gaps, or leave it out."
            )
    if (np.diff(stops) <= 0).any():
        raise MappingFailed("Two waypoints have the same time.", "Give each the time when the camera was there.")

    def walked(bias: FloatArray) -> tuple[Rotation, Rotation, list[tuple[FloatArray, FloatArray]], FloatArray]:
        """Orientations, levelling rotation, path of every leg, and specific force at every stop in the level frame."""
        orientation = orientations(imu, bias)
        force = orientation.apply(imu.acceleration)
        level = Rotation.from_matrix(rotation_to_upright(np.mean(force[near[0]], axis=0)))
        force = level.apply(force)
        legs = [
            _leg(imu.times, force - [0.0, 0.0, GRAVITY], rests[(rests >= a) & (rests <= b)]) for a, b in pairwise(stops)
        ]
        return orientation, level, legs, np.array([force[here].mean(axis=0) for here in near])

    def residuals(bias: FloatArray) -> FloatArray:
        _, _, legs, force = walked(bias)
        moved = np.array([path[-1] for _, path in legs])
        missed = _yaw(moved, np.diff(places, axis=0)).apply(moved) - np.diff(places, axis=0)
        return np.concatenate([missed.ravel() / _LEG_SIGMA_M, force[:, :2].ravel() / _LEVEL_SIGMA, bias / _BIAS_SIGMA])

    bias = least_squares(
        residuals, np.zeros(3), loss="soft_l1", diff_step=np.full(3, 1e-3), x_scale=_BIAS_SIGMA, max_nfev=15
    ).x
    orientation, level, paths, _ = walked(bias)
    yaw = _yaw(np.array([path[-1] for _, path in paths]), np.diff(places, axis=0))
    positions = np.empty((len(at), 3))
    for (times, path), a, b, from_place, to_place in zip(
        paths, stops[:-1], stops[1:], places[:-1], places[1:], strict=True
    ):
        here = (at >= a) & (at <= b)
        turned = yaw.apply(path)
        share = ((times - a) / (b - a))[:, None]
        corrected = from_place + turned + share * (to_place - from_place - turned[-1])
        positions[here] = np.column_stack([np.interp(at[here], times, corrected[:, i]) for i in range(3)])
    R_map_imu = yaw * level * Slerp(imu.times, orientation)(at)
    return pose_matrix(R_map_imu.as_matrix() @ imu.R_camera_imu.T, positions)


def _rests(imu: Imu, stops: FloatArray) -> FloatArray:
    """Times at rest [s], ascending: the waypoints' ``stops`` (W,), and the middles of pauses that are
    over 1 s from each of them.
    """
    middles = pauses(imu).mean(axis=1)
    others = [middle for middle in middles if np.abs(stops - middle).min() > _NOT_A_WAYPOINT_S]
    return np.sort(np.concatenate([stops, others]))


def _leg(times: FloatArray, acceleration: FloatArray, rests: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Times (M,) from the first to the last of ``rests``, and the displacement (M, 3) since the first; zero velocity at
    each. ``acceleration`` (N, 3), without gravity, is at ``times`` (N,).
    """
    t, path = np.array([rests[0]]), np.zeros((1, 3))
    for a, b in pairwise(rests):
        later, moved = _rest_to_rest(times, acceleration, a, b)
        t, path = np.concatenate([t, later[1:]]), np.concatenate([path, path[-1] + moved[1:]])
    return t, path


def _rest_to_rest(times: FloatArray, acceleration: FloatArray, a: float, b: float) -> tuple[FloatArray, FloatArray]:
    """Times (M,) from ``a`` to ``b`` and the displacement (M, 3) since ``a``, with zero velocity at both ends."""
    t = np.concatenate([[a], times[(times > a) & (times < b)], [b]])
    sampled = np.column_stack([np.interp(t, times, acceleration[:, i]) for i in range(3)])
    dt = np.diff(t)[:, None]
    velocity = np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * (sampled[1:] + sampled[:-1]) * dt, axis=0)])
    velocity -= ((t - a) / (b - a))[:, None] * velocity[-1]
    return t, np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * (velocity[1:] + velocity[:-1]) * dt, axis=0)])


def _yaw(moved: FloatArray, measured: FloatArray) -> Rotation:
    """Least-squares rotation about z that takes displacements (N, 3) to measured ones (N, 3)."""
    cross = np.sum(moved[:, 0] * measured[:, 1] - moved[:, 1] * measured[:, 0])
    dot = np.sum(moved[:, 0] * measured[:, 0] + moved[:, 1] * measured[:, 1])
    return Rotation.from_euler("z", float(np.arctan2(cross, dot)))
