"""Pictures that were added to a reconstruction at a place that only looks alike."""

import numpy as np
import pytest
from scene import CAMERA, arc, cloud, in_pixels

from rholoc.geometry import FloatArray
from rholoc.trajectory.optimization.problem import State
from rholoc.trajectory.reconstruction.pair_fit import without_contradicted
from rholoc.trajectory.visual.matching import VerifiedPair

_MEMBERS = np.arange(5)
_DOOR, _ROOM = np.arange(60), np.arange(60, 120)  # features of a door like another one, and of everything else


@pytest.fixture
def rays() -> list[FloatArray]:
    """Rays of eight pictures. The last two took their places in the arc, and what they show of a door is as if they
    had stood where the first two did.
    """
    T, door, room = arc(8), cloud(60), np.roll(cloud(60), 7, axis=1)
    doors = np.concatenate([T[:6], T[:2]])
    return [
        np.concatenate([CAMERA.rays(in_pixels(door, seen_from)), CAMERA.rays(in_pixels(room, own))])
        for seen_from, own in zip(doors, T, strict=True)
    ]


def _pair(first: int, second: int, features: np.ndarray) -> VerifiedPair:
    return VerifiedPair(first, second, np.column_stack([features] * 2), np.eye(3))


def _kept(added: dict[int, FloatArray], pairs: list[VerifiedPair], rays: list[FloatArray]) -> list[int]:
    now = np.array([*_MEMBERS, *added])
    state = State(np.array([*arc(8)[_MEMBERS], *added.values()]), np.zeros((0, 3)), CAMERA)
    found, kept = without_contradicted((state, now), _MEMBERS, pairs, rays)
    assert len(found.T_map_camera) == len(kept)
    return kept.tolist()


def test_pictures_of_another_door_go_together(rays: list[FloatArray]) -> None:
    """Seven pictures of one end of a corridor were added 4 m off, by a door like another: one of them had no pair with
    a picture that showed where it belonged.
    """
    right, wrong = {5: arc(8)[5]}, {6: arc(8)[0], 7: arc(8)[1]}
    pairs = [_pair(0, 5, _ROOM), _pair(0, 6, _DOOR), _pair(1, 7, _DOOR), _pair(6, 7, _DOOR), _pair(4, 6, _ROOM)]
    assert _kept(right | wrong, [*pairs, _pair(3, 6, _ROOM)], rays) == [0, 1, 2, 3, 4, 5]


def test_pictures_at_their_place_stay_beside_a_door_that_looks_alike(rays: list[FloatArray]) -> None:
    own = {6: arc(8)[6], 7: arc(8)[7]}
    pairs = [_pair(4, 6, _ROOM), _pair(3, 7, _ROOM), _pair(6, 7, _ROOM), _pair(0, 6, _DOOR)]
    assert _kept(own, [*pairs, _pair(2, 6, _ROOM)], rays) == [0, 1, 2, 3, 4, 6, 7]


def test_without_added_pictures_nothing_changes(rays: list[FloatArray]) -> None:
    assert _kept({}, [_pair(0, 4, _ROOM)], rays) == _MEMBERS.tolist()
