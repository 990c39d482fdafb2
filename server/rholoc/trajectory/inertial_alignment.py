"""Scale and gravity from the accelerometer: linear visual-inertial alignment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Slerp

from rholoc.geometry import FloatArray
from rholoc.recordings import Imu
from rholoc.trajectory.gyroscope import GyroCalibration, orientations

GRAVITY = 9.81
MAX_SCALE_SIGMA = 0.1  # relative; a scale less certain than this is no scale
_ARM_S = 0.25  # of a hat function: shorter ones see the cameras' noise, longer ones less of the motion
_LONGEST_ARM_S = 1.0
_FEWEST_HATS = 12
_NOISE = 0.05  # m/s², what a hat's equation is typically missed by; only its ratio to the priors' deviations counts
_BIAS_SIGMA = 0.3  # m/s², of the accelerometer
_LEVER_SIGMA_M = 0.05  # between camera and IMU: the size of a phone
_REMOVED_GRAVITY_SIGMA = 0.3  # m/s², what remains of gravity where the device has taken it out
_ROUNDS = 5  # of reweighting
_BLOCKS = 8  # of the jackknife
_TURNING = 0.2  # rad/s, rms, from which a camera turns

_SCALE, _GRAVITY, _BIAS, _LEVER = slice(0, 1), slice(1, 4), slice(4, 7), slice(7, 10)
_UNKNOWNS = 10


@dataclass(frozen=True, eq=False)
class InertialAlignment:
    """What the accelerometer says about a trajectory of arbitrary frame and scale.

    Attributes:
        scale: metres per unit of the trajectory.
        scale_sigma: its relative standard uncertainty.
        up: (3,), unit, in the trajectory's frame; None where the acceleration comes without gravity.
        up_sigma_deg: its standard uncertainty; NaN without ``up``.
        bias: (3,) m/s², of the accelerometer.
        lever_m: (3,) the IMU's place in the camera's axes.
        residual: the median misfit of the accelerations, m/s².
        why_no_scale: one line on why the scale is not to be used, or empty.
    """

    scale: float
    scale_sigma: float
    up: FloatArray | None
    up_sigma_deg: float
    bias: FloatArray
    lever_m: FloatArray
    residual: float
    why_no_scale: str


def align_inertially(
    times: FloatArray, T_world_camera: FloatArray, imu: Imu, gyro: GyroCalibration
) -> InertialAlignment | None:
    """Scale and gravity from poses (N, 4, 4) of arbitrary frame and scale at ``times`` (N,), and the IMU.

    The equation of motion s p̈ + R̈ l = R a + g, a being the acceleration felt and l the IMU's place in the camera's
    axes, is multiplied by hat functions whose corners are keyframes. Integrated by parts, the second derivative of a
    path becomes the difference of two mean velocities: neither velocities nor a differentiated path are needed. What
    remains is linear in the scale s, gravity g, l and the accelerometer's bias. Uncertainties are those of a jackknife
    over blocks of time, for neighbouring hats err alike; they do not see that noise of the cameras makes the scale too
    small, by its share of the accelerations' variance.

    None where IMU and poses have too little time in common.
    """
    at, A, b = _equations(times, T_world_camera, imu, gyro)
    if len(at) < _FEWEST_HATS:
        return None
    x = _solve(A, b, imu.includes_gravity)
    blocks = np.array_split(np.arange(len(at)), _BLOCKS)
    without = np.array(
        [_solve(np.delete(A, block, axis=0), np.delete(b, block, axis=0), imu.includes_gravity) for block in blocks]
    )
    variance = (_BLOCKS - 1) / _BLOCKS * np.sum((without - without.mean(axis=0)) ** 2, axis=0)
    scale, g = float(x[0]), x[_GRAVITY]
    scale_sigma = float(np.sqrt(variance[0])) / max(abs(scale), 1e-12)
    up_sigma_deg = float(np.degrees(np.sqrt(variance[_GRAVITY].sum()) / GRAVITY))
    return InertialAlignment(
        scale,
        scale_sigma,
        -g / np.linalg.norm(g) if imu.includes_gravity else None,
        up_sigma_deg if imu.includes_gravity else float("nan"),
        x[_BIAS],
        x[_LEVER],
        float(np.median(_misfits(A, b, x))),
        _why_no_scale(scale, scale_sigma, imu),
    )


def _why_no_scale(scale: float, sigma: float, imu: Imu) -> str:
    if sigma > MAX_SCALE_SIGMA:
        turning = float(np.sqrt(np.mean(np.sum(imu.angular_velocity**2, axis=1)))) > _TURNING
        motion = "turned but hardly moved" if turning else "hardly sped up or slowed down"
        return f"The accelerometer leaves the scale open ({sigma:.0%}): the camera {motion}. Start and stop more often."
    if scale <= 0:
        return "The accelerometer contradicts the cameras: its sign or its axes are not what the recording says."
    return ""


def _equations(
    times: FloatArray, T_world_camera: FloatArray, imu: Imu, gyro: GyroCalibration
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """For every hat its time (H,), and A (H, 3, 10), b (H, 3) of A x = b for x = (scale, gravity, bias, lever)."""
    t = times + gyro.time_offset_s
    inside = (t >= imu.times[0]) & (t <= imu.times[-1])
    t, T = t[inside], T_world_camera[inside]
    before = np.searchsorted(t, t - _ARM_S, side="right") - 1
    after = np.searchsorted(t, t + _ARM_S)
    middle = np.flatnonzero((before >= 0) & (after < len(t)))
    middle = middle[
        (t[after[middle]] - t[middle] <= _LONGEST_ARM_S) & (t[middle] - t[before[middle]] <= _LONGEST_ARM_S)
    ]
    if len(middle) == 0:
        return np.zeros(0), np.zeros((0, 3, _UNKNOWNS)), np.zeros((0, 3))
    before, after = before[middle], after[middle]
    corners = t[before], t[middle], t[after]
    area = (corners[2] - corners[0]) / 2

    def bend(values: FloatArray) -> FloatArray:
        """The mean second derivative under each hat, of values at the keyframes."""
        shape = (-1, *([1] * (values.ndim - 1)))
        rising = (values[middle] - values[before]) / (corners[1] - corners[0]).reshape(shape)
        falling = (values[after] - values[middle]) / (corners[2] - corners[1]).reshape(shape)
        return np.asarray((falling - rising) / area.reshape(shape))

    R_start_imu = orientations(imu, gyro.bias)
    felt = _under_hats(imu.times, R_start_imu.apply(imu.acceleration), corners)
    turned = _under_hats(imu.times, R_start_imu.as_matrix().reshape(-1, 9), corners).reshape(-1, 3, 3)
    there = Slerp(imu.times, R_start_imu)(corners[1]).as_matrix()
    R_world_start = T[middle, :3, :3] @ gyro.R_camera_imu @ np.swapaxes(there, 1, 2)
    A = np.zeros((len(middle), 3, _UNKNOWNS))
    A[:, :, _SCALE] = bend(T[:, :3, 3])[:, :, None]
    A[:, :, _GRAVITY] = -np.eye(3)
    A[:, :, _BIAS] = R_world_start @ turned
    A[:, :, _LEVER] = bend(T[:, :3, :3])
    return corners[1], A, np.einsum("hij,hj->hi", R_world_start, felt)


def _under_hats(
    times: FloatArray, values: FloatArray, corners: tuple[FloatArray, FloatArray, FloatArray]
) -> FloatArray:
    """The means (H, K) of values (M, K) at ``times`` (M,), weighted by hats of three corners (H,)."""
    begin, top, end = corners
    integral = _cumulative(times, values)
    moment = _cumulative(times, values * times[:, None])

    def between(table: FloatArray, a: FloatArray, b: FloatArray) -> FloatArray:
        columns = [np.interp(b, times, column) - np.interp(a, times, column) for column in table.T]
        return np.column_stack(columns)

    rising = between(moment, begin, top) - begin[:, None] * between(integral, begin, top)
    falling = end[:, None] * between(integral, top, end) - between(moment, top, end)
    weighted = rising / (top - begin)[:, None] + falling / (end - top)[:, None]
    return np.asarray(weighted / ((end - begin) / 2)[:, None])


def _cumulative(times: FloatArray, values: FloatArray) -> FloatArray:
    """The integral (M, K) from the first time on, by trapezoids."""
    steps = 0.5 * (values[1:] + values[:-1]) * np.diff(times)[:, None]
    return np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(steps, axis=0)])


def _solve(A: FloatArray, b: FloatArray, includes_gravity: bool) -> FloatArray:
    """x (10,) by reweighted least squares, with priors on all but the scale; gravity's length is held at 9.81."""
    sigmas = np.full(_UNKNOWNS, np.inf)
    sigmas[_BIAS], sigmas[_LEVER] = _BIAS_SIGMA, _LEVER_SIGMA_M
    if not includes_gravity:
        sigmas[_GRAVITY] = _REMOVED_GRAVITY_SIGMA
    prior = np.diag((_NOISE / sigmas) ** 2)
    weights = np.ones(len(b))
    x: FloatArray = np.zeros(_UNKNOWNS)
    for _ in range(_ROUNDS):
        weighted = A * weights[:, None, None]
        information = np.einsum("hij,hik->jk", weighted, A) + prior
        right = np.einsum("hij,hi->j", weighted, b)
        x = np.linalg.lstsq(information, right)[0]
        if includes_gravity:
            x = _with_gravity_of_known_length(information, right, x)
        misfits = _misfits(A, b, x)
        weights = 1 / (1 + (misfits / (3 * max(float(np.median(misfits)), 1e-9))) ** 2)
    return x


def _with_gravity_of_known_length(information: FloatArray, right: FloatArray, x: FloatArray) -> FloatArray:
    """The solution again, gravity moving on the sphere of its known length alone: three steps in tangent planes."""
    for _ in range(3):
        g = np.zeros(_UNKNOWNS)
        g[_GRAVITY] = x[_GRAVITY] * (GRAVITY / np.linalg.norm(x[_GRAVITY]))
        basis = np.delete(np.eye(_UNKNOWNS), np.arange(*_GRAVITY.indices(_UNKNOWNS)), axis=1)
        tangent = np.zeros((_UNKNOWNS, 2))
        tangent[_GRAVITY] = np.linalg.svd(g[None, _GRAVITY])[2][1:].T
        basis = np.column_stack([basis, tangent])
        y = np.linalg.lstsq(basis.T @ information @ basis, basis.T @ (right - information @ g))[0]
        x = g + basis @ y
    return x


def _misfits(A: FloatArray, b: FloatArray, x: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(b - A @ x, axis=1))
