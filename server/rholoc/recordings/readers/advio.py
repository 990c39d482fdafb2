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

from __future__ import annotations

from pathlib import Path

from rholoc.recordings.imu_normalisation import (
    ImuConvention,
    Samples,
    normalise_imu,
    with_sign_by_poses,
)
from rholoc.recordings.logged_table import is_bare_table, read_logged_table
from rholoc.recordings.pose_table import PoseTable, match_poses, poses_from_rows
from rholoc.recordings.readers._apple import R_PORTRAIT_CAMERA_IMU, opencv_camera, z_up
from rholoc.recordings.readers._frames import require_video, timed_video
from rholoc.recordings.recording import Recording, RecordingFormat


def recognises(folder: Path) -> bool:
    """Whether the iPhone's video and tables are there, with their numbers of columns."""
    phone = _phone(folder)
    return (
        (phone / "frames.mov").is_file()
        and is_bare_table(phone / "frames.csv", 2)
        and is_bare_table(phone / "accelerometer.csv", 4)
        and is_bare_table(_gyroscope(phone), 4)
    )


def read(folder: Path) -> Recording:
    """Read the folder.

    Raises:
        InvalidRecording: a table or the video is broken, or they contradict each other.
        InvalidTrajectory: the poses are broken.
    """
    phone = _phone(folder)
    times = read_logged_table(phone / "frames.csv").numbered(0)[:, 0]
    start = times[0]
    timed = timed_video(require_video(phone, "frames"), times - start, "frames.csv")
    felt = read_logged_table(phone / "accelerometer.csv").numbered(0, 1, 2, 3)
    turned = read_logged_table(_gyroscope(phone)).numbered(0, 1, 2, 3)
    imu, warnings = normalise_imu(
        Samples(felt[:, 0], felt[:, 1:]), Samples(turned[:, 0], turned[:, 1:]), ImuConvention(), R_PORTRAIT_CAMERA_IMU
    )
    poses = None
    arkit = phone / "arkit.csv"
    if arkit.is_file():
        rows = read_logged_table(arkit).numbered(0, 1, 2, 3, 5, 6, 7, 4)
        table = PoseTable(rows[:, 0] - start, z_up(opencv_camera(poses_from_rows(rows[:, 1:], arkit.name))))
        poses = match_poses(table, timed.frames)
        known = poses.T_map_camera[poses.known]
        imu, sign_warnings = with_sign_by_poses(imu, timed.frames.times[poses.known], known[:, :3, :3])
        warnings += sign_warnings
    return Recording(
        name=folder.resolve().name,
        path=folder,
        frames=timed.frames,
        imu=imu,
        poses=poses,
        format=RecordingFormat.ADVIO,
        warnings=(*timed.warnings, *warnings),
    )


def _phone(folder: Path) -> Path:
    return folder / "iphone" if (folder / "iphone").is_dir() else folder


def _gyroscope(phone: Path) -> Path:
    return phone / "gyro.csv" if (phone / "gyro.csv").is_file() else phone / "gyroscope.csv"
