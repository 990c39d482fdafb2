"""Least-squares adjustment of IMU and waypoints without pictures, over the whole walk.

Unknowns: pose, velocity and biases of the IMU at every requested time and every rest, and gravity. Readings between
them are preintegrated; waypoints measure positions; at every rest the velocity is zero. Starts from the poses of
:mod:`rholoc.trajectory.dead_reckoning`, which corrects leg by leg with constant biases.
"""

from collections.abc import Sequence
from itertools import pairwise

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, G, V, X

from rholoc.errors import MappingFailed
from rholoc.geometry import FloatArray, IntArray, pose_matrix
from rholoc.recordings import GRAVITY, Imu, Waypoint, check_waypoints_fix_frame
from rholoc.recordings.walk.stillness import pauses
from rholoc.trajectory.dead_reckoning import integrate_between_waypoints
from rholoc.trajectory.inertial.gyroscope import longest_interval_s
from rholoc.trajectory.optimization.descent import optimized
from rholoc.trajectory.optimization.factors import robust
from rholoc.trajectory.optimization.imu_factors import imu_noise, preintegrated

_REST_SIGMA_M_S = 0.05  # a hand at rest sways by millimetres, once or twice a second
_ACCELEROMETER_BIAS_SIGMA = 0.1  # m/s²
_GYROSCOPE_BIAS_SIGMA = 0.02  # rad/s
_LEVEL_SIGMA = GRAVITY * np.radians(0.5)  # m/s², of the waypoints' z axis
_GRAVITY_SIGMA = 0.05  # m/s², of its length as accelerometers read it
_LEVER_SIGMA_M = 0.02  # between camera and IMU, not observable here
_CAUCHY = 3.0
_INSIDE_S = 0.2  # from the ends of a pause, for the camera to be at rest
_REST_STEP_S = 0.1
_APART_S = 1e-3  # minimum interval between two states
_TIMES_USUAL = 1.0  # IMU noise, as a multiple of the usual
_ITERATIONS = 30


def adjust_between_waypoints(imu: Imu, waypoints: Sequence[Waypoint], at: FloatArray) -> FloatArray:
    """Poses T_map_camera (N, 4, 4) at times ``at`` (N,) [s], all between the first and the last waypoint. If the system
    is singular, those of :func:`integrate_between_waypoints`.

    Raises:
        InvalidWaypoints: the waypoints do not fix a frame.
        MappingFailed: the IMU's mounting is unknown, its acceleration excludes gravity, or its readings have a gap or
            do not cover the waypoints.
    """
    check_waypoints_fix_frame(waypoints)
    stops = np.sort([waypoint.time for waypoint in waypoints])
    resting = _resting(imu, stops)
    times = np.sort(np.concatenate([at, stops, resting]))
    times = times[np.concatenate([[True], np.diff(times) > _APART_S])]
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    first = integrate_between_waypoints(imu, waypoints, times)
    assert imu.R_camera_imu is not None
    R_map_imu, positions = first[:, :3, :3] @ imu.R_camera_imu, first[:, :3, 3]
    velocities = np.gradient(positions, times, axis=0)
    still = gtsam.imuBias.ConstantBias()
    for k in range(len(times)):
        values.insert(X(k), gtsam.Pose3(pose_matrix(R_map_imu[k], positions[k])))
        values.insert(V(k), velocities[k])
        values.insert(B(k), still)
    values.insert(G(0), np.array([0.0, 0.0, -GRAVITY]))
    _add_motion(graph, imu, times)
    sigmas = np.repeat([_ACCELEROMETER_BIAS_SIGMA, _GYROSCOPE_BIAS_SIGMA], 3)
    graph.add(gtsam.PriorFactorConstantBias(B(0), still, gtsam.noiseModel.Diagonal.Sigmas(sigmas)))
    level = gtsam.noiseModel.Diagonal.Sigmas(np.array([_LEVEL_SIGMA, _LEVEL_SIGMA, _GRAVITY_SIGMA]))
    graph.add(gtsam.PriorFactorVector(G(0), np.array([0.0, 0.0, -GRAVITY]), level))
    rest = gtsam.noiseModel.Isotropic.Sigma(3, _REST_SIGMA_M_S)
    for k in _nearest(times, np.concatenate([stops, resting])).tolist():
        graph.add(gtsam.PriorFactorVector(V(k), np.zeros(3), rest))
    for waypoint in waypoints:
        sigma_m = float(np.hypot(waypoint.sigma_m, _LEVER_SIGMA_M))
        noise = robust(_CAUCHY, gtsam.noiseModel.Isotropic.Sigma(3, sigma_m))
        (k,) = _nearest(times, np.array([waypoint.time]))
        graph.add(gtsam.PoseTranslationPrior3D(X(int(k)), np.array(waypoint.position), noise))
    try:
        solved = optimized(graph, values, _ITERATIONS)
    except RuntimeError:  # singular system
        return integrate_between_waypoints(imu, waypoints, at)
    found = np.array([solved.atPose3(X(int(k))).matrix() for k in _nearest(times, at)])
    return pose_matrix(found[:, :3, :3] @ imu.R_camera_imu.T, found[:, :3, 3])


def _add_motion(graph: gtsam.NonlinearFactorGraph, imu: Imu, times: FloatArray) -> None:
    """Add the IMU's factor from each of ``times`` (N,) to the next. Raises MappingFailed over a gap in its readings."""
    parameters, longest_s, still = imu_noise(_TIMES_USUAL), longest_interval_s(imu), gtsam.imuBias.ConstantBias()
    for k, (before_s, after_s) in enumerate(pairwise(times.tolist())):
        summed = preintegrated(imu, before_s, after_s, parameters, still, longest_s)
        if summed is None:
            raise MappingFailed(
                f"The IMU's table has a gap between {before_s:.2f} and {after_s:.2f} s, and nothing else bridges it.",
                "Choose poses 'visual-inertial'.",
            )
        graph.add(
            gtsam.CombinedImuFactorWithGravityVector(X(k), V(k), X(k + 1), V(k + 1), B(k), B(k + 1), G(0), summed)
        )


def _resting(imu: Imu, stops: FloatArray) -> FloatArray:
    """Times within pauses between the first and the last stop, every 0.1 s, at least 0.2 s from the pauses' ends."""
    found = [
        np.arange(start + _INSIDE_S, end - _INSIDE_S, _REST_STEP_S)
        for start, end in pauses(imu)
        if end - start > 2 * _INSIDE_S
    ]
    times = np.concatenate([np.zeros(0), *found])
    return np.asarray(times[(times > stops[0]) & (times < stops[-1])])


def _nearest(times: FloatArray, wanted: FloatArray) -> IntArray:
    """Rows (N,) of the increasing ``times`` nearest to each of ``wanted`` (N,)."""
    after = np.clip(np.searchsorted(times, wanted), 1, len(times) - 1)
    return np.asarray(np.where(wanted - times[after - 1] < times[after] - wanted, after - 1, after))
