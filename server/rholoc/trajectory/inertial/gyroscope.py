"""Calibrate the gyroscope against camera rotations: time offset, bias, mounting."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from rholoc.geometry import FloatArray, aligning_rotation, rotation_angles
from rholoc.recordings import Imu

_NARROW_OFFSETS_S = np.arange(-0.25, 0.2501, 0.01)  # searched first, for clocks meant to be the same …
_WIDE_OFFSETS_S = np.arange(-2.0, 2.001, 0.01)  # … and if none of these fits well
_USUAL_RESIDUAL_DEG, _BETTER = 0.3, 0.5  # maximum residual ratio of another offset
_FINE_OFFSETS_S = np.arange(-0.01, 0.0101, 0.001)
_MIN_INTERVAL_S = 0.2  # rotations over shorter times are mostly noise
_MIN_INTERVALS = 7
_MAX_RESIDUAL_DEG = 2.0  # over short intervals, of a gyroscope mounted on the camera
_MAX_ERROR_RAD = np.radians(5.0)  # of an interval; larger errors are clipped
_OFFSET_COST_RAD_S = 1e-3  # prior towards an offset of zero
_OTHER_MOUNTING_RAD = np.radians(15.0)  # maximum angle between equal mountings
_CLEARLY_BETTER = 3.0  # residual ratio by which another mounting overrules the recording's
_MAX_MOUNTING_SIGMA_DEG = 3.0  # of an estimated mounting that counts as known
_NORM_TO_SIGMA = 0.65  # sigma of one axis from the median norm of a normal three-vector
_MAX_APART_RAD = np.radians(6.0)  # between a camera's rotation and the gyroscope's: a constant …
_MAX_GAP_S = 0.1  # between readings; also this many median intervals
_MAX_GAP_INTERVALS = 5
_DRIFT_RAD_S = np.radians(0.1)  # … plus this for every second
_MAX_AT_ONCE = 50_000  # orientations in memory


@dataclass(frozen=True, eq=False)
class GyroCalibration:
    """Calibration of a gyroscope to a camera.

    Attributes:
        time_offset_s: IMU time minus frame time.
        time_offset_sigma_s: standard deviation; large if the camera hardly turns.
        bias: (3,) of the gyroscope [rad/s].
        bias_sigma: standard deviation in every axis [rad/s].
        R_camera_imu: (3, 3) the recording's, or estimated if the recording has none or a wrong one.
        contradicts_recording: whether it differs much from the recording's.
        mounting_sigma_deg: standard deviation of an estimated rotation in its weakest axis; 0 if not estimated.
        residual_deg: median angle between camera and gyroscope rotations over short intervals.
    """

    time_offset_s: float
    time_offset_sigma_s: float
    bias: FloatArray
    bias_sigma: float
    R_camera_imu: FloatArray
    contradicts_recording: bool
    mounting_sigma_deg: float
    residual_deg: float

    @property
    def mounting_is_known(self) -> bool:
        """Whether the recording states the IMU's mounting, or its estimate has a sigma of at most 3°."""
        return self.mounting_sigma_deg <= _MAX_MOUNTING_SIGMA_DEG

    @property
    def fits(self) -> bool:
        """Whether camera and gyroscope measure the same rotations: a median residual of at most 2°."""
        return self.residual_deg <= _MAX_RESIDUAL_DEG


def orientations(imu: Imu, bias: FloatArray) -> Rotation:
    """Integrate the gyroscope, less its ``bias`` (3,) [rad/s], by the midpoint rule: R_start_imu at all times (N,)."""
    rate = imu.angular_velocity - bias
    steps = Rotation.from_rotvec(0.5 * (rate[1:] + rate[:-1]) * np.diff(imu.times)[:, None])
    R = np.empty((len(imu.times), 3, 3))
    R[0] = np.eye(3)
    for i, step in enumerate(steps.as_matrix()):
        R[i + 1] = R[i] @ step
    return Rotation.from_matrix(R)


def calibrate_gyro(times: FloatArray, R_world_camera: FloatArray, imu: Imu) -> GyroCalibration | None:
    """Calibrate the gyroscope to camera rotations (N, 3, 3) at ``times`` (N,) [s]; None with fewer than seven common
    intervals.

    Searches the time offset; solves for the bias and, if unknown, the mounting (Wahba's problem on rotation vectors). A
    stated mounting is replaced if one more than 15° away fits three times better: a phone turned to landscape, a
    recorder with its own axes.
    """
    stated = _fit(times, R_world_camera, imu)
    if stated is None or imu.R_camera_imu is None:
        return stated
    found = _fit(times, R_world_camera, replace(imu, R_camera_imu=None))
    if found is None or found.mounting_sigma_deg > _MAX_MOUNTING_SIGMA_DEG:
        return stated
    apart_rad = float(rotation_angles(found.R_camera_imu, imu.R_camera_imu))
    if apart_rad < _OTHER_MOUNTING_RAD or _CLEARLY_BETTER * found.residual_deg > stated.residual_deg:
        return stated
    return replace(found, contradicts_recording=True)


def _fit(times: FloatArray, R_world_camera: FloatArray, imu: Imu) -> GyroCalibration | None:
    """Calibration with a small time offset, or a large one that fits clearly better; None with under 7 intervals."""
    near = _fit_within(_NARROW_OFFSETS_S, times, R_world_camera, imu)
    if near is None or near.residual_deg <= _USUAL_RESIDUAL_DEG:
        return near
    far = _fit_within(_WIDE_OFFSETS_S, times, R_world_camera, imu)
    return near if far is None or far.residual_deg > _BETTER * near.residual_deg else far


def _fit_within(offsets: FloatArray, times: FloatArray, R_world_camera: FloatArray, imu: Imu) -> GyroCalibration | None:
    """Calibration with one of the ``offsets`` [s], refined to 1 ms; None with fewer than seven common intervals."""
    rows = spaced_rows(times, _MIN_INTERVAL_S)
    margin = offsets[-1] + _FINE_OFFSETS_S[-1]
    rows = rows[(times[rows] > imu.times[0] + margin) & (times[rows] < imu.times[-1] - margin)]
    if len(rows) <= _MIN_INTERVALS:
        return None
    t, R = times[rows], Rotation.from_matrix(R_world_camera[rows])
    spans = np.diff(t)
    camera = (R[:-1].inv() * R[1:]).as_rotvec()
    bias = np.zeros(3)
    offset = 0.0
    R_camera_imu = np.eye(3) if imu.R_camera_imu is None else imu.R_camera_imu
    for fine in (False, False, True):
        slerp = Slerp(imu.times, orientations(imu, bias))
        fits = []
        candidates = offset + _FINE_OFFSETS_S if fine else offsets
        for candidate, gyro in zip(candidates.tolist(), _turns(slerp, t, candidates), strict=True):
            mounting = imu.R_camera_imu if imu.R_camera_imu is not None else aligning_rotation(gyro, camera)
            remaining = gyro - camera @ mounting
            drift = np.median(remaining / spans[:, None], axis=0)
            error = np.linalg.norm(remaining - drift * spans[:, None], axis=1)
            cost = float(np.mean(np.minimum(error, _MAX_ERROR_RAD))) + _OFFSET_COST_RAD_S * abs(candidate)
            fits.append((cost, candidate, drift, mounting, error))
        _, offset, drift, R_camera_imu, error = min(fits, key=lambda fit: fit[0])
        bias = bias + drift
    typical = float(np.median(error))
    sigma = max(_NORM_TO_SIGMA * typical, 1e-6)
    return GyroCalibration(
        offset,
        _time_sigma_s(imu, t + offset, sigma),
        bias,
        sigma / float(np.sqrt(np.sum(spans**2))),
        R_camera_imu,
        False,
        0.0 if imu.R_camera_imu is not None else _mounting_sigma_deg(camera, sigma),
        float(np.degrees(typical)),
    )


def _turns(slerp: Slerp, t: FloatArray, offsets: FloatArray) -> Iterator[FloatArray]:
    """For each time offset, the rotation vectors (N - 1, 3) [rad] from each orientation at ``t`` (N,) + offset to the
    next.
    """
    for batch in np.array_split(offsets, min(len(offsets), math.ceil(len(offsets) * len(t) / _MAX_AT_ONCE))):
        turned = slerp((batch[:, None] + t).ravel())
        vectors = np.zeros((len(batch) * len(t), 3))
        vectors[:-1] = (turned[:-1].inv() * turned[1:]).as_rotvec()
        yield from vectors.reshape(len(batch), len(t), 3)[:, :-1]


def camera_rotations(imu: Imu, gyro: GyroCalibration, times: FloatArray) -> Rotation:
    """R_start_camera at the frames' ``times`` (N,) [s] by the gyroscope alone; constant outside the IMU's times."""
    there = np.clip(times + gyro.time_offset_s, imu.times[0], imu.times[-1])
    mounting = Rotation.from_matrix(gyro.R_camera_imu)
    return mounting * Slerp(imu.times, orientations(imu, gyro.bias))(there) * mounting.inv()


def allowed_apart(seconds: FloatArray) -> FloatArray:
    """Maximum angle (N,) [rad] between a camera's rotation over ``seconds`` (N,) and the gyroscope's: 6° + 0.1°/s."""
    return np.asarray(_MAX_APART_RAD + _DRIFT_RAD_S * np.abs(seconds))


def longest_interval_s(imu: Imu) -> float:
    """Maximum interval between two IMU readings [s]; a longer one is a gap: 0.1 s, or five medians if longer."""
    return max(_MAX_GAP_S, _MAX_GAP_INTERVALS * float(np.median(np.diff(imu.times))))


def spaced_rows(times: FloatArray, interval_s: float) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Rows (M,) of ``times`` (N,) [s] at least ``interval_s`` apart, beginning with the first."""
    rows = [0]
    for row in range(1, len(times)):
        if times[row] - times[rows[-1]] >= interval_s:
            rows.append(row)
    return np.array(rows, dtype=np.int64)


def _time_sigma_s(imu: Imu, t: FloatArray, sigma: float) -> float:
    """Standard deviation of the time offset [s], given the sigma [rad] of an interval's rotation between times ``t``
    (N,). A shift changes an interval's rotation by its ends' rate difference.
    """
    rate = np.column_stack([np.interp(t, imu.times, axis) for axis in imu.angular_velocity.T])
    return sigma / max(float(np.linalg.norm(np.diff(rate, axis=0))), 1e-9)


def _mounting_sigma_deg(camera: FloatArray, sigma: float) -> float:
    """Standard deviation [°] of Wahba's rotation in its weakest axis, from rotation vectors (N, 3), ``sigma`` [rad]."""
    information = np.sum(camera**2) * np.eye(3) - camera.T @ camera
    return float(np.degrees(sigma / np.sqrt(max(float(np.linalg.eigvalsh(information)[0]), 1e-12))))
