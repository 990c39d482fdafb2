"""A camera that turns where it stands shifts nothing, one that walks shifts what is near."""

from __future__ import annotations

import numpy as np
import pytest
from scene import rays
from scipy.spatial.transform import Rotation

from rholoc.geometry import FloatArray
from rholoc.trajectory.visual.matching import VerifiedPair
from rholoc.trajectory.visual.parallax import only_turned, shifts

_FOCAL_PX = 500.0
_NOISE_PX = 0.5


def _seen(points: FloatArray, R: FloatArray, position: FloatArray, rng: np.random.Generator) -> FloatArray:
    seen = (points - position) @ R
    return rays(seen[:, :2] / seen[:, 2:] + rng.normal(0, _NOISE_PX / _FOCAL_PX, (len(points), 2)))


def _walk(step_m: float, wrong: float = 0.0) -> tuple[list[VerifiedPair], list[FloatArray]]:
    """Ten keyframes 5° and ``step_m`` apart, things 1 to 4 m away, of which a share is matched wrongly."""
    rng = np.random.default_rng(0)
    points = rng.uniform([-2, -1, 1], [2, 1, 4], (120, 3))
    turns = Rotation.from_euler("y", 5 * (np.arange(10)[:, None] - 5), degrees=True).as_matrix()
    seen = [_seen(points, R, np.array([step_m * k, 0, -0.5]), rng) for k, R in enumerate(turns)]
    numbers = np.arange(120)
    others = numbers.copy()
    some = rng.choice(120, int(120 * wrong), replace=False)
    others[some] = rng.permutation(others[some])
    matches = np.column_stack([numbers, others])
    return [VerifiedPair(k, k + 1, matches, turns[k + 1].T @ turns[k]) for k in range(9)], seen


@pytest.mark.parametrize("wrong", [0.0, 0.2])
def test_a_camera_that_turns_where_it_stands_leaves_noise(wrong: float) -> None:
    pairs, seen = _walk(0.0, wrong)
    assert only_turned(pairs, seen)
    assert np.all(shifts(pairs, seen) < 2.5 * _NOISE_PX / _FOCAL_PX)


@pytest.mark.parametrize("wrong", [0.0, 0.2])
def test_one_that_walks_does_not(wrong: float) -> None:
    pairs, seen = _walk(0.1, wrong)
    assert not only_turned(pairs, seen)
    assert np.median(shifts(pairs, seen)) > 0.005


def test_a_step_is_enough() -> None:
    """Standing for most of a walk is not standing."""
    standing, seen = _walk(0.0)
    walking, more = _walk(0.2)
    later = [VerifiedPair(pair.first + 10, pair.second + 10, pair.matches, pair.R_second_first) for pair in walking]
    assert not only_turned([*standing, *later], [*seen, *more])


def test_no_pairs_say_nothing() -> None:
    assert not only_turned([], [])


def test_a_shift_is_the_angle_left_by_the_best_rotation() -> None:
    """Of far things and a few near ones, that of the near ones is what does not fit."""
    rng = np.random.default_rng(0)
    points = rng.uniform([-200, -100, 900], [200, 100, 1000], (101, 3))
    points[:60] = rng.uniform([-1, -1, 4.9], [1, 1, 5.1], (60, 3))
    R = Rotation.from_euler("y", [[0], [5]], degrees=True).as_matrix()
    for sideways_m in (0.0, 0.05):
        seen = [(points - [sideways_m * k, 0, 0]) @ R[k] for k in range(2)]
        seen = [rays(one[:, :2] / one[:, 2:]) for one in seen]
        pair = VerifiedPair(0, 1, np.tile(np.arange(101)[:, None], 2), R[1].T @ R[0])
        (found,) = shifts([pair], seen)
        assert found < 2e-3 if sideways_m == 0 else 0 < found < 0.05 / 5
    few = VerifiedPair(0, 1, np.tile(np.arange(40, 101)[:, None], 2), R[1].T @ R[0])
    assert shifts([few], seen)[0] < 5e-4  # forty-one of sixty-one are far
