"""Which pairs of keyframes that look alike do show one place, and where they stand to each other.

Rooms are furnished alike, floors repeat. The walk by corners, neighbours and IMU alone is known to a few thousandths of
its length, and places every feature in metres: two that seem one must not be further apart than it may be off.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rholoc.geometry import BoolArray, FloatArray, IntArray
from rholoc.trajectory.optimization.adjustment import State, residuals_px, triangulate
from rholoc.trajectory.optimization.pose_graph import RelativePose
from rholoc.trajectory.visual.matching import VerifiedPair
from rholoc.trajectory.visual.tracks import Observations, linked_features
from rholoc.trajectory.visual.two_view import absolute_pose

_FEWEST_POINTS = 5
_LEAST_PARALLAX_DEG = 1.5
_FURTHEST_OFF_PX = 4.0
_FEWEST_AGREEING = 9
_AGREEING_PX = 3.0
_SIGMAS = 4.0
_ALLOWED_M = 0.10
_ALLOWED_OF_WAY = 0.005  # what a walk's own covariance does not know of


@dataclass(frozen=True, eq=False)
class PlacedFeatures:
    """Where the features of K keyframes are by a walk.

    Attributes:
        points: (M, 3) metres, in the walk's frame.
        known: (M,) bool, which of them are seen from places far enough apart.
        labels: of each keyframe's features the point, (F,) each.
        rays: of each keyframe's features, in its camera's frame, (F, 3) each.
        state: the walk.
    """

    points: FloatArray
    known: BoolArray
    labels: Sequence[IntArray]
    rays: Sequence[FloatArray]
    state: State


def place_features(neighbours: Sequence[VerifiedPair], pixels: Sequence[FloatArray], state: State) -> PlacedFeatures:
    """Place features by the matches of neighbours.

    Args:
        neighbours: pairs whose matches place features in the walk's frame.
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
    known = (parallax_deg > _LEAST_PARALLAX_DEG) & (furthest_px < _FURTHEST_OFF_PX)
    rays = [state.camera.rays(some) for some in pixels]
    return PlacedFeatures(points, known, np.split(label, first_feature[1:-1]), rays, state)


def loops_in_reach(loops: Sequence[VerifiedPair], placed: PlacedFeatures, sigmas_m: FloatArray) -> BoolArray:
    """Which loops (N,) may be true by a walk.

    Args:
        loops: pairs that seem to show a place seen again.
        placed: the features of all keyframes.
        sigmas_m: (K,) by how much each keyframe may be off the first.
    """
    steps_m = np.linalg.norm(np.diff(placed.state.positions, axis=0), axis=1)
    way_m = np.concatenate([[0.0], np.cumsum(steps_m)])
    kept = np.zeros(len(loops), dtype=np.bool_)
    for i, pair in enumerate(loops):
        one = placed.labels[pair.first][pair.matches[:, 0]]
        other = placed.labels[pair.second][pair.matches[:, 1]]
        both = placed.known[one] & placed.known[other]
        if both.sum() < _FEWEST_POINTS:
            continue
        off_m = float(np.linalg.norm(np.median(placed.points[other[both]] - placed.points[one[both]], axis=0)))
        walked_m = float(way_m[pair.second] - way_m[pair.first])
        sigma_m = float(max(sigmas_m[pair.first], sigmas_m[pair.second]))
        kept[i] = off_m <= _ALLOWED_M + _ALLOWED_OF_WAY * walked_m + _SIGMAS * sigma_m
    return kept


def loop_pose(pair: VerifiedPair, placed: PlacedFeatures) -> RelativePose | None:
    """Where two keyframes of a loop stand to each other: either by the points that the other places.

    Of the two ways the one with more points that agree; None where both have too few.
    """
    ways = [
        _seen_by(placed, pair.first, pair.second, pair.matches),
        _seen_by(placed, pair.second, pair.first, pair.matches[:, ::-1]),
    ]
    found, agreeing = max(ways, key=lambda way: way[1])
    return found if agreeing >= _FEWEST_AGREEING else None


def _seen_by(placed: PlacedFeatures, first: int, second: int, matches: IntArray) -> tuple[RelativePose | None, int]:
    """The second keyframe's pose in the first's frame, and how many points say so."""
    points = placed.labels[first][matches[:, 0]]
    known = placed.known[points]
    if known.sum() < _FEWEST_AGREEING:
        return None, 0
    tolerance = _AGREEING_PX / placed.state.camera.focal
    T_map_second, agreeing = absolute_pose(
        placed.rays[second][matches[known, 1]], placed.points[points[known]], tolerance
    )
    return RelativePose(first, second, np.linalg.inv(placed.state.T_map_camera[first]) @ T_map_second), agreeing
