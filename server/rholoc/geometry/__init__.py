"""Cameras, poses, rays. Depends on nothing of ours."""

from rholoc.geometry.arrays import BoolArray, ByteArray, FloatArray, IntArray
from rholoc.geometry.camera import Camera
from rholoc.geometry.pose import Pose, is_rotation, pose_matrix, poses_from_rows, rotation_from_heading, rows_from_poses
from rholoc.geometry.vectors import basis_across, cross

__all__ = [
    "BoolArray",
    "ByteArray",
    "Camera",
    "FloatArray",
    "IntArray",
    "Pose",
    "basis_across",
    "cross",
    "is_rotation",
    "pose_matrix",
    "poses_from_rows",
    "rotation_from_heading",
    "rows_from_poses",
]
