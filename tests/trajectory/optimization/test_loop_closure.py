"""Rooms that are furnished alike are told apart by the walk between them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from rholoc.geometry import Camera, FloatArray, Pose
from rholoc.trajectory.optimization.adjustment import State
from rholoc.trajectory.optimization.loop_closure import loop_pose, loops_in_reach, place_features
from rholoc.trajectory.visual.matching import VerifiedPair

_CAMERA = Camera(640, 480, 520.0, 520.0, 319.5, 239.5)
_POINTS = 30
_FIRST, _AGAIN, _ALIKE = range(0, 6), range(6, 12), range(12, 18)  # keyframes of a room, of it again, of its twin
_APART = np.array([3.0, 0.0, 0.0])  # from a room to the one like it


def _rooms(drift: FloatArray) -> tuple[State, list[FloatArray]]:
    """A walk whose second look at the room is off by ``drift`` (3,), and where in the pictures points appear."""
    rng = np.random.default_rng(2)
    room = rng.uniform([-1.5, 3.0, 0.4], [1.5, 5.0, 2.4], (_POINTS, 3))
    T, pixels = [], []
    for k in range(18):
        at = np.array([0.15 * (k % 6), 0.0, 1.4])
        pose = Pose.from_heading(at, np.array([0.0, 1.0, 0.0]))
        pixels.append(_CAMERA.project((room - at) @ pose.R_map_camera))
        moved = pose.T_map_camera.copy()
        moved[:3, 3] += _APART if k in _ALIKE else drift if k in _AGAIN else np.zeros(3)
        T.append(moved)
    return State(np.array(T), np.zeros((0, 3)), _CAMERA), pixels


def _pair(first: int, second: int) -> VerifiedPair:
    return VerifiedPair(first, second, np.tile(np.arange(_POINTS)[:, None], 2), np.eye(3))


def _neighbours() -> list[VerifiedPair]:
    return [_pair(k, k + step) for step in (1, 2) for k in range(18 - step) if k // 6 == (k + step) // 6]


def _judged(drift_m: float, sigma_m: float, pairs: Sequence[VerifiedPair]) -> list[bool]:
    state, pixels = _rooms(np.array([0.0, drift_m, 0.0]))
    return loops_in_reach(pairs, place_features(_neighbours(), pixels, state), np.full(18, sigma_m)).tolist()


@pytest.mark.parametrize("drift_m", [0.0, 0.08, 0.25])
def test_a_room_seen_again_is_told_from_one_like_it(drift_m: float) -> None:
    assert _judged(drift_m, 0.05, [_pair(2, 8), _pair(2, 14), _pair(8, 14)]) == [True, False, False]


def test_a_walk_that_is_known_less_well_allows_more() -> None:
    assert _judged(0.5, 0.02, [_pair(2, 8)]) == [False]
    assert _judged(0.5, 0.15, [_pair(2, 8)]) == [True]


def test_features_without_a_place_prove_nothing() -> None:
    state, pixels = _rooms(np.zeros(3))
    placed = place_features(_neighbours()[:2], pixels, state)
    assert loops_in_reach([_pair(2, 8)], placed, np.full(18, 0.1)).tolist() == [False]
    assert loop_pose(_pair(2, 8), place_features([], pixels, state)) is None


@pytest.mark.parametrize("drift_m", [0.0, 0.5, 3.0])
def test_where_a_loops_keyframes_stand_to_each_other_is_free_of_drift(drift_m: float) -> None:
    state, pixels = _rooms(np.array([0.0, drift_m, 0.0]))
    found = loop_pose(_pair(2, 9), place_features(_neighbours(), pixels, state))
    assert found is not None
    R = state.R_map_camera[found.first]
    moved = R @ found.T_first_second[:3, 3]
    np.testing.assert_allclose(np.sign(found.second - found.first) * moved, [0.15, 0.0, 0.0], atol=1e-3)
    np.testing.assert_allclose(found.T_first_second[:3, :3], np.eye(3), atol=1e-3)
