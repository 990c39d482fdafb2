"""Similarity transforms between frames, estimated from corresponding points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from rholoc.geometry import FloatArray, pose_matrix


@dataclass(frozen=True, eq=False)
class Similarity:
    """x ↦ scale · rotation @ x + translation."""

    scale: float
    rotation: FloatArray
    translation: FloatArray

    def points(self, points: FloatArray) -> FloatArray:
        """Points (N, 3) → points (N, 3)."""
        return np.asarray(self.scale * points @ self.rotation.T + self.translation)

    def poses(self, T_source_camera: FloatArray) -> FloatArray:
        """Poses (N, 4, 4) in the source frame → poses (N, 4, 4) in the target frame."""
        return pose_matrix(self.rotation @ T_source_camera[:, :3, :3], self.points(T_source_camera[:, :3, 3]))

    @classmethod
    def identity(cls) -> Similarity:
        """The transform that changes nothing."""
        return cls(1.0, np.eye(3), np.zeros(3))


def umeyama(source: FloatArray, target: FloatArray, weights: FloatArray | None = None) -> Similarity:
    """The least-squares similarity that takes ``source`` (N, 3) to ``target`` (N, 3) (Umeyama, 1991).

    The points must not be collinear; ``weights`` (N,) are relative.
    """
    w = np.ones(len(source)) if weights is None else np.asarray(weights, dtype=np.float64)
    w = w / w.sum()
    source_mean, target_mean = w @ source, w @ target
    a, b = source - source_mean, target - target_mean
    U, singular, Vt = np.linalg.svd((b * w[:, None]).T @ a)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(U) * np.linalg.det(Vt))])
    R = U @ np.diag(sign) @ Vt
    scale = float((singular * sign).sum() / (w @ (a * a).sum(axis=1)))
    return Similarity(scale, R, target_mean - scale * R @ source_mean)


def align_poses(source: FloatArray, target: FloatArray, rounds: int = 5) -> Similarity:
    """The robust similarity between two pose lists (N, 4, 4) of the same cameras.

    Camera centres alone, reweighted so that a minority of wrong ones does not count (Cauchy weights at their median).
    """
    a, b = source[:, :3, 3], target[:, :3, 3]
    weights = np.ones(len(a))
    for _ in range(rounds):
        similarity = umeyama(a, b, weights)
        error = np.linalg.norm(similarity.points(a) - b, axis=1)
        weights = 1 / (1 + (error / max(float(np.median(error)), 1e-9)) ** 2)
    return similarity


def rotation_angles_deg(R: FloatArray) -> FloatArray:
    """The angles of rotations (N, 3, 3): (N,) degrees."""
    return np.degrees(Rotation.from_matrix(R).magnitude())
