"""First poses in metres of pictures with depth: each pair that overlaps has a metric relative pose."""

from collections.abc import Sequence

import gtsam
import numpy as np
from gtsam.symbol_shorthand import C
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree

from rholoc.geometry import Camera, FloatArray, IntArray, rotation_angles
from rholoc.geometry.graphs import components
from rholoc.recordings.frames.depth import DepthImages
from rholoc.trajectory.optimization.descent import optimized
from rholoc.trajectory.optimization.factors import robust
from rholoc.trajectory.optimization.problem import Step
from rholoc.trajectory.visual.matching import VerifiedPair
from rholoc.trajectory.visual.two_view import absolute_pose

_MIN_INLIERS = 12
_TOLERANCE_PX = 6.0  # depth pictures are coarse
_MAX_APART_RAD, _MAX_APART, _MAX_APART_M = np.radians(3.0), 0.1, 0.1  # of a pose by either picture's depth
_SIGMA_RAD, _SIGMA, _SIGMA_M = np.radians(0.5), 0.03, 0.03  # of a relative pose; relative and absolute
_CAUCHY = 2.0  # sigmas
_ITERATIONS = 30


def depth_start(
    camera: Camera, depth: DepthImages, rays: Sequence[FloatArray], pairs: Sequence[VerifiedPair]
) -> tuple[FloatArray, IntArray] | None:
    """Poses T_world_camera (N, 4, 4) [m] of the largest connected component of pictures, and their numbers (N,).

    Relative poses are by P3P of the matches with depth; those on which the depths of both pictures disagree are left
    out. Poses are chained along the strongest pairs, then fitted to all by a pose graph.

    Args:
        camera: of K pictures.
        depth: their depth pictures.
        rays: features of each in the camera frame, (F, 3).
        pairs: verified matches.

    Returns:
        None if fewer than three pictures are linked.
    """
    points = [_points(depth, k, camera, some) for k, some in enumerate(rays)]
    found = [_metric(pair, rays, points, camera) for pair in pairs]
    steps = [one for one in found if one is not None]
    count = len(rays)
    ends = np.array([(one.first, one.second) for one, _ in steps], dtype=np.int64).reshape(-1, 2)
    weights = 1 / np.array([inliers for _, inliers in steps], dtype=np.float64)
    graph = coo_matrix((weights, ends.T), shape=(count, count)).tocsr()
    part = components(count, ends)
    members = np.flatnonzero(part == np.bincount(part).argmax())
    if len(members) < 3:
        return None
    T = _chained(int(members[0]), {(one.first, one.second): one.T_first_second for one, _ in steps}, graph)
    steps_within = [one for one, _ in steps if one.first in T and one.second in T]
    return _fitted(T, steps_within, members), members


def _points(depth: DepthImages, k: int, camera: Camera, rays: FloatArray) -> FloatArray:
    """Points (F, 3) [m] of a picture's features in its camera's frame; NaN where the depth is unknown."""
    image = depth.of_frame(k, camera)
    if image is None:
        return np.full(rays.shape, np.nan)
    return np.asarray(rays / rays[:, 2:] * image.at(rays)[:, None])


def _metric(
    pair: VerifiedPair, rays: Sequence[FloatArray], points: Sequence[FloatArray], camera: Camera
) -> tuple[Step, int] | None:
    """The relative pose of a pair and its number of inliers; None if depths do not give one with twelve inliers, or two
    that disagree.
    """
    tolerance = _TOLERANCE_PX / camera.focal
    ends, found = (pair.first, pair.second), []
    for near, far in ((0, 1), (1, 0)):
        there, seen = points[ends[near]][pair.matches[:, near]], rays[ends[far]][pair.matches[:, far]]
        known = np.isfinite(there[:, 0])
        if known.sum() < _MIN_INLIERS:
            continue
        T, inliers = absolute_pose(seen[known], there[known], tolerance)
        if inliers >= _MIN_INLIERS:
            found.append((inliers, T if near == 0 else np.linalg.inv(T)))
    if not found:
        return None
    inliers, T = max(found, key=lambda one: one[0])
    apart = [np.linalg.inv(T) @ other for _, other in found]
    allowed_m = _MAX_APART_M + _MAX_APART * np.linalg.norm(T[:3, 3])
    if any(
        rotation_angles(one[:3, :3], np.eye(3)) > _MAX_APART_RAD or np.linalg.norm(one[:3, 3]) > allowed_m
        for one in apart
    ):
        return None
    sigma_m = _SIGMA_M + _SIGMA * float(np.linalg.norm(T[:3, 3]))
    return Step(pair.first, pair.second, T, sigma_m, _SIGMA_RAD), inliers


def _chained(root: int, between: dict[tuple[int, int], FloatArray], graph: csr_matrix) -> dict[int, FloatArray]:
    """T_root_camera (4, 4) of each picture linked with a root, along the strongest pairs. ``between`` holds
    T_first_second of each pair; ``graph`` its cost.
    """
    order, before = breadth_first_order(minimum_spanning_tree(graph), root, directed=False)
    T: dict[int, FloatArray] = {root: np.eye(4)}
    for k in order[1:].tolist():
        last = int(before[k])
        step = between[last, k] if (last, k) in between else np.linalg.inv(between[k, last])
        T[k] = T[last] @ step
    return T


def _fitted(T: dict[int, FloatArray], steps: Sequence[Step], members: IntArray) -> FloatArray:
    """Poses (N, 4, 4) of the ``members`` (N,), starting at T, fitted to all relative poses (Levenberg–Marquardt,
    Cauchy's loss).
    """
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k in members.tolist():
        values.insert(C(k), gtsam.Pose3(T[k]))
    first = int(members[0])
    graph.add(gtsam.PriorFactorPose3(C(first), gtsam.Pose3(T[first]), gtsam.noiseModel.Isotropic.Sigma(6, _SIGMA_M)))
    for step in steps:
        noise = gtsam.noiseModel.Diagonal.Sigmas(np.repeat([step.sigma_rad, step.sigma_m], 3))
        pose = gtsam.Pose3(step.T_first_second)
        graph.add(gtsam.BetweenFactorPose3(C(step.first), C(step.second), pose, robust(_CAUCHY, noise)))
    solved = optimized(graph, values, _ITERATIONS)
    return np.array([solved.atPose3(C(k)).matrix() for k in members.tolist()])
