"""Absolute pose from matches of rays and points, many of them false: LO-RANSAC, by poselib (Larsson and others).

Where poselib is not installed, :mod:`rholoc.geometry.opencv_ransac` takes its place.

Rays of wide lenses have no place on one image plane. They are divided among the faces of a cube, which are pinhole
cameras at one centre: a rig, for which poselib has a solver.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from rholoc.geometry import opencv_ransac
from rholoc.geometry.arrays import FloatArray, IntArray
from rholoc.geometry.camera import on_plane
from rholoc.geometry.pose import pose_matrix

try:
    import poselib
except ImportError:  # ARM64 Linux has no wheel
    poselib = None

NARROW_COSINE = 0.5
"""Rays up to 60° off the optical axis have a place on the plane z = 1 that is not stretched too far."""

_FACES = np.array(  # R_face_camera of a cube, the front first
    [
        [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
        [[0, 0, -1], [0, 1, 0], [1, 0, 0]],
        [[0, 0, 1], [0, 1, 0], [-1, 0, 0]],
        [[-1, 0, 0], [0, 1, 0], [0, 0, -1]],
        [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
        [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
    ],
    dtype=np.float64,
)


def is_narrow(rays: FloatArray) -> bool:
    """Whether unit rays (N, 3) all lie within 60° of the optical axis."""
    return bool(rays[:, 2].min(initial=1.0) >= NARROW_COSINE)


def resected(
    rays: Sequence[FloatArray],
    points: Sequence[FloatArray],
    T_rig_camera: FloatArray,
    focal_px: float,
    settings: dict[str, Any],
) -> tuple[FloatArray, int]:
    """Pose of a camera, or of a rig of C cameras, with the most inliers.

    Args:
        rays: for each camera the unit rays (M, 3) of its matches, camera frame.
        points: for each camera the points (M, 3) of these matches, map frame.
        T_rig_camera: (C, 4, 4) mountings.
        focal_px: divides the settings' tolerance [px]; 1 for a tolerance on the plane z = 1.
        settings: poselib's RANSAC options.

    Returns:
        T_map_rig (4, 4), not finite or arbitrary if none is found, and the number of inliers.
    """
    if poselib is None:
        return opencv_ransac.sampled_pose(rays, points, T_rig_camera, focal_px, settings)
    seen = [
        (R_face_camera, T, on_plane(some[rows] @ R_face_camera.T) * focal_px, of[rows])
        for some, of, T in zip(rays, points, T_rig_camera, strict=True)
        for R_face_camera, rows in _faces(some)
    ]
    pinhole = {"model": "SIMPLE_PINHOLE", "width": 1, "height": 1, "params": [focal_px, 0.0, 0.0]}
    planes, targets = [one[2] for one in seen], [one[3] for one in seen]
    mounted = [_mounted(R_face_camera, T) for R_face_camera, T, _, _ in seen]
    if len(seen) == 1 and np.array_equal(mounted[0], np.eye(4)):
        pose, report = poselib.estimate_absolute_pose(planes[0], targets[0], pinhole, settings, {})
    else:
        cameras = [pinhole] * len(seen)
        poses = [_poselib_pose(T_face_rig) for T_face_rig in mounted]
        pose, report = poselib.estimate_generalized_absolute_pose(planes, targets, poses, cameras, settings, {})
    R_rig_map = np.asarray(pose.R)
    return pose_matrix(R_rig_map.T, -R_rig_map.T @ np.asarray(pose.t)), int(report["num_inliers"])


def three_point_poses(rays: FloatArray, points: FloatArray) -> FloatArray:
    """Poses T_map_camera (S, 4, 4) from N samples of three unit rays (N, 3, 3) and their points (N, 3, 3).

    Each sample gives zero to four poses; the result does not say from which sample a pose is.
    """
    if poselib is None:
        return opencv_ransac.three_point_poses(rays, points)
    poses = [pose for three, seen in zip(rays, points, strict=True) for pose in poselib.p3p(three, seen)]
    if not poses:
        return np.zeros((0, 4, 4))
    R = np.array([pose.R for pose in poses]).transpose(0, 2, 1)
    T = pose_matrix(R, -np.einsum("hij,hj->hi", R, np.array([pose.t for pose in poses])))
    return T[np.isfinite(T).all(axis=(1, 2))]


def _faces(rays: FloatArray) -> Iterator[tuple[FloatArray, IntArray]]:
    """Iterate over R_face_camera (3, 3) of the pinholes that unit rays (N, 3) are divided among, and the rows of each
    one's rays.
    """
    if is_narrow(rays):
        yield _FACES[0], np.arange(len(rays))
        return
    nearest = np.argmax(rays @ _FACES[:, 2].T, axis=1)
    for face in np.unique(nearest).tolist():
        yield _FACES[face], np.flatnonzero(nearest == face)


def _mounted(R_face_camera: FloatArray, T_rig_camera: FloatArray) -> FloatArray:
    """T_face_rig (4, 4) of a cube's face in a camera mounted at T_rig_camera."""
    R_face_rig = R_face_camera @ T_rig_camera[:3, :3].T
    return pose_matrix(R_face_rig, -R_face_rig @ T_rig_camera[:3, 3])


def _poselib_pose(T_face_rig: FloatArray) -> Any:
    """poselib's pose of a transform (4, 4)."""
    pose = poselib.CameraPose()
    pose.R, pose.t = T_face_rig[:3, :3], T_face_rig[:3, 3]
    return pose
