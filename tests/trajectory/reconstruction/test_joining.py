"""Pieces of a set of pictures are put into one frame where several measurements say how."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scene import CAMERA, arc, cloud, in_pixels
from scipy.spatial.transform import Rotation

from rholoc.errors import MappingFailed
from rholoc.geometry import FloatArray, Similarity
from rholoc.progress import silent
from rholoc.recordings import Waypoint
from rholoc.trajectory.optimization.problem import State
from rholoc.trajectory.optimization.rounds import AdjustmentProgress
from rholoc.trajectory.reconstruction.joining import joined_by_points, joined_by_waypoints, with_pieces_joined
from rholoc.trajectory.reconstruction.part import Pictured, Start, adjusted_part
from rholoc.trajectory.visual.matching import VerifiedPair
from rholoc.trajectory.visual.tracks import Observations

_COUNT, _POINTS = 12, 80
_AWAY = Similarity(2.5, Rotation.from_rotvec([0.3, -0.8, 0.2]).as_matrix(), np.array([4.0, -2.0, 1.0]))
_FIRST, _LAST = np.arange(6), np.arange(6, 12)
_LINKS = [(5, 6), (4, 7), (3, 8)]


def _pixels() -> FloatArray:
    """What each picture shows of the points, to 0.3 px: (12, 80, 2)."""
    exact = np.array([in_pixels(cloud(_POINTS), T) for T in arc(_COUNT)])
    return exact + np.random.default_rng(0).normal(0, 0.3, exact.shape)


def _observations(pixels: FloatArray) -> Observations:
    keyframes, tracks = (some.ravel() for some in np.indices(pixels.shape[:2]))
    return Observations(keyframes, tracks, pixels.reshape(-1, 2))


def _rays(pixels: FloatArray) -> list[FloatArray]:
    return [CAMERA.rays(some) for some in pixels]


def _start(members: np.ndarray, frame: Similarity | None = None) -> Start:
    T = arc(_COUNT)[members]
    return State(T if frame is None else frame.poses(T), np.zeros((0, 3)), CAMERA), members


def _pairs(links: Sequence[tuple[int, int]]) -> list[VerifiedPair]:
    matches = np.column_stack([np.arange(_POINTS)] * 2)
    return [VerifiedPair(a, b, matches, np.eye(3)) for a, b in links]


def test_a_piece_joins_by_the_points_that_both_know() -> None:
    pixels = _pixels()
    (state, members), apart = joined_by_points(
        _start(_FIRST), [_start(_LAST, _AWAY)], _observations(pixels), _pairs(_LINKS), _rays(pixels)
    )
    assert apart == ()
    np.testing.assert_array_equal(members, np.arange(_COUNT))
    np.testing.assert_allclose(state.T_map_camera, arc(_COUNT), atol=0.03)


def test_pictures_of_both_pieces_keep_their_pose() -> None:
    pixels, overlapping = _pixels(), np.arange(4, 12)
    (state, members), _ = joined_by_points(
        _start(_FIRST), [_start(overlapping, _AWAY)], _observations(pixels), _pairs(_LINKS), _rays(pixels)
    )
    np.testing.assert_array_equal(members, np.arange(_COUNT))
    np.testing.assert_array_equal(state.T_map_camera[:6], arc(_COUNT)[:6])


@pytest.mark.parametrize(("shared", "apart"), [(5, 1), (6, 0)])
def test_a_common_picture_joins_by_six_points(shared: int, apart: int) -> None:
    pixels, overlapping = _pixels(), np.arange(5, 12)
    seen = _observations(pixels)
    few = seen.at((seen.tracks < shared) | (seen.keyframes < 6))
    starts = _start(_FIRST), [_start(overlapping, _AWAY)]
    assert len(joined_by_points(*starts, few, _pairs(_LINKS[:1]), _rays(pixels))[1]) == apart


def test_where_a_common_picture_shows_too_few_points_pairs_of_other_pictures_may_join() -> None:
    pixels = _pixels()
    seen = _observations(pixels)
    few = seen.at((seen.tracks < 5) | (seen.keyframes < 6))
    _, apart = joined_by_points(_start(_FIRST), [_start(np.arange(5, 12), _AWAY)], few, _pairs(_LINKS), _rays(pixels))
    assert apart == ()


def test_a_piece_may_join_by_another_one() -> None:
    """The last four pictures share nothing with the first four, but both do with those between."""
    pixels = _pixels()
    seen = _observations(pixels)
    early, late = (seen.keyframes < 8) & (seen.tracks < 40), (seen.keyframes >= 4) & (seen.tracks >= 40)
    starts = [_start(np.arange(8, 12), _AWAY), _start(np.arange(4, 8), _AWAY)]
    links = [(3, 4), (2, 5), (7, 8), (6, 9)]
    (_, members), apart = joined_by_points(
        _start(np.arange(4)), starts, seen.at(early | late), _pairs(links), _rays(pixels)
    )
    assert apart == ()
    np.testing.assert_array_equal(members, np.arange(_COUNT))


@pytest.mark.parametrize("links", [[(5, 6)], [(5, 6), (5, 7), (5, 8)]])
def test_one_picture_does_not_join_pieces(links: list[tuple[int, int]]) -> None:
    pixels = _pixels()
    (_, members), apart = joined_by_points(
        _start(_FIRST), [_start(_LAST, _AWAY)], _observations(pixels), _pairs(links), _rays(pixels)
    )
    np.testing.assert_array_equal(members, _FIRST)
    assert len(apart) == 1


def test_few_points_do_not_join_pieces() -> None:
    pixels = _pixels()
    seen = _observations(pixels)
    few = seen.at((seen.tracks < 14) | (seen.keyframes < 6))
    assert len(joined_by_points(_start(_FIRST), [_start(_LAST, _AWAY)], few, _pairs(_LINKS), _rays(pixels))[1]) == 1


def test_a_door_that_looks_alike_does_not_join_pieces() -> None:
    """Matches of two doors fit a similarity, which those of all else contradict."""
    pixels = _pixels()
    pixels[6:, :40] = pixels[:6, :40]  # the last pictures show a door as the first ones do
    beside = State(_AWAY.poses(arc(_COUNT)[_FIRST]), np.zeros((0, 3)), CAMERA), _LAST
    seen = _observations(pixels)
    doors = [replace(pair, matches=pair.matches[:40]) for pair in _pairs([(0, 7), (1, 8), (2, 6)])]
    room = [replace(pair, matches=pair.matches[40:]) for pair in _pairs(_LINKS)]

    def apart(pairs: list[VerifiedPair]) -> int:
        door = seen.at(seen.tracks < 40)
        return len(joined_by_points(_start(_FIRST), [beside], door, pairs, _rays(pixels))[1])

    assert apart(doors) == 0
    assert apart(doors + room) == 1


def _waypoints(pictures: Sequence[int]) -> tuple[Waypoint, ...]:
    positions = arc(_COUNT)[list(pictures), :3, 3]
    return tuple(Waypoint(f"w{k}", float(k), tuple(p)) for k, p in zip(pictures, positions.tolist(), strict=True))


def test_pieces_join_by_their_waypoints() -> None:
    starts = _start(_FIRST, _AWAY), [_start(_LAST)]
    (state, members), sizes = joined_by_waypoints(*starts, np.arange(12.0), _waypoints([0, 2, 5, 6, 9, 11]))
    assert sizes == (6, 6)
    np.testing.assert_array_equal(members, np.arange(_COUNT))
    np.testing.assert_allclose(state.positions, arc(_COUNT)[:, :3, 3], atol=1e-6)


def test_pictures_of_both_pieces_are_counted_once() -> None:
    """Pieces of one mapper may have pictures in common that show too few points to join them."""
    starts = _start(_FIRST, _AWAY), [_start(np.arange(4, 12))]
    _, sizes = joined_by_waypoints(*starts, np.arange(12.0), _waypoints([0, 2, 5, 6, 9, 11]))
    assert sizes == (6, 6)


def test_a_piece_with_two_waypoints_does_not_join() -> None:
    starts = _start(_FIRST, _AWAY), [_start(_LAST)]
    (_, members), sizes = joined_by_waypoints(*starts, np.arange(12.0), _waypoints([0, 2, 5, 6, 11]))
    assert sizes == (6,)
    np.testing.assert_array_equal(members, _FIRST)


def test_a_start_without_waypoints_is_an_error() -> None:
    with pytest.raises(MappingFailed, match="do not fix a frame"):
        joined_by_waypoints(_start(_FIRST), [_start(_LAST)], np.arange(12.0), _waypoints([0, 6, 8, 9, 11]))


def _walk(waypoints: tuple[Waypoint, ...], pixels: FloatArray) -> Pictured:
    """Pictures at seconds 0 to 11 without pairs between the first six and the last six."""
    features = [type("Features", (), {"pixels": some})() for some in pixels]
    taken = type("Sights", (), {"steps": ()})()
    things = {"rows": np.arange(_COUNT), "times": np.arange(float(_COUNT)), "camera": CAMERA, "features": features}
    sights: Any = type("Sights", (), things | {"take": lambda *_: taken})()
    evidence: Any = type("Evidence", (), {"sequential": _pairs([(0, 3), (2, 5), (6, 9), (8, 11)])})()
    return Pictured(sights, CAMERA, evidence, [waypoints])


@pytest.mark.parametrize(("pictures", "sizes"), [([0, 2, 5, 6, 9, 11], (6, 6)), ([0, 2, 5, 6, 11], ())])
def test_pieces_that_share_nothing_are_adjusted_to_the_waypoints_together(
    pictures: list[int], sizes: tuple[int, ...]
) -> None:
    """A second mapper's version of a piece is not a further piece."""
    pixels, progress = _pixels(), AdjustmentProgress(silent)
    seen = _observations(pixels)
    apart = replace(seen, tracks=seen.tracks + _POINTS * (seen.keyframes > 5))
    walk = _walk(_waypoints(pictures), pixels)
    part = adjusted_part(walk, apart, _start(_FIRST, _AWAY), progress, (0.0, 0.5))
    found = with_pieces_joined(part, [_start(_LAST), _start(_LAST, _AWAY)], walk, apart, progress)
    assert found.by_waypoints == sizes
    if sizes:
        np.testing.assert_allclose(found.adjusted.state.positions, arc(_COUNT)[:, :3, 3], atol=0.02)
    else:
        assert found is part
