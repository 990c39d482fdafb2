"""Similarity transforms between frames, estimated from corresponding points, vectors and poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rholoc.geometry.arrays import FloatArray
from rholoc.geometry.pose import pose_matrix


@dataclass(frozen=True, eq=False)
class Similarity:
    """x ↦ scale · rotation @ x + translation."""

    scale: float
    rotation: FloatArray
    translation: FloatArray

    def points(self, points: FloatArray) -> FloatArray:
        """Points (N, 3) in the source frame → points (N, 3) in the target frame."""
        return np.asarray(self.scale * points @ self.rotation.T + self.translation)

    def poses(self, T_source_camera: FloatArray) -> FloatArray:
        """Poses (N, 4, 4) in the source frame → poses (N, 4, 4) in the target frame."""
        return pose_matrix(self.rotation @ T_source_camera[:, :3, :3], self.points(T_source_camera[:, :3, 3]))

    def covariances(self, covariances: FloatArray) -> FloatArray:
        """Covariances (N, 6, 6) of poses in the source frame → those of the poses in the target frame.

        Each is of the position, then of a small rotation from the left, along the axes of its frame.
        """
        J = np.zeros((6, 6))
        J[:3, :3], J[3:, 3:] = self.scale * self.rotation, self.rotation
        return np.asarray(J @ covariances @ J.T)

    @classmethod
    def identity(cls) -> Similarity:
        """The transform that changes nothing."""
        return cls(1.0, np.eye(3), np.zeros(3))


def aligning_rotation(source: FloatArray, target: FloatArray) -> FloatArray:
    """The rotation (3, 3) that takes vectors ``source`` (N, 3) to ``target`` (N, 3), by least squares (Kabsch)."""
    return _nearest_rotation(target.T @ source)[0]


def _nearest_rotation(correlation: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rotation (3, 3) nearest to Σ target sourceᵀ (3, 3), and singular values (3,), the last one signed."""
    U, singular, Vt = np.linalg.svd(correlation)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(U) * np.linalg.det(Vt))])
    return U @ np.diag(sign) @ Vt, singular * sign


def umeyama(source: FloatArray, target: FloatArray, weights: FloatArray | None = None) -> Similarity:
    """The least-squares similarity that takes ``source`` (N, 3) to ``target`` (N, 3) (Umeyama, 1991).

    The points must not be collinear; ``weights`` (N,) are relative.
    """
    w = _normalized(weights, len(source))
    source_mean, target_mean = w @ source, w @ target
    a, b = source - source_mean, target - target_mean
    R, singular = _nearest_rotation((b * w[:, None]).T @ a)
    scale = float(singular.sum() / (w @ (a * a).sum(axis=1)))
    return Similarity(scale, R, target_mean - scale * R @ source_mean)


def upright_umeyama(source: FloatArray, target: FloatArray) -> Similarity:
    """Least-squares similarity from ``source`` (N, 3) to ``target`` (N, 3), whose rotation is about z only.

    The points must not lie on one vertical line.
    """
    source_mean, target_mean = source.mean(axis=0), target.mean(axis=0)
    a, b = source - source_mean, target - target_mean
    angle = np.arctan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a[:, :2] * b[:, :2]).sum())
    R = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
    scale = float((a @ R.T * b).sum() / (a * a).sum())
    return Similarity(scale, R, target_mean - scale * R @ source_mean)


def kabsch(source: FloatArray, target: FloatArray) -> Similarity:
    """The least-squares rotation and translation, without scale, that take ``source`` (N, 3) to ``target`` (N, 3).

    The points must be at least three, and not collinear.
    """
    source_mean, target_mean = source.mean(axis=0), target.mean(axis=0)
    R = aligning_rotation(source - source_mean, target - target_mean)
    return Similarity(1.0, R, target_mean - R @ source_mean)


def posed_alignment(
    source: FloatArray, target: FloatArray, weights: FloatArray, fixed_scale: bool, min_spread_m: float = 0.0
) -> Similarity:
    """Similarity from poses ``source`` (N, 4, 4) to poses ``target`` (N, 4, 4) of the same cameras.

    Its rotation is the weighted mean of the relative rotations alone, so a walk along a line, or on the spot, can be
    aligned as well. The scale stays 1 if it is fixed, if the rotated positions do not correlate positively with the
    target's, or if the target's spread is at most ``min_spread_m``. ``weights`` (N,) are relative.
    """
    w = _normalized(weights, len(source))
    R, _ = _nearest_rotation(np.einsum("l,lij,lkj->ik", w, target[:, :3, :3], source[:, :3, :3]))
    source_mean, target_mean = w @ source[:, :3, 3], w @ target[:, :3, 3]
    a, b = (source[:, :3, 3] - source_mean) @ R.T, target[:, :3, 3] - target_mean
    spread, aligned = float(w @ (a * a).sum(axis=1)), float(w @ (a * b).sum(axis=1))
    has_scale = not fixed_scale and aligned > 0 and float(w @ (b * b).sum(axis=1)) > min_spread_m**2
    scale = aligned / spread if has_scale else 1.0
    return Similarity(scale, R, target_mean - scale * R @ source_mean)


def _normalized(weights: FloatArray | None, count: int) -> FloatArray:
    """Weights (count,) of sum 1; equal ones for None."""
    w = np.ones(count) if weights is None else np.asarray(weights, dtype=np.float64)
    return np.asarray(w / w.sum())


def align_poses(source: FloatArray, target: FloatArray, rounds: int = 5) -> Similarity:
    """Robust similarity from poses ``source`` (N, 4, 4) to poses ``target`` (N, 4, 4) of the same cameras.

    Uses camera centres only, not on one line, reweighted ``rounds`` times so that a minority of wrong ones is ignored
    (Cauchy weights at the median distance).
    """
    a, b = source[:, :3, 3], target[:, :3, 3]
    weights = np.ones(len(a))
    for _ in range(rounds):
        similarity = umeyama(a, b, weights)
        error = np.linalg.norm(similarity.points(a) - b, axis=1)
        weights = 1 / (1 + (error / max(float(np.median(error)), 1e-9)) ** 2)
    return similarity
