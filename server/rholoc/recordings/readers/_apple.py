"""Conversion from Apple's axes.

CoreMotion's axes belong to the device held upright: x right, y up, z out of the screen. ARKit's camera belongs to the
device on its side, as its images are: x right, y up, looking along −z. ARKit's world has y up.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from rholoc.geometry import FloatArray
from rholoc.recordings.recording import FrameSource, GivenPoses, PoseKind
from rholoc.recordings.tables.logged_table import read_logged_table
from rholoc.recordings.tables.pose_table import PoseTable, match_poses, poses_from_rows

R_LANDSCAPE_CAMERA_IMU: FloatArray = np.array([[0.0, -1, 0], [-1, 0, 0], [0, 0, -1]])  # images as ARKit has them
R_PORTRAIT_CAMERA_IMU: FloatArray = np.diag([1.0, -1, -1])  # images turned upright

_T_MAP_ARKIT: FloatArray = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
_R_ARKIT_OPENCV: FloatArray = np.diag([1.0, -1, -1, 1])


def read_arkit_poses(path: Path, frames: FrameSource, start_s: float = 0.0) -> GivenPoses | None:
    """Read ARKit's poses of frames, converted to z up and OpenCV's camera axes; None if the file does not exist.

    The table has no header: ``time, x, y, z, qw, qx, qy, qz``. ``start_s`` [s] is subtracted from its times.

    Raises:
        InvalidRecording: the table is broken.
        InvalidTrajectory: a pose is broken, or no pose belongs to a frame.
    """
    if not path.is_file():
        return None
    rows = read_logged_table(path).numbered(0, 1, 2, 3, 5, 6, 7, 4)
    T_map_camera = z_up(opencv_camera(poses_from_rows(rows[:, 1:], path.name)))
    return replace(match_poses(PoseTable(rows[:, 0] - start_s, T_map_camera), frames), kind=PoseKind.ODOMETRY)


def z_up(T_arkit_camera: FloatArray) -> FloatArray:
    """Convert poses (N, 4, 4) from ARKit's world to one with z up."""
    return np.asarray(_T_MAP_ARKIT @ T_arkit_camera)


def opencv_camera(T_world_camera: FloatArray) -> FloatArray:
    """Convert poses (N, 4, 4) from a camera that looks along −z with y up to one that looks along z with y down."""
    return np.asarray(T_world_camera @ _R_ARKIT_OPENCV)
