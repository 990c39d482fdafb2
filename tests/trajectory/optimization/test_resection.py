"""Pictures that a reconstruction left out are placed by the points that it knows."""

import numpy as np
import pytest
from scene import CAMERA, arc, in_pixels

from rholoc.trajectory.optimization.problem import State
from rholoc.trajectory.optimization.resection import with_missing_placed
from rholoc.trajectory.visual.tracks import Observations

_COUNT = 9
_LEFT_OUT = np.array([4, 8])


@pytest.fixture
def observations() -> Observations:
    """Points before and behind a wall, seen by all cameras of an arc, to 0.3 px."""
    rng = np.random.default_rng(3)
    points = rng.uniform([-1, -0.8, -0.3], [1, 0.8, 0.3], (60, 3))
    pixels = np.concatenate([in_pixels(points, one) for one in arc(_COUNT)]) + rng.normal(0, 0.3, (60 * _COUNT, 2))
    return Observations(np.repeat(np.arange(_COUNT), 60), np.tile(np.arange(60), _COUNT), pixels)


def _placed(observations: Observations) -> tuple[State, np.ndarray]:
    members = np.setdiff1d(np.arange(_COUNT), _LEFT_OUT)
    return with_missing_placed(observations, members, State(arc(_COUNT)[members], np.zeros((0, 3)), CAMERA), _COUNT)


def test_all_are_placed(observations: Observations) -> None:
    state, members = _placed(observations)
    np.testing.assert_array_equal(members, np.arange(_COUNT))
    np.testing.assert_allclose(state.T_map_camera, arc(_COUNT), atol=0.03)
    assert len(state.points) == 0


def test_a_picture_of_something_else_is_left_out(observations: Observations) -> None:
    of_stranger = observations.keyframes == _LEFT_OUT[0]
    observations.pixels[of_stranger] = np.random.default_rng(4).permutation(observations.pixels[of_stranger])
    _, members = _placed(observations)
    assert _LEFT_OUT[0] not in members
    assert _LEFT_OUT[1] in members


def test_a_picture_with_few_known_points_is_left_out(observations: Observations) -> None:
    few = (observations.keyframes != _LEFT_OUT[1]) | (observations.tracks < 14)
    _, members = _placed(observations.at(few))
    assert _LEFT_OUT[1] not in members
    assert _LEFT_OUT[0] in members
