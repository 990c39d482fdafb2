"""Stray Scanner (iOS, LiDAR): a video with ARKit's poses, usable as given.

::

    rgb.mp4             as ARKit has images: on their side
    odometry.csv        timestamp, frame, x, y, z, qx, qy, qz, qw[, fx, fy, cx, cy]    row i is frame i
    camera_matrix.csv   3 × 3, no header
    depth/000000.png    mm, of what the video's frame of that number shows; .npy, of early versions, is ignored
    imu.csv             timestamp, a_x, a_y, a_z, alpha_x, alpha_y, alpha_z            CoreMotion's axes

Poses are in metres with y up, of a camera with OpenCV's axes. The app's own description has the acceleration in m/s²,
its code writes it in g with Apple's sign, so unit and sign are measured.
"""

from pathlib import Path

import numpy as np

from rholoc.errors import InvalidCamera
from rholoc.geometry import Camera, FloatArray, IntArray
from rholoc.recordings.imu_normalisation import ImuConvention, Samples, normalise_imu, with_sign_by_poses
from rholoc.recordings.readers._apple import R_LANDSCAPE_CAMERA_IMU, z_up
from rholoc.recordings.readers._frames import depth_images, require_video, timed_video
from rholoc.recordings.recording import GivenPoses, Imu, PoseKind, Recording
from rholoc.recordings.tables.logged_table import LoggedTable, has_columns, read_logged_table
from rholoc.recordings.tables.pose_table import poses_from_rows
from rholoc.reports import RecordingWarning

TABLES = ("odometry.csv", "camera_matrix.csv", "imu.csv", "depth/*.png")
_POSES = ("x", "y", "z", "qx", "qy", "qz", "qw")
_IMU = ("timestamp", "a_x", "a_y", "a_z", "alpha_x", "alpha_y", "alpha_z")
_INTRINSICS = ("fx", "fy", "cx", "cy")


def recognises(folder: Path) -> bool:
    """Whether ``odometry.csv`` has columns of time, frame, position and quaternion."""
    return has_columns(folder / "odometry.csv", ("timestamp", "frame", *_POSES))


def read(folder: Path) -> Recording:
    """Read a recording of this format from its folder: poses by ARKit, which drift, and depth and IMU, if any.

    Raises:
        InvalidRecording: a table or the video is broken, or they contradict each other.
        InvalidTrajectory: the poses are broken.
        InvalidCamera: the camera matrix is broken.
    """
    odometry = read_logged_table(folder / "odometry.csv")
    timed = timed_video(require_video(folder, "rgb"), odometry.named("timestamp")[:, 0], "odometry.csv")
    T_map_camera = z_up(poses_from_rows(odometry.named(*_POSES)[timed.rows], "odometry.csv"))
    poses = GivenPoses(np.ones(len(T_map_camera), dtype=np.bool_), T_map_camera, kind=PoseKind.ODOMETRY)
    imu, imu_warnings = _imu(folder / "imu.csv", timed.frames.times, poses)
    per_frame = _logged_intrinsics(odometry, timed.rows)
    return Recording(
        timed.frames,
        camera=_camera(folder / "camera_matrix.csv", timed.frames.size),
        imu=imu,
        poses=poses,
        frame_intrinsics=per_frame,
        depth=depth_images([folder / "depth" / f"{row:06d}.png" for row in timed.rows.tolist()]),
        warnings=(*timed.warnings, *imu_warnings),
    )


def _imu(path: Path, times: FloatArray, poses: GivenPoses) -> tuple[Imu | None, tuple[RecordingWarning, ...]]:
    """The IMU, its sign by the ``poses`` at ``times`` (N,) [s], and warnings; None without the file."""
    if not path.is_file():
        return None, ()
    rows = read_logged_table(path).named(*_IMU)
    says = ImuConvention(in_g=True, apple_sign=True)
    accelerometer, gyroscope = Samples(rows[:, 0], rows[:, 1:4]), Samples(rows[:, 0], rows[:, 4:7])
    imu, warnings = normalise_imu(accelerometer, gyroscope, says, R_LANDSCAPE_CAMERA_IMU)
    imu, sign_warnings = with_sign_by_poses(imu, times, poses)
    return imu, (*warnings, *sign_warnings)


def _camera(path: Path, size: tuple[int, int]) -> Camera | None:
    """Camera by a file of K (3, 3) for pictures of ``size`` (width, height); None without the file."""
    if not path.is_file():
        return None
    K = read_logged_table(path).numbered(0, 1, 2)
    if K.shape != (3, 3):
        raise InvalidCamera(f"{path.name} is not a 3×3 matrix.")
    return Camera(*size, K[0, 0], K[1, 1], K[0, 2], K[1, 2])


def _logged_intrinsics(odometry: LoggedTable, rows: IntArray) -> FloatArray | None:
    """fx, fy, cx, cy (N, 4) [px] in these rows (N,); None if they are not logged."""
    return odometry.named(*_INTRINSICS)[rows] if set(_INTRINSICS) <= set(odometry.header) else None
