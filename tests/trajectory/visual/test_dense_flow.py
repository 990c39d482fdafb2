"""Dense optical flow of a picture that moves as a whole."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from rholoc.geometry import ByteArray
from rholoc.trajectory.visual.dense_flow import DenseMethod, dense_flow, off_tracks


def _moved() -> tuple[ByteArray, ByteArray]:
    """A texture, and the same three pixels further right and two up."""
    wall = cv2.GaussianBlur(np.random.default_rng(0).integers(0, 255, (160, 220, 3), dtype=np.uint8), (0, 0), 2)
    return wall[20:140, 20:200].copy(), wall[22:142, 17:197].copy()


@pytest.mark.parametrize("method", list(DenseMethod))
@pytest.mark.parametrize("grey", [False, True])
def test_every_pixel_moves_with_the_picture(method: DenseMethod, grey: bool) -> None:
    before, after = _moved()
    if grey:
        before, after = (cv2.cvtColor(one, cv2.COLOR_BGR2GRAY) for one in (before, after))
    field = dense_flow(before, after, method)
    assert field.shape == (120, 180, 2)
    inside = field[20:-20, 20:-20].reshape(-1, 2)
    np.testing.assert_allclose(np.median(inside, axis=0), [3, -2], atol=0.2)
    assert np.percentile(np.abs(inside - [3, -2]), 90) < 0.5


def test_it_is_held_against_the_ways_of_corners() -> None:
    """At the pixel nearest to where a corner was; outside of the picture, at its edge."""
    field = np.zeros((10, 20, 2))
    field[4, 7] = [1.0, 2.0]
    field[9, 19] = [0.0, -3.0]
    field[0, 0] = [5.0, 0.0]
    before = np.array([[7.4, 3.6], [25.0, 30.0], [-4.0, -0.6], [7.6, 4.0]])
    off = off_tracks(field, before, np.add(before, [[1.0, 2.0], [0.0, 1.0], [2.0, 4.0], [3.0, 4.0]]))
    np.testing.assert_allclose(off, [0.0, 4.0, 5.0, 5.0], atol=1e-12)
