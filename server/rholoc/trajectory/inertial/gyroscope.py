"""The gyroscope against the cameras' rotations: time offset, bias, mounting, and which rotations it contradicts."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from rholoc.geometry import FloatArray, aligning_rotation, rotation_angles
from rholoc.recordings import Imu

_NARROW_OFFSETS_S = np.arange(-0.25, 0.2501, 0.01)  # between clocks that are meant to be one …
_WIDE_OFFSETS_S = np.arange(-2.0, 2.001, 0.01)  # … and where none of those fits well
_USUAL_RESIDUAL_DEG, _BETTER = 0.3, 0.5  # that share of its residual must another offset leave to be believed
_FINE_OFFSETS_S = np.arange(-0.01, 0.0101, 0.001)
_MIN_INTERVAL_S = 0.2  # rotations over shorter times are mostly noise
_FEWEST_INTERVALS = 7
_MAX_RESIDUAL_DEG = 2.0  # over short intervals, of a gyroscope that belongs to the camera
_LARGEST_ERROR_RAD = np.radians(5.0)  # of an interval; larger ones count as this
_OFFSET_COST_RAD_S = 1e-3  # so that nothing is shifted in time for nothing
_OTHER_MOUNTING_RAD = np.radians(15.0)  # from which two mountings are not the same
_CLEARLY_BETTER = 3.0  # times smaller is the residual of a mounting that is believed against the recording
_MAX_MOUNTING_SIGMA_DEG = 3.0  # of a mounting that counts as found
_NORM_TO_SIGMA = 0.65  # of an axis, from the median norm of a three-vector of normal errors
_MAX_APART_RAD = np.radians(6.0)  # between a camera's rotation and the gyroscope's, at once …
_MAX_GAP_S = 0.1  # in the IMU's table, and as many of its intervals
_MAX_GAP_INTERVALS = 5
_DRIFT_RAD_S = np.radians(0.1)  # … and more for every second between


@dataclass(frozen=True, eq=False)
class GyroCalibration:
    """How the gyroscope relates to the camera.

    Attributes:
        time_offset_s: to be added to a frame's time to get the IMU's.
        time_offset_sigma_s: its standard uncertainty; large where the camera hardly turns.
        bias: (3,) rad/s, of the gyroscope.
        bias_sigma: rad/s, its standard uncertainty in every axis.
        R_camera_imu: (3, 3), as the recording says, or found where it does not or is wrong.
        contradicts_recording: whether it is far from what the recording says.
        mounting_sigma_deg: the standard uncertainty of a rotation that was found, in its weakest axis; else 0.
        residual_deg: the median angle between the camera's rotation and the gyroscope's over short intervals.
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
        """Whether the camera turned enough to show how the IMU is mounted, where that was not known."""
        return self.mounting_sigma_deg <= _MAX_MOUNTING_SIGMA_DEG

    @property
    def fits(self) -> bool:
        """Whether camera and gyroscope turn together at all."""
        return self.residual_deg <= _MAX_RESIDUAL_DEG


def orientations(imu: Imu, bias: FloatArray) -> Rotation:
    """The gyroscope integrated: R_start_imu at every IMU time, midpoint rule."""
    rate = imu.angular_velocity - bias
    steps = Rotation.from_rotvec(0.5 * (rate[1:] + rate[:-1]) * np.diff(imu.times)[:, None])
    R = np.empty((len(imu.times), 3, 3))
    R[0] = np.eye(3)
    for i, step in enumerate(steps.as_matrix()):
        R[i + 1] = R[i] @ step
    return Rotation.from_matrix(R)


def calibrate_gyro(times: FloatArray, R_world_camera: FloatArray, imu: Imu) -> GyroCalibration | None:
    """Fit the gyroscope to the rotations (N, 3, 3) of the camera at ``times`` (N,); None without common rotations.

    The time offset is searched, bias and (where unknown) mounting are solved for: Wahba's problem on rotation vectors.
    A mounting that the recording states is not believed where another one fits several times better: a phone turned to
    landscape, a recorder with axes of its own.
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
    near = _fit_within(_NARROW_OFFSETS_S, times, R_world_camera, imu)
    if near is None or near.residual_deg <= _USUAL_RESIDUAL_DEG:
        return near
    far = _fit_within(_WIDE_OFFSETS_S, times, R_world_camera, imu)
    return near if far is None or far.residual_deg > _BETTER * near.residual_deg else far


def _fit_within(offsets: FloatArray, times: FloatArray, R_world_camera: FloatArray, imu: Imu) -> GyroCalibration | None:
    rows = spaced_rows(times, _MIN_INTERVAL_S)
    margin = offsets[-1] + _FINE_OFFSETS_S[-1]
    rows = rows[(times[rows] > imu.times[0] + margin) & (times[rows] < imu.times[-1] - margin)]
    if len(rows) <= _FEWEST_INTERVALS:
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
        for candidate in (offset + _FINE_OFFSETS_S if fine else offsets).tolist():
            turned = slerp(t + candidate)
            gyro = (turned[:-1].inv() * turned[1:]).as_rotvec()
            mounting = imu.R_camera_imu if imu.R_camera_imu is not None else aligning_rotation(gyro, camera)
            remaining = gyro - camera @ mounting
            drift = np.median(remaining / spans[:, None], axis=0)
            error = np.linalg.norm(remaining - drift * spans[:, None], axis=1)
            cost = float(np.mean(np.minimum(error, _LARGEST_ERROR_RAD))) + _OFFSET_COST_RAD_S * abs(candidate)
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


def camera_rotations(imu: Imu, gyro: GyroCalibration, times: FloatArray) -> Rotation:
    """R_start_camera at the frames' ``times`` (N,) by the gyroscope alone; at rest outside the IMU's own times."""
    there = np.clip(times + gyro.time_offset_s, imu.times[0], imu.times[-1])
    mounting = Rotation.from_matrix(gyro.R_camera_imu)
    return mounting * Slerp(imu.times, orientations(imu, gyro.bias))(there) * mounting.inv()


def allowed_apart(seconds: FloatArray) -> FloatArray:
    """The angle in radians by which a camera's rotation over so many seconds may differ from the gyroscope's."""
    return np.asarray(_MAX_APART_RAD + _DRIFT_RAD_S * np.abs(seconds))


def longest_interval_s(imu: Imu) -> float:
    """From one reading of an IMU's table to the next: over a longer interval it carries nothing."""
    return max(_MAX_GAP_S, _MAX_GAP_INTERVALS * float(np.median(np.diff(imu.times))))


def spaced_rows(times: FloatArray, interval_s: float) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Rows at least ``interval_s`` apart, beginning with the first."""
    rows = [0]
    for row in range(1, len(times)):
        if times[row] - times[rows[-1]] >= interval_s:
            rows.append(row)
    return np.array(rows, dtype=np.int64)


def _time_sigma_s(imu: Imu, t: FloatArray, sigma: float) -> float:
    """Of the time offset: shifted in time, an interval's rotation changes by the rates' difference between its ends."""
    rate = np.column_stack([np.interp(t, imu.times, axis) for axis in imu.angular_velocity.T])
    return sigma / max(float(np.linalg.norm(np.diff(rate, axis=0))), 1e-9)


def _mounting_sigma_deg(camera: FloatArray, sigma: float) -> float:
    """Of Wahba's rotation, from the rotation vectors (N, 3) it rests on: about an axis, only those across it tell."""
    information = np.sum(camera**2) * np.eye(3) - camera.T @ camera
    return float(np.degrees(sigma / np.sqrt(max(float(np.linalg.eigvalsh(information)[0]), 1e-12))))
