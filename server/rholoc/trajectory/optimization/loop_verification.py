"""Verify loop closures by the walk's own accuracy, and compute their relative poses.

Different rooms may look alike. The walk by corners, neighbours and IMU alone is accurate to a few thousandths of its
length: two features matched across a loop must not be further apart than its error allows.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rholoc.geometry import BoolArray, FloatArray, IntArray
from rholoc.trajectory.optimization.points import residuals_px, triangulate
from rholoc.trajectory.optimization.pose_graph import RelativePose
from rholoc.trajectory.optimization.problem import State
from rholoc.trajectory.visual.matching import VerifiedPair
from rholoc.trajectory.visual.tracks import Observations, linked_features
from rholoc.trajectory.visual.two_view import absolute_pose

_MIN_POINTS = 5
_MIN_PARALLAX_DEG = 1.5
_FURTHEST_OFF_PX = 4.0
_MIN_AGREEING = 9
_AGREEING_PX = 3.0
_SIGMAS = 4.0
_ALLOWED_M = 0.10
_ALLOWED_OF_WAY = 0.005  # drift that the covariance does not include, as a share of the path length


@dataclass(frozen=True, eq=False)
class PlacedFeatures:
    """Positions of the features of K keyframes by a walk.

    Attributes:
        points: (M, 3) in the walk's frame [m].
        known: (M,) bool, points with enough parallax and small residuals.
        labels: for each keyframe the points (F,) of its features.
        rays: for each keyframe the rays (F, 3) of its features in the camera frame.
        state: the walk.
    """

    points: FloatArray
    known: BoolArray
    labels: Sequence[IntArray]
    rays: Sequence[FloatArray]
    state: State


def place_features(neighbours: Sequence[VerifiedPair], pixels: Sequence[FloatArray], state: State) -> PlacedFeatures:
    """Triangulate features from the matches of neighbours.

    A point is known if it has more than 1.5° of parallax and all its residuals are below 4 px.

    Args:
        neighbours: verified pairs of neighbouring keyframes.
        pixels: of every keyframe's features, (F, 2) each.
        state: of the walk, in metres.
    """
    first_feature = np.concatenate([[0], np.cumsum([len(some) for some in pixels])])
    _, label = linked_features(first_feature, neighbours)
    keyframe = np.repeat(np.arange(len(pixels)), np.diff(first_feature))
    seen = Observations(keyframe, label, np.concatenate(pixels))
    points, parallax_deg = triangulate(seen, state)
    furthest_px = np.zeros(len(points))
    np.maximum.at(furthest_px, label, residuals_px(seen, state, points))
    known = (parallax_deg > _MIN_PARALLAX_DEG) & (furthest_px < _FURTHEST_OFF_PX)
    rays = [state.camera.rays(some) for some in pixels]
    return PlacedFeatures(points, known, np.split(label, first_feature[1:-1]), rays, state)


def loops_in_reach(loops: Sequence[VerifiedPair], placed: PlacedFeatures, sigmas_m: FloatArray) -> BoolArray:
    """Mask (N,) of the loops that the walk's error allows: off by 10 cm + 0.5 % of the way + 4 sigmas at most.

    Loops with fewer than five known points on both sides are refused.

    Args:
        loops: candidate loop closures.
        placed: the features of all keyframes.
        sigmas_m: (K,) standard deviation of each keyframe's position relative to the first.
    """
    steps_m = np.linalg.norm(np.diff(placed.state.positions, axis=0), axis=1)
    way_m = np.concatenate([[0.0], np.cumsum(steps_m)])
    kept = np.zeros(len(loops), dtype=np.bool_)
    for i, pair in enumerate(loops):
        one = placed.labels[pair.first][pair.matches[:, 0]]
        other = placed.labels[pair.second][pair.matches[:, 1]]
        both = placed.known[one] & placed.known[other]
        if both.sum() < _MIN_POINTS:
            continue
        off_m = float(np.linalg.norm(np.median(placed.points[other[both]] - placed.points[one[both]], axis=0)))
        walked_m = float(way_m[pair.second] - way_m[pair.first])
        sigma_m = float(max(sigmas_m[pair.first], sigmas_m[pair.second]))
        kept[i] = off_m <= _ALLOWED_M + _ALLOWED_OF_WAY * walked_m + _SIGMAS * sigma_m
    return kept


def loop_pose(pair: VerifiedPair, placed: PlacedFeatures) -> RelativePose | None:
    """Relative pose of a loop's keyframes: resection of either one from the other's points.

    Returns the result with more inliers (within 3 px); None if neither has nine.
    """
    ways = [
        _seen_by(placed, pair.first, pair.second, pair.matches),
        _seen_by(placed, pair.second, pair.first, pair.matches[:, ::-1]),
    ]
    found, agreeing = max(ways, key=lambda way: way[1])
    return found if agreeing >= _MIN_AGREEING else None


def _seen_by(placed: PlacedFeatures, first: int, second: int, matches: IntArray) -> tuple[RelativePose | None, int]:
    """The second keyframe's pose in the first's frame by resection, and its inliers; None, 0 for under nine points."""
    points = placed.labels[first][matches[:, 0]]
    known = placed.known[points]
    if known.sum() < _MIN_AGREEING:
        return None, 0
    tolerance = _AGREEING_PX / placed.state.camera.focal
    T_map_second, agreeing = absolute_pose(
        placed.rays[second][matches[known, 1]], placed.points[points[known]], tolerance
    )
    return RelativePose(first, second, np.linalg.inv(placed.state.T_map_camera[first]) @ T_map_second), agreeing
