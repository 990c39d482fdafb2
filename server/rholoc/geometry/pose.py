"""Poses of a camera in the map frame (right-handed, z up, metres)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from rholoc.geometry.arrays import FloatArray

R_FORWARD_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Rotation of a camera (x right, y down, z forward) in a body with x forward, y left and z up (REP 103)."""

_VERTICAL = 1e-9  # a heading this close to the vertical has no horizontal direction of its own


def pose_matrix(R_map_camera: FloatArray, position: FloatArray) -> FloatArray:
    """R (..., 3, 3) and position (..., 3) in metres → T_map_camera (..., 4, 4)."""
    T = np.zeros((*R_map_camera.shape[:-2], 4, 4))
    T[..., :3, :3] = R_map_camera
    T[..., :3, 3] = position
    T[..., 3, 3] = 1
    return T


def poses_from_rows(rows: FloatArray) -> FloatArray:
    """Rows (N, 7) of x, y, z in metres and the quaternion x, y, z, w → T_map_camera (N, 4, 4).

    Quaternions may have any length but 0 (ValueError).
    """
    rows = np.asarray(rows, dtype=np.float64).reshape(-1, 7)
    if len(rows) == 0:
        return np.zeros((0, 4, 4))
    return pose_matrix(Rotation.from_quat(rows[:, 3:]).as_matrix(), rows[:, :3])


def rows_from_poses(T_map_camera: FloatArray) -> FloatArray:
    """T_map_camera (N, 4, 4) → rows (N, 7) of x, y, z in metres and the quaternion x, y, z, w with w ≥ 0."""
    if len(T_map_camera) == 0:
        return np.zeros((0, 7))
    quaternions = Rotation.from_matrix(T_map_camera[:, :3, :3]).as_quat(canonical=True)
    return np.column_stack([T_map_camera[:, :3, 3], quaternions])


def interpolated_poses(times: FloatArray, T: FloatArray, at: FloatArray) -> FloatArray:
    """Poses (M, 4, 4) at the times ``at`` (M,), between poses ``T`` (N, 4, 4) at increasing ``times`` (N,), N ≥ 2.

    Raises ValueError for a time outside.
    """
    R = Slerp(times, Rotation.from_matrix(T[:, :3, :3]))(at).as_matrix()
    return pose_matrix(R, np.column_stack([np.interp(at, times, axis) for axis in T[:, :3, 3].T]))


def is_rotation(R: FloatArray, tolerance: float = 1e-3) -> bool:
    """Whether an array is a rotation matrix (3, 3): R Rᵀ = I within ``tolerance``, and a positive determinant."""
    if R.shape != (3, 3) or not np.all(np.abs(R) <= 1 + tolerance):
        return False
    return np.allclose(R @ R.T, np.eye(3), rtol=0, atol=tolerance) and float(np.linalg.det(R)) > 0


def rotation_from_heading(heading: FloatArray, roll: float = 0.0) -> FloatArray:
    """R_map_camera (3, 3) of the camera that looks along ``heading`` (3,), rolled by ``roll`` radians about it.

    With roll 0 the camera's x axis is horizontal and its y axis points downwards: the paper's upright model.
    A vertical heading takes the map's x axis for the camera's.
    """
    x, y, z = (heading / np.linalg.norm(heading)).tolist()
    level = math.hypot(x, y)
    right = (1.0, 0.0, 0.0) if level < _VERTICAL else (y / level, -x / level, 0.0)
    down = (-z * right[1], z * right[0], x * right[1] - y * right[0])
    c, s = math.cos(roll), math.sin(roll)
    upright = np.array([right, down, (x, y, z)]).T
    return np.asarray(upright @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]))


class PosedCameras:
    """Base of classes with N camera poses ``T_map_camera`` (N, 4, 4)."""

    T_map_camera: FloatArray

    @property
    def positions(self) -> FloatArray:
        """Camera centres (N, 3) in the map frame."""
        return self.T_map_camera[:, :3, 3]

    @property
    def headings(self) -> FloatArray:
        """Optical axes (N, 3) in the map frame, unit length."""
        return self.T_map_camera[:, :3, 2]


@dataclass(frozen=True, eq=False)
class Pose:
    """Position and orientation of a camera.

    ``T_map_camera`` (4, 4) takes points of the camera frame (x right, y down, z forward) to the map frame.
    """

    T_map_camera: FloatArray

    @classmethod
    def from_quaternion(cls, position: FloatArray, quaternion_xyzw: FloatArray) -> Pose:
        """From a position (3,) in metres and a quaternion (4,): x, y, z, w, of any length but 0 (ValueError)."""
        R = Rotation.from_quat(np.asarray(quaternion_xyzw, dtype=np.float64)).as_matrix()
        return cls(pose_matrix(R, np.asarray(position, dtype=np.float64)))

    @classmethod
    def from_heading(cls, position: FloatArray, heading: FloatArray, roll: float = 0.0) -> Pose:
        """From a position (3,) in metres, a heading (3,) of any length but 0, and a roll in radians."""
        return cls(pose_matrix(rotation_from_heading(np.asarray(heading), roll), np.asarray(position)))

    @property
    def R_map_camera(self) -> FloatArray:
        """The rotation, (3, 3)."""
        return self.T_map_camera[:3, :3]

    @property
    def position(self) -> FloatArray:
        """The camera's centre in the map frame, (3,), metres."""
        return self.T_map_camera[:3, 3]

    @property
    def heading(self) -> FloatArray:
        """The optical axis in the map frame, (3,), unit length."""
        return self.T_map_camera[:3, 2]

    @property
    def roll(self) -> float:
        """Rotation about the heading from the upright camera [rad, in (-π, π]], positive if x turns towards the upright
        y (down).

        For a vertical heading the upright camera's x axis is the map's.
        """
        upright = rotation_from_heading(self.heading)
        right = self.R_map_camera[:, 0]
        return math.atan2(float(upright[:, 1] @ right), float(upright[:, 0] @ right))

    @property
    def quaternion_xyzw(self) -> FloatArray:
        """R_map_camera as a quaternion (4,): x, y, z, w with w ≥ 0."""
        quaternion = Rotation.from_matrix(self.R_map_camera).as_quat()
        return np.asarray(-quaternion if quaternion[3] < 0 else quaternion)

    def inverse(self) -> FloatArray:
        """T_camera_map (4, 4)."""
        R = self.R_map_camera.T
        return pose_matrix(R, -R @ self.position)
