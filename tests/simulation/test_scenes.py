"""Scenes: boxes, the order they are painted in, and what stands in the way."""

from __future__ import annotations

import numpy as np
import pytest

from rholoc.simulation import Scene, make_walk
from rholoc.simulation.scene import Box, DrawOrder, Face, Paint

GRAY = Paint(np.full((8, 8, 3), 128, np.uint8))


def make_box(centre: tuple[float, float, float], yaw: float = 0.0) -> Box:
    paints = dict.fromkeys(("x+", "y+", "x-", "y-", "z+", "z-"), GRAY)
    return Box(np.array(centre), np.array([1.0, 0.8, 0.6]), yaw, paints)


@pytest.mark.parametrize("inside", [False, True])
def test_faces_look_away_from_the_box_or_into_the_room(inside: bool) -> None:
    box = make_box((1.0, 2.0, 3.0), yaw=0.3)
    for face in box.faces(inside):
        outwards = face.points(np.array(0.5), np.array(0.5)) - box.centre
        assert (outwards @ face.normal > 0) != inside


def test_upright_faces_have_their_top_row_on_top() -> None:
    for name, face in zip(("x+", "y+", "x-", "y-"), make_box((0, 0, 0)).faces()[:4], strict=True):
        assert isinstance(face, Face), name
        assert face.down[2] < 0


def test_boxes_are_painted_back_to_front() -> None:
    boxes = tuple(make_box((x, 0.0, 0.0), yaw=0.2 * x) for x in (6.0, 2.0, 4.0))
    assert DrawOrder(boxes)(np.array([0.0, 0.0, 0.0])) == [0, 2, 1]
    assert DrawOrder(boxes)(np.array([9.0, 0.0, 0.0])) == [1, 2, 0]


def test_boxes_of_the_test_site_do_not_overlap_and_stand_in_the_room(site: Scene) -> None:
    low, high = site.room.corners.min(axis=0), site.room.corners.max(axis=0)
    samples = np.random.default_rng(0).uniform(-0.499, 0.499, (200, 3))
    for i, box in enumerate(site.boxes):
        points = box.centre + (samples * box.size) @ box.axes
        assert (points >= low - 1e-9).all(), i
        assert (points <= high + 1e-9).all(), i
        for j, other in enumerate(site.boxes):
            if i != j:
                inside = (np.abs((points - other.centre) @ other.axes.T) < 0.5 * other.size - 1e-6).all(axis=1)
                assert not inside.any(), (i, j)


def test_the_walks_keep_clear_of_the_furniture(site: Scene) -> None:
    for number in (1, 2, 3):
        positions = make_walk(number).positions(np.linspace(0, 30, 301))
        for box in site.boxes:
            outside = np.abs((positions - box.centre) @ box.axes.T) - 0.5 * box.size
            assert np.linalg.norm(np.maximum(outside, 0), axis=1).min() > 0.3


def test_boxes_block_the_view_behind_them(site: Scene) -> None:
    scene = Scene(site.room, (make_box((2.0, 0.0, 0.0)),))
    ends = np.array([[4.0, 0, 0], [1.4, 0, 0], [4.0, 3.0, 0], [4.0, 0, 2.0]])
    assert scene.blocked(np.zeros(3), ends).tolist() == [True, False, False, False]
