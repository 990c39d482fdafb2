"""Robust rotation averaging: rotations of all keyframes from relative rotations and the gyroscope."""

from collections.abc import Sequence

import gtsam
import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree
from scipy.spatial.transform import Rotation

from rholoc.geometry import FloatArray, IntArray
from rholoc.trajectory.visual.two_view import PairRotation

_PAIR_SIGMA_RAD = np.radians(0.4)  # of a relative rotation between two views with enough matches
_CAUCHY = 2.0  # sigmas
_NEIGHBOURS = 12  # maximum distance in keyframes
_GYRO_SIGMA_RAD = np.radians(0.02)  # of the gyroscope's rotation: a constant …
_GYRO_WALK_RAD = np.radians(0.05)  # … a part times the square root of the seconds …
_GYRO_BIAS_RAD_S = 1e-3  # … and a part times the seconds, from the remaining bias


def average_rotations(
    count: int, pairs: Sequence[PairRotation], times: FloatArray, by_gyroscope: Rotation | None
) -> tuple[FloatArray, IntArray]:
    """R_world_camera (K, 3, 3) of ``count`` keyframes, and the component (K,) of each, named by its first keyframe.

    With a gyroscope there is one component, in the gyroscope's frame. Without one, each connected component of the
    pairs has its own frame, that of its first keyframe.

    Args:
        pairs: relative rotations of keyframes; outliers are down-weighted (Cauchy's loss).
        times: (K,) seconds.
        by_gyroscope: R_start_camera of the K keyframes by the gyroscope, or None.
    """
    start, component = (
        _spread(count, pairs) if by_gyroscope is None else (by_gyroscope.as_matrix(), np.zeros(count, dtype=np.int64))
    )
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k in range(count):
        values.insert(k, gtsam.Rot3(start[k]))
    for first in np.unique(component, return_index=True)[1].tolist():
        graph.add(gtsam.PriorFactorRot3(first, gtsam.Rot3(start[first]), gtsam.noiseModel.Isotropic.Sigma(3, 1e-6)))
    cauchy = gtsam.noiseModel.mEstimator.Cauchy.Create(_CAUCHY)
    seen = gtsam.noiseModel.Robust.Create(cauchy, gtsam.noiseModel.Isotropic.Sigma(3, _PAIR_SIGMA_RAD))
    for pair in pairs:
        graph.add(gtsam.BetweenFactorRot3(pair.first, pair.second, gtsam.Rot3(pair.R_second_first.T), seen))
    if by_gyroscope is not None:
        rotations = (by_gyroscope[:-1].inv() * by_gyroscope[1:]).as_matrix()
        for k, (R, seconds) in enumerate(zip(rotations, np.diff(times), strict=True)):
            noise = gtsam.noiseModel.Isotropic.Sigma(3, _gyro_sigma_rad(float(seconds)))
            graph.add(gtsam.BetweenFactorRot3(k, k + 1, gtsam.Rot3(R), noise))
    found = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    return np.array([found.atRot3(k).matrix() for k in range(count)]), component


def _gyro_sigma_rad(seconds: float) -> float:
    """Standard deviation [rad] of the gyroscope's rotation over ``seconds``."""
    return float(np.sqrt(_GYRO_SIGMA_RAD**2 + _GYRO_WALK_RAD**2 * seconds + (_GYRO_BIAS_RAD_S * seconds) ** 2))


def _spread(count: int, pairs: Sequence[PairRotation]) -> tuple[FloatArray, IntArray]:
    """Rotations (K, 3, 3) along the maximum spanning tree by support, and the component (K,) of every keyframe. A
    component is named by its first keyframe, whose rotation is the identity. Pairs of neighbours (at most twelve
    keyframes apart) precede loop closures, because different places may look alike.
    """
    R = np.tile(np.eye(3), (count, 1, 1))
    component = np.full(count, -1, dtype=np.int64)
    if not pairs:
        return R, np.arange(count)
    first, second = (np.array([getattr(pair, end) for pair in pairs]) for end in ("first", "second"))
    cost = 1 / np.array([pair.support for pair in pairs], dtype=np.float64)
    cost += np.abs(second - first) > _NEIGHBOURS
    between = {(pair.first, pair.second): pair.R_second_first for pair in pairs}
    between |= {(b, a): R_ba.T for (a, b), R_ba in between.items()}
    tree = minimum_spanning_tree(coo_matrix((cost, (first, second)), shape=(count, count)).tocsr())
    for root in range(count):
        if component[root] >= 0:
            continue
        order, before = breadth_first_order(tree, root, directed=False)
        component[order] = root
        for node in order[1:].tolist():
            parent = int(before[node])
            R[node] = R[parent] @ between[parent, node].T
    return R, component
