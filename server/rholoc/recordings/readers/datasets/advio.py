"""ADVIO, a dataset of an iPhone's recordings: tables without headers, in seconds.

::

    iphone/frames.mov         shown upright
    iphone/frames.csv         time, frame                      row i is frame i
    iphone/accelerometer.csv  time, x, y, z                    m/s², gravity's reaction upwards, CoreMotion's axes
    iphone/gyro.csv           time, x, y, z                    rad/s
    iphone/arkit.csv          time, x, y, z, qw, qx, qy, qz    of the device held upright, y up

The dataset's page has the acceleration in g; the files have it in m/s². Its own tools count the times of frames and
ARKit from the first frame, and those of the IMU as they are; so do we.
"""

from pathlib import Path

from rholoc.recordings.imu_normalisation import (
    ImuConvention,
    Samples,
    normalise_imu,
    with_sign_by_poses,
)
from rholoc.recordings.readers._apple import R_PORTRAIT_CAMERA_IMU, read_arkit_poses
from rholoc.recordings.readers._frames import require_video, timed_video
from rholoc.recordings.recording import Recording
from rholoc.recordings.tables.logged_table import is_bare_table, read_logged_table

TABLES = ("*frames.csv", "*accelerometer.csv", "*gyro.csv", "*gyroscope.csv", "*arkit.csv")


def recognises(folder: Path) -> bool:
    """Whether there are the iPhone's ``frames.mov``, ``frames.csv`` (2 columns) and two IMU files (4 each)."""
    phone = _phone(folder)
    return (
        (phone / "frames.mov").is_file()
        and is_bare_table(phone / "frames.csv", 2)
        and is_bare_table(phone / "accelerometer.csv", 4)
        and is_bare_table(_gyroscope(phone), 4)
    )


def read(folder: Path) -> Recording:
    """Read a recording of this format from its folder; times of frames and poses count from the first frame.

    Raises:
        InvalidRecording: a table or the video is broken, or they contradict each other.
        InvalidTrajectory: the poses are broken.
    """
    phone = _phone(folder)
    times = read_logged_table(phone / "frames.csv").numbered(0)[:, 0]
    start = float(times[0])
    timed = timed_video(require_video(phone, "frames"), times - start, "frames.csv")
    poses = read_arkit_poses(phone / "arkit.csv", timed.frames, start)
    accelerometer, gyroscope = (
        Samples.from_rows(read_logged_table(path).numbered(0, 1, 2, 3))
        for path in (phone / "accelerometer.csv", _gyroscope(phone))
    )
    imu, imu_warnings = normalise_imu(accelerometer, gyroscope, ImuConvention(), R_PORTRAIT_CAMERA_IMU)
    imu, sign_warnings = with_sign_by_poses(imu, timed.frames.times, poses)
    return Recording(
        timed.frames,
        imu=imu,
        poses=poses,
        warnings=(*timed.warnings, *imu_warnings, *sign_warnings),
    )


def _phone(folder: Path) -> Path:
    """The folder of the iPhone's files: ``iphone``, or the folder itself if there is none."""
    return folder / "iphone" if (folder / "iphone").is_dir() else folder


def _gyroscope(phone: Path) -> Path:
    """The gyroscope's table: ``gyro.csv``, else ``gyroscope.csv``, which need not exist."""
    return phone / "gyro.csv" if (phone / "gyro.csv").is_file() else phone / "gyroscope.csv"
