"""Scale and gravity from the accelerometer: linear visual-inertial alignment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from rholoc.geometry import FloatArray
from rholoc.recordings import Imu
from rholoc.trajectory.imu import GyroCalibration, spaced_rows

GRAVITY = 9.81
_INTERVAL_S = 0.75  # keyframes at 1.33 Hz: denser ones were measured to be worse
_BIAS_SIGMA = 0.1  # m/s², of the accelerometer
_VELOCITY_SIGMA = 0.02  # m/s over an interval
_POSITION_SIGMA = 0.02  # m over an interval
_FEWEST_INTERVALS = 6
_SUBSETS = 4  # shifted choices of keyframes; their spread tells the uncertainty


@dataclass(frozen=True, eq=False)
class InertialAlignment:
    """What the accelerometer says about a trajectory of arbitrary frame and scale.

    Attributes:
        scale: metres per unit of the trajectory.
        scale_sigma: its relative standard uncertainty.
        up: (3,), unit, in the trajectory's frame; None where the acceleration comes without gravity.
        gravity: the magnitude found, m/s²; a check. NaN where the acceleration comes without gravity.
    """

    scale: float
    scale_sigma: float
    up: FloatArray | None
    gravity: float


def align_inertially(
    times: FloatArray, T_world_camera: FloatArray, imu: Imu, gyro: GyroCalibration
) -> InertialAlignment | None:
    """Scale and gravity from poses (N, 4, 4) of arbitrary frame and scale at ``times`` (N,), and the IMU.

    Between keyframes k, k+1 that are T apart, with α, β the accelerations integrated twice and once in the axes of k:
    s (p_{k+1} − p_k) = v_k T + ½ g T² + R_k α, v_{k+1} = v_k + g T + R_k β. Linear in the scale s, gravity g, the
    velocities v and the accelerometer's bias (Martinelli, 2012; Qin et al., 2018). The lever arm between camera and
    IMU is neglected. None where the recording is too short.
    """
    inside = np.flatnonzero((times + gyro.time_offset_s > imu.times[0]) & (times + gyro.time_offset_s < imu.times[-1]))
    results = []
    for start in range(_SUBSETS):
        first = int(np.searchsorted(times[inside], times[inside[0]] + start * _INTERVAL_S / _SUBSETS))
        rows = inside[spaced_rows(times[inside], _INTERVAL_S, first)]
        if len(rows) > _FEWEST_INTERVALS:
            results.append(_solve(times[rows], T_world_camera[rows], imu, gyro))
    if not results:
        return None
    scales = np.array([scale for scale, _, _ in results])
    scale = float(np.median(scales))
    spread = float(np.std(scales)) / max(abs(scale), 1e-12)
    sigma = max(float(np.median([sigma for _, sigma, _ in results])), spread)
    if not imu.includes_gravity:
        return InertialAlignment(scale, sigma, None, float("nan"))
    g = np.median([g for _, _, g in results], axis=0)
    magnitude = float(np.linalg.norm(g))
    return InertialAlignment(scale, sigma, -g / magnitude, magnitude)


def _solve(
    times: FloatArray, T_world_camera: FloatArray, imu: Imu, gyro: GyroCalibration
) -> tuple[float, float, FloatArray]:
    """Scale, its relative standard uncertainty and gravity (3,); gravity's length is held at 9.81 in the end."""
    A, b, weights = _equations(times, T_world_camera, imu, gyro)
    if not imu.includes_gravity:
        A[:, 1:4] = 0
    x, covariance = _least_squares(A, b, weights)
    if imu.includes_gravity:
        for _ in range(3):  # gravity of known length: it moves in its tangent plane alone
            g = x[1:4] * (GRAVITY / np.linalg.norm(x[1:4]))
            tangent = np.linalg.svd(g[None])[2][1:].T
            B = np.column_stack([A[:, :1], A[:, 1:4] @ tangent, A[:, 4:]])
            y, covariance = _least_squares(B, b - A[:, 1:4] @ g, weights)
            x = np.concatenate([y[:1], g + tangent @ y[1:3], y[3:]])
    scale = float(x[0])
    sigma = float(np.sqrt(covariance[0, 0]))
    return scale, sigma / abs(scale) if scale else float("inf"), x[1:4]


def _least_squares(A: FloatArray, b: FloatArray, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    W, c = A * weights[:, None], b * weights
    information = W.T @ W
    inverse = np.linalg.pinv(information, rcond=1e-14, hermitian=True)
    x = inverse @ (W.T @ c)
    redundancy = max(len(b) - int(np.count_nonzero(np.diag(information))), 1)
    variance = float(np.sum((W @ x - c) ** 2)) / redundancy
    return x, inverse * max(variance, 1e-12)


def _equations(
    times: FloatArray, T_world_camera: FloatArray, imu: Imu, gyro: GyroCalibration
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Rows of A x = b for x = (scale, gravity, bias of the accelerometer, velocities), and their weights."""
    n = len(times)
    A, b, weights = [], [], []
    for k in range(n - 1):
        span = times[k + 1] - times[k]
        alpha, beta, alpha_bias, beta_bias = preintegrate(
            imu, gyro, times[k] + gyro.time_offset_s, times[k + 1] + gyro.time_offset_s
        )
        R_world_imu = T_world_camera[k, :3, :3] @ gyro.R_camera_imu
        position, velocity = np.zeros((3, 7 + 3 * n)), np.zeros((3, 7 + 3 * n))
        position[:, 0] = T_world_camera[k + 1, :3, 3] - T_world_camera[k, :3, 3]
        position[:, 1:4] = -0.5 * span**2 * np.eye(3)
        position[:, 4:7] = R_world_imu @ alpha_bias
        position[:, 7 + 3 * k : 10 + 3 * k] = -span * np.eye(3)
        velocity[:, 1:4] = -span * np.eye(3)
        velocity[:, 4:7] = R_world_imu @ beta_bias
        velocity[:, 7 + 3 * k : 10 + 3 * k] = -np.eye(3)
        velocity[:, 10 + 3 * k : 13 + 3 * k] = np.eye(3)
        A += [position, velocity]
        b += [R_world_imu @ alpha, R_world_imu @ beta]
        weights += [np.full(3, 1 / _POSITION_SIGMA), np.full(3, 1 / _VELOCITY_SIGMA)]
    prior = np.zeros((3, 7 + 3 * n))
    prior[:, 4:7] = np.eye(3)
    A.append(prior)
    b.append(np.zeros(3))
    weights.append(np.full(3, 1 / _BIAS_SIGMA))
    return np.concatenate(A), np.concatenate(b), np.concatenate(weights)


def preintegrate(
    imu: Imu, gyro: GyroCalibration, start: float, end: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Accelerations from ``start`` to ``end`` (IMU times) integrated twice and once: (3,) each, in the first axes.

    And by what (3, 3) they shrink per unit of the accelerometer's bias. Linear between samples, midpoint rule.
    """
    between = imu.times[(imu.times > start) & (imu.times < end)]
    t = np.concatenate([[start], between, [end]])
    rate = np.column_stack([np.interp(t, imu.times, imu.angular_velocity[:, i] - gyro.bias[i]) for i in range(3)])
    felt = np.column_stack([np.interp(t, imu.times, imu.acceleration[:, i]) for i in range(3)])
    R = np.eye(3)
    alpha, beta = np.zeros(3), np.zeros(3)
    alpha_bias, beta_bias = np.zeros((3, 3)), np.zeros((3, 3))
    steps = np.diff(t)
    half_turns = Rotation.from_rotvec(0.25 * (rate[1:] + rate[:-1]) * steps[:, None]).as_matrix()
    for i, dt in enumerate(steps):
        middle = R @ half_turns[i]
        a = middle @ (0.5 * (felt[i] + felt[i + 1]))
        alpha += beta * dt + 0.5 * a * dt**2
        alpha_bias += beta_bias * dt + 0.5 * middle * dt**2
        beta += a * dt
        beta_bias += middle * dt
        R = middle @ half_turns[i]
    return alpha, beta, alpha_bias, beta_bias


def rotations_at(imu: Imu, orientation: Rotation, at: FloatArray) -> Rotation:
    """Orientations between IMU samples, by slerp."""
    return Slerp(imu.times, orientation)(np.clip(at, imu.times[0], imu.times[-1]))
