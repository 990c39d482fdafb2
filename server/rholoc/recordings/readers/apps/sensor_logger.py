"""Sensor Logger (Android and iOS): a table a sensor, columns ``time,seconds_elapsed,z,y,x``, nanoseconds since 1970.

::

    Camera/MILLISECONDS.mp4    or an image a frame, named by milliseconds since 1970
    Gyroscope.csv              rad/s
    TotalAcceleration.csv      m/s², gravity included; Android alone
    Accelerometer.csv          m/s², without gravity
    Gravity.csv                m/s²
    Metadata.csv               platform, standardisation

On iOS the sign is Apple's unless the app was set to standardise.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from rholoc.errors import InvalidRecording
from rholoc.recordings.frames.image_decoding import IMAGE_SUFFIXES
from rholoc.recordings.frames.image_folder import number_in_name
from rholoc.recordings.frames.video import read_video
from rholoc.recordings.imu_normalisation import ImuConvention, Samples, interpolated, normalise_imu
from rholoc.recordings.readers._frames import TimedFrames, find_video, timed_images
from rholoc.recordings.recording import Recording
from rholoc.recordings.tables.logged_table import has_columns, read_logged_table

TABLES = ("gyroscope.csv", "totalacceleration.csv", "accelerometer.csv", "gravity.csv", "metadata.csv")
_COLUMNS = ("time", "x", "y", "z")


def recognises(folder: Path) -> bool:
    """Whether ``Gyroscope.csv`` has this app's columns."""
    return has_columns(folder / "Gyroscope.csv", ("time", "seconds_elapsed", "x", "y", "z"))


def read(folder: Path) -> Recording:
    """Read a recording of this format from its folder.

    Raises:
        InvalidRecording: there are no frames or no accelerations, or a file is broken.
    """
    timed = _frames(folder / "Camera")
    gyroscope = _samples(folder / "Gyroscope.csv")
    accelerometer, includes_gravity = _acceleration(folder)
    says = ImuConvention(time_unit="ns", includes_gravity=includes_gravity, apple_sign=_apple_sign(folder))
    imu, imu_warnings = normalise_imu(accelerometer, gyroscope, says)
    return Recording(
        timed.frames,
        imu=imu,
        warnings=(*timed.warnings, *imu_warnings),
    )


def _frames(camera: Path) -> TimedFrames:
    """Frames of the folder ``Camera``, from a video, else from images. Raises InvalidRecording without either."""
    hint = "Switch the camera on in the app, and pack the folder Camera with the tables."
    if not camera.is_dir():
        raise InvalidRecording("The recording has no folder Camera.", hint)
    video = find_video(camera)
    if video is not None:
        frames = read_video(video)
        times = _milliseconds(video) / 1000 + frames.times
        return TimedFrames(replace(frames, times=times), np.arange(len(times)), ())
    images = sorted(path for path in camera.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES)
    if not images:
        raise InvalidRecording("The folder Camera contains neither a video nor images.", hint)
    return timed_images(images, np.array([_milliseconds(path) / 1000 for path in images]))


def _milliseconds(path: Path) -> int:
    """Number in a file's name, milliseconds since 1970. Raises InvalidRecording if there is none."""
    number = number_in_name(path)
    if number is None:
        raise InvalidRecording(f"The name of {path.name} is not a time.", "Keep the file names that the app gives.")
    return number


def _acceleration(folder: Path) -> tuple[Samples, bool]:
    """The accelerations, and whether gravity is in them: measured, or added from a table. Raises InvalidRecording."""
    total, linear, gravity = (folder / name for name in ("TotalAcceleration.csv", "Accelerometer.csv", "Gravity.csv"))
    if total.is_file():
        return _samples(total), True
    if not linear.is_file():
        raise InvalidRecording("The recording has neither TotalAcceleration.csv nor Accelerometer.csv.")
    samples = _samples(linear)
    if not gravity.is_file():
        return samples, False
    return replace(samples, values=samples.values + interpolated(_samples(gravity), samples.times)), True


def _samples(path: Path) -> Samples:
    """Samples of a sensor's table, times as logged. Raises InvalidRecording."""
    return Samples.from_rows(read_logged_table(path).named(*_COLUMNS))


def _apple_sign(folder: Path) -> bool:
    """Whether accelerations have Apple's sign: of a phone with iOS that did not standardise them."""
    path = folder / "Metadata.csv"
    if not has_columns(path, ("platform",)):
        return False
    metadata = read_logged_table(path)
    standardised = "standardisation" in metadata.header and metadata.text("standardisation")[0].lower() == "true"
    return metadata.text("platform")[0].lower() == "ios" and not standardised
