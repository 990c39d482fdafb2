"""LO-RANSAC for absolute poses by OpenCV's three-point solver, for ARM64 Linux, where poselib has no wheel.

Errors are taken on the plane that touches the unit sphere at the observed ray, so that every lens and every rig is the
same problem (Chum, Matas and Kittler 2003, Locally optimized RANSAC; Chum and Matas 2005, PROSAC).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from rholoc.geometry.arrays import FloatArray, IntArray
from rholoc.geometry.pose import pose_matrix
from rholoc.geometry.vectors import basis_across

_SEED = 20251
_UNIT, _NONE = np.eye(3), np.zeros(0)  # a camera without distortion
_BATCH = 32  # samples that are scored together
_MIN_COSINE = 0.2  # of a sample's rays against their mean: OpenCV's solver wants an image plane
_REFINEMENTS, _SETTLED = 10, 1e-7


def three_point_poses(rays: FloatArray, points: FloatArray) -> FloatArray:
    """Poses T_map_camera (S, 4, 4) from N samples of three unit rays (N, 3, 3) and their points (N, 3, 3)."""
    middles = rays.sum(axis=1)
    middles /= np.maximum(np.linalg.norm(middles, axis=1, keepdims=True), 1e-12)
    frontal = np.flatnonzero(np.einsum("nki,ni->nk", rays, middles).min(axis=1) > _MIN_COSINE)
    across = basis_across(middles[frontal])
    R_camera_plane = np.stack([across[..., 0], np.cross(middles[frontal], across[..., 0]), middles[frontal]], axis=2)
    there = rays[frontal] @ R_camera_plane
    planes = there[..., :2] / there[..., 2:]
    samples: list[int] = []
    turns: list[Any] = []
    shifts: list[Any] = []
    for row, (plane, seen) in enumerate(zip(planes, points[frontal], strict=True)):
        count, some_turns, some_shifts = cv2.solveP3P(seen, plane, _UNIT, _NONE, flags=cv2.SOLVEPNP_P3P)
        samples += [row] * count
        turns += some_turns
        shifts += some_shifts
    if not samples:
        return np.zeros((0, 4, 4))
    R_to_camera = R_camera_plane[samples]
    R_camera_map = R_to_camera @ Rotation.from_rotvec(np.array(turns)[..., 0]).as_matrix()
    R = R_camera_map.transpose(0, 2, 1)
    poses = pose_matrix(R, -(R @ R_to_camera @ np.array(shifts))[..., 0])
    return np.asarray(poses[np.isfinite(poses).all(axis=(1, 2))])


@dataclass(frozen=True, eq=False)
class _Problem:
    """Matches of all cameras of a rig.

    Attributes:
        across: (M, 2, 3) bases across the rays, rig frame; rays: (M, 3).
        centres: (M, 3) of the cameras, rig frame.
        points: (M, 3) map frame.
        tolerance: maximum error of an inlier on the plane at distance 1.
    """

    across: FloatArray
    rays: FloatArray
    centres: FloatArray
    points: FloatArray
    tolerance: float

    def errors(self, T_map_rig: FloatArray) -> FloatArray:
        """Squared errors (S, M) on the plane at distance 1, for poses (S, 4, 4); infinite behind a camera."""
        R_rig_map = T_map_rig[:, :3, :3].transpose(0, 2, 1)
        seen = R_rig_map @ self.points.T - R_rig_map @ T_map_rig[:, :3, 3:] - self.centres.T
        depth = (seen * self.rays.T).sum(axis=1)
        squared = (seen * seen).sum(axis=1) - depth**2
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(depth > 0, np.maximum(squared, 0) / depth**2, np.inf)

    def scores(self, T_map_rig: FloatArray) -> FloatArray:
        """Truncated squared errors (MSAC) of poses (S, 4, 4): (S,), the lower the better."""
        return np.asarray(np.minimum(self.errors(T_map_rig) / self.tolerance**2, 1.0).sum(axis=1))

    def refined(self, T_map_rig: FloatArray) -> FloatArray:
        """Pose (4, 4) after Gauss–Newton over the inliers, weighted down towards the tolerance. Unchanged with fewer
        than four inliers.
        """
        T = T_map_rig
        for _ in range(_REFINEMENTS):
            R_rig_map = T[:3, :3].T
            from_rig = (self.points - T[:3, 3]) @ R_rig_map.T
            seen = from_rig - self.centres
            depth = np.einsum("mi,mi->m", seen, self.rays)
            inliers = np.flatnonzero(depth > 1e-9)
            plane = np.einsum("mki,mi->mk", self.across[inliers], seen[inliers]) / depth[inliers, None]
            share = (plane**2).sum(axis=1) / self.tolerance**2
            inliers, plane, weights = inliers[share < 1], plane[share < 1], (1 - share[share < 1]) ** 2
            if len(inliers) < 4:
                return T_map_rig
            # of the projection: across/depth − plane ⊗ ray/depth
            slope = self.across[inliers] - plane[:, :, None] * self.rays[inliers, None]
            slope /= depth[inliers, None, None]
            x, y, z = from_rig[inliers].T
            none = np.zeros_like(x)
            crosses = np.stack([none, -z, y, z, none, -x, -y, x, none], axis=1).reshape(-1, 3, 3)
            J = np.concatenate([slope, -slope @ crosses], axis=2)  # of a small motion of the points in the rig
            weighted = J * weights[:, None, None]
            H = np.einsum("mki,mkj->ij", weighted, J) + 1e-12 * np.eye(6)
            step = -np.linalg.solve(H, np.einsum("mki,mk->i", weighted, plane))
            R_step = Rotation.from_rotvec(step[3:]).as_matrix()
            R_new, t_new = R_step @ R_rig_map, step[:3] - R_step @ R_rig_map @ T[:3, 3]
            T = pose_matrix(R_new.T, -R_new.T @ t_new)
            if np.abs(step).max() < _SETTLED:
                break
        return T


def sampled_pose(
    rays: Sequence[FloatArray],
    points: Sequence[FloatArray],
    T_rig_camera: FloatArray,
    focal_px: float,
    settings: dict[str, Any],
) -> tuple[FloatArray, int]:
    """T_map_rig (4, 4), NaN if none is found, and its number of inliers. ``settings`` are poselib's options of RANSAC;
    other arguments as those of :func:`rholoc.geometry.resection.resected`.
    """
    R = T_rig_camera[:, :3, :3]
    turned = [some @ R_one.T for some, R_one in zip(rays, R, strict=True)]
    of_camera = np.repeat(np.arange(len(rays)), [len(some) for some in rays])
    all_rays = np.concatenate(turned)
    problem = _Problem(
        basis_across(all_rays).transpose(0, 2, 1), all_rays, T_rig_camera[of_camera, :3, 3],
        np.concatenate([np.asarray(some, dtype=np.float64) for some in points]),
        settings["max_reproj_error"] / focal_px,
    )  # fmt: skip
    best, score, inliers, count = np.full((4, 4), np.nan), math.inf, 0, 0
    rng = np.random.default_rng(settings.get("seed", _SEED))
    most, least = settings["max_iterations"], settings.get("min_iterations", 0)
    needed = most
    while count < needed:
        size = min(_BATCH, needed - count)
        triples = _triples(rng, of_camera, count, most, size, bool(settings.get("progressive_sampling")))
        count += size
        poses = _rig_poses(problem, triples)
        if not len(poses):
            continue
        scores = problem.scores(poses)
        if scores.min() >= score:
            continue
        candidate = poses[np.argmin(scores)]
        refined = problem.refined(candidate)
        both = np.array([candidate, refined])
        scores = problem.scores(both)
        if scores.min() < score:
            best, score = both[np.argmin(scores)], float(scores.min())
            inliers = int((problem.errors(best[None])[0] < problem.tolerance**2).sum())
            needed = min(most, max(least, _enough(inliers / len(all_rays), settings.get("success_prob", 0.9999))))
    return best, inliers


def _rig_poses(problem: _Problem, triples: IntArray) -> FloatArray:
    """Poses T_map_rig (S, 4, 4) from samples (N, 3) of matches, the three of a sample seen by one camera.

    Rays are in the rig frame, so cameras differ by their centres only.
    """
    found = []
    for centre in np.unique(problem.centres[triples[:, 0]], axis=0):
        rows = triples[(problem.centres[triples[:, 0]] == centre).all(axis=1)]
        T_map_rig = three_point_poses(problem.rays[rows], problem.points[rows])
        T_map_rig[:, :3, 3] -= T_map_rig[:, :3, :3] @ centre
        found.append(T_map_rig)
    return np.concatenate([np.zeros((0, 4, 4)), *found])


def _triples(
    rng: np.random.Generator, of_camera: IntArray, count: int, most: int, size: int, is_progressive: bool
) -> IntArray:
    """At most ``size`` random samples (N, 3) of three different matches of one camera.

    ``of_camera`` (M,) is the camera of each match, likeliest match first. If progressive, samples are drawn from the
    likeliest matches at first, and from all once ``count``, the number drawn before, reaches a quarter of ``most``.
    """
    total = len(of_camera)
    share = min(1.0, (count + size) / (most / 4)) if is_progressive else 1.0
    pool = max(min(total, 12), math.ceil(total * share))
    draws = rng.integers(0, pool, (size, 3))
    different = (draws[:, 0] != draws[:, 1]) & (draws[:, 1] != draws[:, 2]) & (draws[:, 0] != draws[:, 2])
    cameras = of_camera[draws]
    return np.asarray(draws[different & (cameras == cameras[:, :1]).all(axis=1)])


def _enough(share: float, success: float) -> int:
    """Number of samples of three matches after which one of inliers only was drawn with probability ``success``.

    ``share`` is the share of inliers among the matches.
    """
    hit = share**3
    return 1 if hit >= 1 else math.ceil(math.log(1 - success) / math.log1p(-max(hit, 1e-12)))
