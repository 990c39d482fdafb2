"""Metric, upright positions of all keyframes from the IMU and the directions between pairs of keyframes.

With known rotations, the equations of motion are linear in positions, velocities, gravity and accelerometer bias, and
so are measured directions. One sparse least-squares problem holds both: it needs no first guess, the accelerometer
gives the scale, and the IMU bridges a second or two without usable pictures.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix, csc_matrix, diags_array, vstack
from scipy.sparse.linalg import splu

from rholoc.geometry import BoolArray, FloatArray, IntArray
from rholoc.recordings import GRAVITY, Imu
from rholoc.trajectory.inertial.gyroscope import GyroCalibration, longest_interval_s, orientations
from rholoc.trajectory.visual.directions import PairDirection

_BIAS_SIGMA = 0.3  # m/s²
_GRAVITY_SIGMA = 0.05  # m/s², once its direction is known
_NOISE = 0.03  # m/s² / √Hz, of accelerometer and model errors
_PLACE_SIGMA_M = 0.002
_USUAL_SPEED_M_S = 0.3  # of a walker with a phone, until the distance between two keyframes is known …
_LONGEST_WAY_M = 1.0
_MIN_WAY_M = 0.02  # … and the minimum distance, to convert angular sigmas to lengths
_ROUNDS = 12
_CAUCHY = 2.0
_BACKWARD = 3.0  # sigmas, added to a displacement against its direction
_UNCOVERED = 1e-3  # weight of the equations of motion across a gap in the IMU table
_UNKNOWNS_APART = 6  # gravity and bias, stored before the velocities and positions


@dataclass(frozen=True, eq=False)
class InertialStart:
    """A walk in metres, in the frame of its rotations.

    Attributes:
        up: (3,), unit.
        positions: (K, 3) metres.
        velocities: (K, 3) m/s.
        accelerometer_bias: (3,) m/s².
        residual: median residual of the accelerations, in units of the expected noise.
    """

    up: FloatArray
    positions: FloatArray
    velocities: FloatArray
    accelerometer_bias: FloatArray
    residual: float


def inertial_start(
    times: FloatArray, R: FloatArray, directions: Sequence[PairDirection], imu: Imu, gyro: GyroCalibration
) -> InertialStart | None:
    """Solve for positions from the IMU and directions; None if the IMU covers less than half of the walk, or without
    directions.

    Args:
        times: (K,) of the keyframes [s].
        R: (K, 3, 3) R_world_camera.
        directions: between pairs of keyframes; outliers are down-weighted.
        imu: of the same recording.
        gyro: calibration of the gyroscope to the camera.
    """
    t = times + gyro.time_offset_s
    covered = _covered(t, imu)
    if covered.sum() < len(covered) / 2 or not directions:
        return None
    motion = _equations_of_motion(t, R, imu, gyro, covered)
    first, second = (np.array([getattr(one, end) for one in directions]) for end in ("first", "second"))
    unit = np.array([one.direction for one in directions])
    sigma = np.array([one.sigma_rad for one in directions])
    count = len(times)
    n = len(motion.sigmas)
    way = np.minimum(_USUAL_SPEED_M_S * np.abs(t[second] - t[first]), _LONGEST_WAY_M)
    toward, way_wanted = unit, np.zeros_like(unit)
    robust = np.ones(n // 3 + len(unit))
    unknowns = _UNKNOWNS_APART + 6 * count
    prior, expected = np.full(unknowns, 1e-9), np.zeros(unknowns)
    prior[3:6] = _BIAS_SIGMA**-2
    prior[_UNKNOWNS_APART + 3 : _UNKNOWNS_APART + 6] = 1e6  # the first keyframe is the origin
    x: FloatArray = expected
    for _ in range(_ROUNDS):
        A = vstack([motion.equations, _direction_rows(first, second, toward, unknowns)]).tocsr()
        measured = np.concatenate([motion.measured, way_wanted.ravel()])
        sigmas = np.concatenate([motion.sigmas, np.repeat(sigma * np.maximum(way, _MIN_WAY_M), 3)])
        weights = np.sqrt(np.repeat(robust, 3)) / sigmas
        weighted = diags_array(weights) @ A
        information = (weighted.T @ weighted).tocsc()
        information.setdiag(information.diagonal() + prior)
        x = _solved(information, weighted.T @ (weights * measured) + prior * expected)
        off = (A @ x - measured) / sigmas
        lengths = np.linalg.norm(off[:n].reshape(-1, 3), axis=1)
        positions = x[_UNKNOWNS_APART:].reshape(-1, 6)[:, 3:]
        between = positions[second] - positions[first]
        way = np.linalg.norm(between, axis=1)
        robust = np.concatenate([_weights_of_motion(lengths), _weights_of_directions(between, unit, sigma)])
        expected[:3] = x[:3] * GRAVITY / max(float(np.linalg.norm(x[:3])), 1e-9)
        prior[:3] = _GRAVITY_SIGMA**-2
        toward, way_wanted = _turned_to(between, unit)
    return InertialStart(
        -x[:3] / np.linalg.norm(x[:3]),
        positions,
        x[_UNKNOWNS_APART:].reshape(-1, 6)[:, :3],
        x[3:6],
        float(np.median(lengths)),
    )


def _weights_of_motion(lengths: FloatArray) -> FloatArray:
    """Cauchy weights (N,) of equations of motion, from their residuals' lengths (N,) in sigmas, or in medians
    if the median is larger.
    """
    return np.asarray(1 / (1 + (lengths / (_CAUCHY * max(float(np.median(lengths)), 1.0))) ** 2))


def _weights_of_directions(between: FloatArray, unit: FloatArray, sigma_rad: FloatArray) -> FloatArray:
    """Geman–McClure weights (N,) of directions ``unit`` (N, 3), from the estimated displacements ``between`` (N, 3). A
    displacement against its direction counts as three sigmas further off.
    """
    way_m = np.linalg.norm(between, axis=1)
    along = np.sum(between * unit, axis=1)
    across = np.linalg.norm(between - along[:, None] * unit, axis=1)
    off = across / (sigma_rad * np.maximum(way_m, _MIN_WAY_M)) + _BACKWARD * (along < 0)
    return np.asarray(1 / (1 + (off / _CAUCHY) ** 2) ** 2)


def _turned_to(between: FloatArray, unit: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Constraints that turn displacements towards their measured directions and leave their lengths to the IMU.

    Args:
        between: (N, 3) present displacements [m].
        unit: (N, 3) measured directions.

    Returns:
        Directions (N, 3) along which the displacements stay free: their own, or ``unit`` where a displacement points
        backwards or is shorter than 2 cm; and targets (N, 3) [m] of their components across these.
    """
    way_m = np.linalg.norm(between, axis=1)
    ahead = (np.sum(between * unit, axis=1) > 0) & (way_m > _MIN_WAY_M)
    toward = np.where(ahead[:, None], between / np.maximum(way_m, _MIN_WAY_M)[:, None], unit)
    return toward, way_m[:, None] * (unit - np.sum(unit * toward, axis=1)[:, None] * toward)


def _solved(information: csc_matrix, target: FloatArray) -> FloatArray:
    """Solve the normal equations for all U unknowns (U,): a band matrix, apart from the first six unknowns.

    Factorizing the band takes time linear in the length of the walk.
    """
    n = _UNKNOWNS_APART
    band, border = information[n:, n:].tocsc(), information[n:, :n].toarray()
    factorized = splu(band, permc_spec="NATURAL", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    by_border, alone = factorized.solve(border), factorized.solve(target[n:])
    apart = np.linalg.solve(information[:n, :n].toarray() - border.T @ by_border, target[:n] - border.T @ alone)
    return np.concatenate([apart, alone - by_border @ apart])


@dataclass(frozen=True, eq=False)
class _Motion:
    """Equations of motion: (6 (K - 1), 6 + 6 K) by all unknowns, measured values (6 (K - 1),), standard deviations."""

    equations: coo_matrix
    measured: FloatArray
    sigmas: FloatArray


def _covered(t: FloatArray, imu: Imu) -> BoolArray:
    """Mask (K - 1,) of the intervals between times ``t`` (K,), IMU clock, that its table covers without a gap."""
    inside = (t[:-1] >= imu.times[0]) & (t[1:] <= imu.times[-1])
    gaps = np.flatnonzero(np.diff(imu.times) > longest_interval_s(imu))
    for gap in gaps.tolist():
        inside &= (t[1:] <= imu.times[gap]) | (t[:-1] >= imu.times[gap + 1])
    return np.asarray(inside)


def _equations_of_motion(t: FloatArray, R: FloatArray, imu: Imu, gyro: GyroCalibration, covered: BoolArray) -> _Motion:
    """v_j - v_i - g dt - J_v b = Δv and p_j - p_i - v_i dt - g dt²/2 - J_p b = Δp for every interval, i to j. ``t``
    (K,) are the keyframes' times on the IMU's clock. Intervals not ``covered`` (K - 1,) get 1000 times the sigma.
    """
    n, count = len(t) - 1, len(t)
    dt = np.diff(t)
    speed, way, by_bias_v, by_bias_p = _integrated(imu, gyro, t, R)
    axes = np.arange(3)
    of_speed = 3 * np.arange(n)[:, None] + axes
    of_way = 3 * n + of_speed
    velocity = _UNKNOWNS_APART + 6 * np.arange(count)[:, None] + axes
    place = velocity + 3
    ones, step = np.ones((n, 3)), np.repeat(dt[:, None], 3, axis=1)
    gravity = np.broadcast_to(axes, (n, 3))
    parts = [
        (of_speed, velocity[1:], ones),
        (of_speed, velocity[:-1], -ones),
        (of_speed, gravity, -step),
        (of_way, place[1:], ones),
        (of_way, place[:-1], -ones),
        (of_way, velocity[:-1], -step),
        (of_way, gravity, -0.5 * step**2),
    ]
    for axis in range(3):
        parts.append((of_speed, np.full((n, 3), 3 + axis), -by_bias_v[:, :, axis]))
        parts.append((of_way, np.full((n, 3), 3 + axis), -by_bias_p[:, :, axis]))
    rows, columns, entries = (np.concatenate([part[i].ravel() for part in parts]) for i in range(3))
    sigma = np.concatenate([_NOISE * np.sqrt(dt), np.hypot(_NOISE * dt**1.5 / np.sqrt(3), _PLACE_SIGMA_M)])
    sigma[~np.tile(covered, 2)] /= _UNCOVERED
    equations = coo_matrix((entries, (rows, columns)), shape=(6 * n, _UNKNOWNS_APART + 6 * count))
    return _Motion(equations, np.concatenate([speed.ravel(), way.ravel()]), np.repeat(sigma, 3))


def _direction_rows(first: IntArray, second: IntArray, unit: FloatArray, unknowns: int) -> coo_matrix:
    """(I - d dᵀ) (p_second - p_first) = 0 for every direction d of ``unit`` (N, 3), as (3 N, ``unknowns``)."""
    across = np.eye(3) - unit[:, :, None] * unit[:, None, :]
    row = np.broadcast_to(3 * np.arange(len(unit))[:, None, None] + np.arange(3)[None, :, None], across.shape)
    place = _UNKNOWNS_APART + 3 + np.arange(3)[None, None, :]
    ends = [np.broadcast_to(place + 6 * end[:, None, None], across.shape).ravel() for end in (second, first)]
    entries = np.concatenate([across.ravel(), -across.ravel()])
    places = np.tile(row.ravel(), 2), np.concatenate(ends)
    return coo_matrix((entries, places), shape=(3 * len(unit), unknowns))


def _integrated(
    imu: Imu, gyro: GyroCalibration, t: FloatArray, R: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Velocity changes and displacements (K - 1, 3) by the specific force between keyframes, in the rotations' frame.
    Then their derivatives (K - 1, 3, 3) by the accelerometer bias, in the same order. ``t`` (K,) [s] are the keyframes'
    times on the IMU's clock, ``R`` (K, 3, 3) is R_world_camera.
    """
    R_start_imu = orientations(imu, gyro.bias).as_matrix()
    n = len(t) - 1
    speed, way = np.zeros((n, 3)), np.zeros((n, 3))
    by_v, by_p = np.zeros((n, 3, 3)), np.zeros((n, 3, 3))
    last_row = len(imu.times) - 1
    for k in range(n):
        first = int(np.clip(np.searchsorted(imu.times, t[k], side="right") - 1, 0, last_row - 1))
        last = int(np.clip(np.searchsorted(imu.times, t[k + 1]), first + 1, last_row))
        spans = np.minimum(imu.times[first + 1 : last + 1], t[k + 1]) - np.maximum(imu.times[first:last], t[k])
        R_world_start = R[k] @ gyro.R_camera_imu @ R_start_imu[first].T
        rotations = R_world_start @ R_start_imu[first:last]
        force = 0.5 * (imu.acceleration[first:last] + imu.acceleration[first + 1 : last + 1])
        forces = np.einsum("nij,nj->ni", rotations, force)
        v, p, w, q = np.zeros(3), np.zeros(3), np.zeros((3, 3)), np.zeros((3, 3))
        for dt, f, Q in zip(np.maximum(spans, 0.0).tolist(), forces, rotations, strict=True):
            p += v * dt + 0.5 * f * dt * dt
            q += w * dt - 0.5 * Q * dt * dt
            v += f * dt
            w -= Q * dt
        speed[k], way[k], by_v[k], by_p[k] = v, p, w, q
    return speed, way, by_v, by_p
