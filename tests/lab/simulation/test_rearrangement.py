"""Furniture moved: nothing overlaps, nothing stands in the way, and the rest of the room stays as it is."""

from __future__ import annotations

import numpy as np
import pytest

from rholoc.simulation import make_walk
from rholoc.simulation.scene import Box
from rholoc_lab.simulation.rearrangement import rearranged


@pytest.fixture(scope="module")
def way():
    return make_walk(1).positions(np.linspace(0, 30, 60))


@pytest.fixture(scope="module", params=[0, pytest.param(2, marks=pytest.mark.slow)])
def rearrangement(site, way, request):
    """The room with a third of its furniture moved, and what was."""
    return rearranged(site, 1 / 3, request.param, way)


def overlap(a: Box, b: Box) -> bool:
    """Whether two boxes share more than a millimetre, by the separating axes of both."""
    corners_a, corners_b = a.corners, b.corners
    for axis in np.concatenate([a.axes, b.axes]):
        on_a, on_b = corners_a @ axis, corners_b @ axis
        if on_a.max() <= on_b.min() + 1e-3 or on_b.max() <= on_a.min() + 1e-3:
            return False
    return True


def test_a_third_of_the_furniture_stands_elsewhere(site, rearrangement):
    moved, names = rearrangement
    pieces = {box.piece for box in site.boxes if box.piece}
    assert len(names) == len(set(names)) == int(np.ceil(len(pieces) / 3))
    before, after = ({piece: [b for b in s.boxes if b.piece == piece] for piece in pieces} for s in (site, moved))
    for piece in pieces:
        assert len(before[piece]) == len(after[piece])
        shift = [float(np.linalg.norm(b.centre - a.centre)) for b, a in zip(before[piece], after[piece], strict=True)]
        assert (min(shift) > 0.3) if piece in names else (max(shift) == 0)
        assert [b.centre[2] for b in before[piece]] == [a.centre[2] for a in after[piece]]


def test_what_was_moved_overlaps_nothing_and_stands_in_nobodys_way(way, rearrangement):
    moved, names = rearrangement
    for box in moved.boxes:
        if box.piece in names:
            assert not any(overlap(box, other) for other in moved.boxes if other.piece != box.piece)
            inside = np.abs((box.corners - moved.room.centre) @ moved.room.axes.T) <= 0.5 * moved.room.size + 1e-6
            assert inside.all()
            gaps = np.abs((way - box.centre) @ box.axes.T) - 0.5 * box.size
            assert gaps.max(axis=1).min() > 0.25


def test_the_same_seed_moves_the_same(site, way):
    (_, names), (_, again) = (rearranged(site, 1 / 6, 4, way) for _ in range(2))
    assert names == again


def test_a_room_without_space_says_so(site):
    grid = np.stack(np.meshgrid(np.arange(-2, 5, 0.5), np.arange(-1, 5, 0.5), [0.0]), axis=-1).reshape(-1, 3)
    with pytest.raises(ValueError, match="find another place"):
        rearranged(site, 1.0, 0, grid)
