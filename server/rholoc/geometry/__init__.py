"""Cameras, poses, rays. Depends on no other package of rholoc."""

from rholoc.geometry.alignment import (
    Similarity,
    align_poses,
    aligning_rotation,
    kabsch,
    posed_alignment,
    umeyama,
    upright_umeyama,
)
from rholoc.geometry.arrays import BoolArray, ByteArray, FloatArray, IntArray, evenly, ranges
from rholoc.geometry.camera import CAMERA_WRITTEN, Camera, on_plane
from rholoc.geometry.lenses import Lens
from rholoc.geometry.patches import mean_patches, patch_appearance, patch_vectors
from rholoc.geometry.pose import (
    R_FORWARD_OPTICAL,
    Pose,
    PosedCameras,
    interpolated_poses,
    is_rotation,
    pose_matrix,
    poses_from_rows,
    rotation_from_heading,
    rows_from_poses,
)
from rholoc.geometry.vectors import (
    UP,
    angles_between,
    basis_across,
    cross,
    direction_angles,
    pose_distances,
    rotation_angles,
)

__all__ = [
    "CAMERA_WRITTEN",
    "R_FORWARD_OPTICAL",
    "UP",
    "BoolArray",
    "ByteArray",
    "Camera",
    "FloatArray",
    "IntArray",
    "Lens",
    "Pose",
    "PosedCameras",
    "Similarity",
    "align_poses",
    "aligning_rotation",
    "angles_between",
    "basis_across",
    "cross",
    "direction_angles",
    "evenly",
    "interpolated_poses",
    "is_rotation",
    "kabsch",
    "mean_patches",
    "on_plane",
    "patch_appearance",
    "patch_vectors",
    "pose_distances",
    "pose_matrix",
    "posed_alignment",
    "poses_from_rows",
    "ranges",
    "rotation_angles",
    "rotation_from_heading",
    "rows_from_poses",
    "umeyama",
    "upright_umeyama",
]
