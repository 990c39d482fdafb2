"""Moments that a tracker follows: a frame, and what else is known about the camera's motion since the frame before."""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from rholoc.errors import InvalidRecording
from rholoc.geometry import ByteArray, FloatArray, interpolated_poses
from rholoc.recordings import Imu, PoseKind, Recording
from rholoc.recordings.frames.live_camera import LiveCamera

_FILM_FPS = 30.0  # of pictures without times
_LATE_S = 0.1
_GRAVITY_HINT = "Give R_camera_imu in camera.json, or use --motion pictures."

Reading = tuple[float, FloatArray, FloatArray]
"""Time [s], acceleration (3,) [m/s²] and angular velocity (3,) [rad/s] in the camera's axes."""


class Motion(StrEnum):
    """A tracker's source of motion between answers."""

    ODOMETRY = "odometry"  # poses in a frame of their own
    IMU = "imu"  # acceleration and rotation rate
    PICTURES = "pictures"  # nothing else


@dataclass(frozen=True, eq=False)
class Moment:
    """A frame of a camera.

    Attributes:
        number: the frame's.
        time_s: when it was taken.
        image: (H, W, 3) BGR.
        T_odom_camera: (4, 4) the camera's pose by odometry, or None.
        readings: of the IMU since the frame before.
    """

    number: int
    time_s: float
    image: ByteArray
    T_odom_camera: FloatArray | None = None
    readings: tuple[Reading, ...] = ()


def odometry_of(recording: Recording) -> FloatArray | None:
    """Poses T_odom_camera (N, 4, 4) at a recording's frames, NaN where unknown, by its odometry, else by its own poses
    if these are by a tracker; None without either.
    """
    if recording.odometry is not None:
        times, rows = recording.frames.times, recording.odometry.times
        inside = np.flatnonzero((times >= rows[0]) & (times <= rows[-1]))
        poses = np.full((len(times), 4, 4), np.nan)
        poses[inside] = interpolated_poses(rows, recording.odometry.T_odom_camera, times[inside])
        return poses
    given = recording.poses
    return given.T_map_camera if given is not None and given.kind is PoseKind.ODOMETRY else None


def film_times(recording: Recording) -> FloatArray:
    """Times (N,) of a recording's frames [s]; frames without times count as 30 per second."""
    frames = recording.frames
    return frames.times if frames.timed else frames.times / _FILM_FPS


def recorded_moments(recording: Recording, motion: Motion, odometry: FloatArray | None = None) -> Iterator[Moment]:
    """Iterate over a recording's frames in order.

    Args:
        recording: the frames, and the IMU.
        motion: source of motion to include in the moments.
        odometry: (N, 4, 4) T_odom_camera at the frames, NaN where unknown; for ``Motion.ODOMETRY``.

    Raises:
        InvalidRecording: ``Motion.IMU`` without an IMU, with unknown mounting or without gravity; a frame is damaged.
    """
    readings = _readings(recording.imu) if motion is Motion.IMU else iter(())
    reading = next(readings, None)
    images = recording.frames.images(range(len(recording.frames.times)))
    for row, (time_s, image) in enumerate(zip(film_times(recording).tolist(), images, strict=True)):
        since = []
        while reading is not None and reading[0] <= time_s:
            since.append(reading)
            reading = next(readings, None)
        is_known = odometry is not None and motion is Motion.ODOMETRY and np.isfinite(odometry[row]).all()
        T_odom_camera = odometry[row] if odometry is not None and is_known else None
        yield Moment(int(recording.frames.numbers[row]), time_s, image, T_odom_camera, tuple(since))


def paced(moments: Iterator[Moment]) -> Iterator[Moment]:
    """Iterate over a recording's moments at its own pace; those that come more than 0.1 s late are left out."""
    offset_s: float | None = None
    for moment in moments:
        offset_s = time.monotonic() - moment.time_s if offset_s is None else offset_s
        early_s = moment.time_s + offset_s - time.monotonic()
        if early_s > -_LATE_S:
            time.sleep(max(0.0, early_s))
            yield moment


def live_moments(camera: LiveCamera) -> Iterator[Moment]:
    """Iterate over the newest frames of a live camera. Raises InvalidInput after five seconds without a frame."""
    for number, (time_s, image) in enumerate(camera.frames()):
        yield Moment(number, time_s, image)


def _readings(imu: Imu | None) -> Iterator[Reading]:
    """Iterate over the readings. Raises InvalidRecording without an IMU, a known mounting, or gravity in it."""
    if imu is None:
        raise InvalidRecording("The recording has no IMU.", "Use --motion pictures.")
    if imu.R_camera_imu is None or not imu.includes_gravity:
        raise InvalidRecording("The IMU's axes in the camera are not known, or it leaves gravity out.", _GRAVITY_HINT)
    acceleration, rate = imu.acceleration @ imu.R_camera_imu.T, imu.angular_velocity @ imu.R_camera_imu.T
    yield from zip(imu.times.tolist(), acceleration, rate, strict=True)
