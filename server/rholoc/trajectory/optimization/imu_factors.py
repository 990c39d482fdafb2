"""Factors of an IMU: preintegrated readings (Forster et al., 2017), gravity, mounting and clock."""

import itertools
from typing import Any

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, C, E, G, S, V, X

from rholoc.geometry import FloatArray, cross, pose_matrix
from rholoc.recordings import GRAVITY, Imu
from rholoc.trajectory.inertial.gyroscope import longest_interval_s
from rholoc.trajectory.optimization.problem import GAUGE_SIGMA, InertialState, Problem, State

_ACCELEROMETER_NOISE = 0.01  # m/s² / √Hz: a phone's, and hand motion between its readings
_GYROSCOPE_NOISE = 5e-4  # rad/s / √Hz
_INTEGRATION_NOISE = 1e-4  # m / √s
_ACCELEROMETER_WALK = 2e-3  # m/s² / √s
_GYROSCOPE_WALK = 2e-4  # rad/s / √s
_ACCELEROMETER_BIAS_SIGMA = 0.3  # m/s²
_GYROSCOPE_BIAS_SIGMA = 0.02  # rad/s
_MOUNTING_SIGMA_RAD = 0.02
_LEVER_SIGMA_M = 0.03  # between camera and IMU: the size of a phone
_CLOCK_SIGMA_S = 3e-3  # of the calibrated time offset
_GRAVITY_SIGMA = 0.05  # m/s², of its length as accelerometers read it
_TIE_SIGMA_RAD, _TIE_SIGMA_M = 2e-4, 5e-4


def add_imu(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    problem: Problem,
    imu: Imu,
    state: State,
    inertial: InertialState,
) -> None:
    """Add the IMU's unknowns to ``values``, from ``inertial``, and its factors to ``graph``.

    Keyframes outside the readings get none. Over a gap in the readings biases wander, and speeds are open.
    """
    assert problem.gyro is not None
    times = problem.times + problem.gyro.time_offset_s
    covered = np.flatnonzero((times >= imu.times[0]) & (times <= imu.times[-1])).tolist()
    T_imu_camera = gtsam.Pose3(inertial.T_imu_camera)
    values.insert(E(0), T_imu_camera)
    mounting = np.concatenate([np.full(3, _MOUNTING_SIGMA_RAD), np.full(3, _LEVER_SIGMA_M)])
    nominal = gtsam.Pose3(pose_matrix(problem.gyro.R_camera_imu.T, np.zeros(3)))
    graph.add(gtsam.PriorFactorPose3(E(0), nominal, gtsam.noiseModel.Diagonal.Sigmas(mounting)))
    values.insert(S(0), np.array([inertial.clock_s]))
    graph.add(gtsam.PriorFactorVector(S(0), np.zeros(1), gtsam.noiseModel.Isotropic.Sigma(1, _CLOCK_SIGMA_S)))
    values.insert(G(0), inertial.gravity)
    graph.add(gtsam.PriorFactorVector(G(0), np.array([0.0, 0.0, -GRAVITY]), _gravity_prior(problem)))
    tie = gtsam.noiseModel.Diagonal.Sigmas(np.repeat([_TIE_SIGMA_RAD, _TIE_SIGMA_M], 3))
    rates = np.column_stack([np.interp(times, imu.times, axis) for axis in imu.angular_velocity.T])
    parameters, longest_s = imu_noise(problem.imu_noise), longest_interval_s(imu)
    walk = np.repeat([_ACCELEROMETER_WALK, _GYROSCOPE_WALK], 3)
    for k in covered:
        bias = gtsam.imuBias.ConstantBias(inertial.biases[k, :3], inertial.biases[k, 3:])
        values.insert(X(k), gtsam.Pose3(state.T_map_camera[k]).compose(T_imu_camera.inverse()))
        values.insert(V(k), inertial.velocities[k])
        values.insert(B(k), bias)
        graph.add(tie_factor(k, rates[k] - inertial.biases[k, 3:], tie))
    for before, k in itertools.pairwise(covered):
        bias = gtsam.imuBias.ConstantBias(inertial.biases[k, :3], inertial.biases[k, 3:])
        summed = preintegrated(imu, times[before], times[k], parameters, bias, longest_s)
        if summed is not None:
            graph.add(
                gtsam.CombinedImuFactorWithGravityVector(
                    X(before), V(before), X(k), V(k), B(before), B(k), G(0), summed
                )
            )
        else:
            sigmas = walk * np.sqrt(times[k] - times[before])
            still = gtsam.imuBias.ConstantBias()
            graph.add(gtsam.BetweenFactorConstantBias(B(before), B(k), still, gtsam.noiseModel.Diagonal.Sigmas(sigmas)))
            loose = gtsam.noiseModel.Isotropic.Sigma(3, 10.0)
            for end in (before, k) if before == covered[0] else (k,):  # whose speeds no reading before them measured
                graph.add(gtsam.PriorFactorVector(V(end), np.zeros(3), loose))
    first = covered[0]
    prior = gtsam.imuBias.ConstantBias(np.zeros(3), problem.gyro.bias)
    sigmas = np.repeat([_ACCELEROMETER_BIAS_SIGMA, _GYROSCOPE_BIAS_SIGMA], 3)
    graph.add(gtsam.PriorFactorConstantBias(B(first), prior, gtsam.noiseModel.Diagonal.Sigmas(sigmas)))


def _gravity_prior(problem: Problem) -> gtsam.noiseModel.Base:
    """Prior on gravity (3,). Without fixes it is vertical, which defines the map's z axis. With fixes it is vertical up
    to ``level_sigma_rad``; if that is None, gravity is free.
    """
    if not problem.fixes:
        level = GAUGE_SIGMA
    elif problem.level_sigma_rad is None:
        level = GRAVITY
    else:
        level = GRAVITY * problem.level_sigma_rad
    length = GRAVITY if problem.fixes and problem.level_sigma_rad is None else _GRAVITY_SIGMA
    return gtsam.noiseModel.Diagonal.Sigmas(np.array([level, level, length]))


def imu_noise(times_usual: float) -> gtsam.PreintegrationCombinedParams:
    """Preintegration parameters of an IMU with ``times_usual`` × the usual noise; its biases wander as usual."""
    parameters = gtsam.PreintegrationCombinedParams.MakeSharedU(GRAVITY)
    parameters.setAccelerometerCovariance(np.eye(3) * (times_usual * _ACCELEROMETER_NOISE) ** 2)
    parameters.setGyroscopeCovariance(np.eye(3) * (times_usual * _GYROSCOPE_NOISE) ** 2)
    parameters.setIntegrationCovariance(np.eye(3) * (times_usual * _INTEGRATION_NOISE) ** 2)
    parameters.setBiasAccCovariance(np.eye(3) * _ACCELEROMETER_WALK**2)
    parameters.setBiasOmegaCovariance(np.eye(3) * _GYROSCOPE_WALK**2)
    return parameters


def preintegrated(
    imu: Imu,
    start_s: float,
    end_s: float,
    parameters: gtsam.PreintegrationCombinedParams,
    bias: gtsam.imuBias.ConstantBias,
    longest_s: float,
) -> gtsam.PreintegratedCombinedMeasurements | None:
    """Preintegrate the readings from ``start_s`` to ``end_s``, IMU clock (trapezoidal rule, linearized at ``bias``);
    None over a gap of more than ``longest_s``.
    """
    first, last = np.searchsorted(imu.times, start_s, side="right"), np.searchsorted(imu.times, end_s, side="left")
    knots = np.concatenate([[start_s], imu.times[first:last], [end_s]])
    around = imu.times[max(first - 1, 0) : last + 1]
    if np.diff(around).max(initial=0.0) > longest_s:
        return None
    acceleration = np.column_stack([np.interp(knots, imu.times, axis) for axis in imu.acceleration.T])
    rate = np.column_stack([np.interp(knots, imu.times, axis) for axis in imu.angular_velocity.T])
    summed = gtsam.PreintegratedCombinedMeasurements(parameters, bias)
    steps = np.diff(knots)
    for a, w, dt in zip(
        0.5 * (acceleration[1:] + acceleration[:-1]), 0.5 * (rate[1:] + rate[:-1]), steps.tolist(), strict=True
    ):
        if dt > 0:
            summed.integrateMeasurement(a, w, dt)
    return summed


def tie_factor(k: int, rate: FloatArray, noise: gtsam.noiseModel.Base) -> gtsam.CustomFactor:
    """Factor of mounting and clock offset: T_map_camera = T_map_imu Exp((ω, v) clock) T_imu_camera. ``rate`` is the
    IMU's ω (3,) [rad/s] at keyframe ``k``, v its velocity.
    """

    def error(factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: Any) -> Any:
        T_map_camera, T_map_imu = values.atPose3(C(k)), values.atPose3(X(k))
        velocity, T_imu_camera = values.atVector(V(k)), values.atPose3(E(0))
        clock_s = float(values.atVector(S(0))[0])
        R_imu_map = T_map_imu.rotation().matrix().T
        speed = R_imu_map @ velocity
        twist = np.concatenate([rate, speed])
        moved = gtsam.Pose3.Expmap(twist * clock_s)
        expected = T_map_imu.compose(moved).compose(T_imu_camera)
        if jacobians is not None:
            to_camera = T_imu_camera.inverse().AdjointMap()
            by_velocity, by_rotation = np.zeros((6, 3)), np.zeros((6, 6))
            by_velocity[3:] = R_imu_map * clock_s
            by_rotation[3:, :3] = cross(speed, np.eye(3)).T * clock_s
            jacobians[0] = np.eye(6)
            jacobians[1] = -moved.compose(T_imu_camera).inverse().AdjointMap() - to_camera @ by_rotation
            jacobians[2] = -to_camera @ by_velocity
            jacobians[3] = -np.eye(6)
            jacobians[4] = -(to_camera @ twist)[:, None]
        return np.asarray(gtsam.Pose3.Logmap(expected.between(T_map_camera)))

    return gtsam.CustomFactor(noise, [C(k), X(k), V(k), E(0), S(0)], error)
