"""Which pairs of keyframes that look alike do show one place: those that the walk without them does not keep apart.

Rooms are furnished alike, floors repeat. The walk by corners, neighbours and IMU alone is known to a few hundredths of
its length, and places every feature in metres: two that seem one must not be further apart than it may be off.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rholoc.geometry import BoolArray, FloatArray, IntArray
from rholoc.trajectory.adjustment import State, residuals_px, triangulate
from rholoc.trajectory.matching import VerifiedPair
from rholoc.trajectory.tracks import Observations, linked_features

_FEWEST_POINTS = 5
_LEAST_PARALLAX_DEG = 1.5
_FURTHEST_OFF_PX = 4.0
_SIGMAS = 4.0
_ALLOWED_M = 0.10
_ALLOWED_OF_WAY = 0.005  # what a walk's own covariance does not know of


def loops_in_reach(
    loops: Sequence[VerifiedPair],
    neighbours: Sequence[VerifiedPair],
    pixels: Sequence[FloatArray],
    state: State,
    sigmas_m: FloatArray,
) -> BoolArray:
    """Which loops (N,) may be true by a walk.

    Args:
        loops: pairs that seem to show a place seen again.
        neighbours: pairs whose matches place features in the walk's frame.
        pixels: of every keyframe's features, (F, 2) each.
        state: of the walk, in metres.
        sigmas_m: (K,) by how much each keyframe may be off the first.
    """
    first_feature = np.concatenate([[0], np.cumsum([len(some) for some in pixels])])
    points, known, label = _placed_features(neighbours, pixels, first_feature, state)
    way_m = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(state.positions, axis=0), axis=1))])
    kept = np.zeros(len(loops), dtype=np.bool_)
    for i, pair in enumerate(loops):
        one = label[first_feature[pair.first] + pair.matches[:, 0]]
        other = label[first_feature[pair.second] + pair.matches[:, 1]]
        both = known[one] & known[other]
        if both.sum() < _FEWEST_POINTS:
            continue
        off_m = float(np.linalg.norm(np.median(points[other[both]] - points[one[both]], axis=0)))
        walked_m = float(way_m[pair.second] - way_m[pair.first])
        sigma_m = float(max(sigmas_m[pair.first], sigmas_m[pair.second]))
        kept[i] = off_m <= _ALLOWED_M + _ALLOWED_OF_WAY * walked_m + _SIGMAS * sigma_m
    return kept


def _placed_features(
    neighbours: Sequence[VerifiedPair], pixels: Sequence[FloatArray], first_feature: IntArray, state: State
) -> tuple[FloatArray, BoolArray, IntArray]:
    """Points (M, 3) of neighbours' matches, which of them are known (M,), and the point of every feature (F,)."""
    _, label = linked_features(first_feature, neighbours)
    keyframe = np.repeat(np.arange(len(pixels)), np.diff(first_feature))
    seen = Observations(keyframe, label, np.concatenate(pixels))
    points, parallax_deg = triangulate(seen, state)
    furthest_px = np.zeros(len(points))
    np.maximum.at(furthest_px, label, residuals_px(seen, state, points))
    return points, (parallax_deg > _LEAST_PARALLAX_DEG) & (furthest_px < _FURTHEST_OFF_PX), label
