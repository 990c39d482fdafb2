"""Sightings of points by keyframes: followed corners, matched features, and what may be done with them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scene import CAMERA, arc, cloud, in_pixels
from scipy.spatial.transform import Rotation
from synthetic_walk import followed

from rholoc.geometry import FloatArray, rotation_angles
from rholoc.trajectory.visual.matching import VerifiedPair
from rholoc.trajectory.visual.tracks import (
    Observations,
    followed_corners,
    linked_features,
    matched_features,
    pieces_of,
    thinned_matches,
)


@st.composite
def _observations(draw: st.DrawFn) -> Observations:
    """Sightings of points by some of eight keyframes, each point at most once by each."""
    seen = np.array(draw(st.lists(st.lists(st.booleans(), min_size=8, max_size=8), min_size=1, max_size=12)))
    keyframes, tracks = np.nonzero(seen.T)
    whole = Observations(keyframes, tracks, np.column_stack([keyframes, tracks]).astype(np.float64))
    return whole.take(np.ones(len(whole), np.bool_))


def _names(observations: Observations) -> list[set[tuple[int, int]]]:
    """Each point as the set of its sightings, known by their pixels; these are never changed."""
    return [set(map(tuple, observations.pixels[observations.tracks == t].tolist())) for t in range(observations.points)]


def _check(observations: Observations) -> None:
    """Points are numbered without gaps, seen from three keyframes or more, from each once."""
    counts = np.bincount(observations.tracks, minlength=observations.points)
    assert counts.size == 0 or counts.min() >= 3
    pairs = np.column_stack([observations.keyframes, observations.tracks])
    assert len(np.unique(pairs, axis=0)) == len(pairs)
    np.testing.assert_array_equal(observations.keyframes, observations.pixels[:, 0])


@given(observations=_observations(), seed=st.integers(0, 100))
def test_some_of_the_sightings_are_still_whole_points(observations: Observations, seed: int) -> None:
    kept = np.random.default_rng(seed).random(len(observations)) < 0.7
    some = observations.take(kept)
    _check(some)
    remaining = [name & set(map(tuple, observations.pixels[kept].tolist())) for name in _names(observations)]
    assert _names(some) == [name for name in remaining if len(name) >= 3]


@given(first=_observations(), second=_observations())
def test_joined_points_stay_apart(first: Observations, second: Observations) -> None:
    both = first.joined(second)
    assert len(both) == len(first) + len(second)
    assert both.points == first.points + second.points
    assert _names(both) == _names(first) + _names(second)


@given(observations=_observations(), most=st.integers(1, 6))
def test_thinned_points_are_the_longest_and_leave_no_keyframe_short(observations: Observations, most: int) -> None:
    thinned = observations.thinned(most)
    _check(thinned)
    names, all_names = _names(thinned), _names(observations)
    assert all(name in all_names for name in names)
    before = np.bincount(observations.keyframes, minlength=8)
    after = np.bincount(thinned.keyframes, minlength=8)
    assert np.all(after >= np.minimum(before, most))
    dropped = [name for name in all_names if name not in names]
    if dropped:
        assert max(map(len, names)) >= max(map(len, dropped))


def _following(jump_px: float) -> tuple[FloatArray, Observations, list[float], FloatArray]:
    T = arc(10, 0.5)
    points = cloud(80)
    rng = np.random.default_rng(0)
    pixels = np.array([in_pixels(points, one) for one in T]) + rng.normal(0, 0.2, (10, 80, 2))
    pixels[5:, 7] += [0.0, jump_px]  # an edge behind another: the corner slides on
    flow = followed(np.arange(10.0), (640, 480), pixels, np.ones((10, 80), np.bool_))
    found, rotations = followed_corners(flow, np.arange(10), CAMERA, None, None)
    off = [rotation_angles(pair.R_second_first, T[pair.second, :3, :3].T @ T[pair.first, :3, :3]) for pair in rotations]
    return pixels, found, off, np.array([pair.second - pair.first for pair in rotations])


def test_corners_are_followed_as_one_point_each() -> None:
    _, found, off, steps = _following(0.0)
    lengths = np.bincount(found.tracks)
    assert np.mean(lengths == 10) > 0.9
    assert set(steps.tolist()) == {1, 4}
    assert np.degrees(np.max(off)) < 1.5


def test_a_corner_that_leaves_the_epipolar_geometry_becomes_another_point() -> None:
    pixels, found, _, _ = _following(25.0)
    here = np.isin(found.pixels, pixels[:, 7]).all(axis=1)
    by_track = {int(track): found.keyframes[here & (found.tracks == track)] for track in np.unique(found.tracks[here])}
    assert sorted(rows.tolist() for rows in by_track.values()) == [[0, 1, 2, 3, 4], [5, 6, 7, 8, 9]]


def test_rotations_that_the_gyroscope_contradicts_are_not_used() -> None:
    T = arc(10, 0.5)
    pixels = np.array([in_pixels(cloud(80), one) for one in T])
    flow = followed(np.arange(10) / 10, (640, 480), pixels, np.ones((10, 80), np.bool_))
    spinning = Rotation.from_rotvec(np.outer(np.radians(20.0 * np.arange(10)), [0.0, 1.0, 0.0]))
    _, rotations = followed_corners(flow, np.arange(10), CAMERA, spinning, None)
    assert not rotations
    _, rotations = followed_corners(flow, np.arange(10), CAMERA, Rotation.from_matrix(T[:, :3, :3]), None)
    assert len(rotations) == 9 + 6


def _pair(first: int, second: int, matches: list[tuple[int, int]]) -> VerifiedPair:
    return VerifiedPair(first, second, np.array(matches), np.eye(3))


def test_matches_link_features_to_points_and_doubles_are_dropped() -> None:
    planes = [np.array([[float(k), float(i)] for i in range(4)]) for k in range(4)]
    pairs = [
        _pair(0, 1, [(0, 0), (1, 1)]),
        _pair(1, 2, [(0, 2), (1, 1), (3, 3)]),
        _pair(0, 2, [(2, 1)]),  # 0's features 1 and 2 are both the point 1: of keyframe 0 neither is right
        _pair(2, 3, [(2, 3), (1, 1)]),
    ]
    found = matched_features(planes, pairs)
    assert sorted(map(sorted, _names(found))) == [
        [(0.0, 0.0), (1.0, 0.0), (2.0, 2.0), (3.0, 3.0)],
        [(1.0, 1.0), (2.0, 1.0), (3.0, 1.0)],
    ]
    assert len(matched_features(planes, [])) == 0


def test_thinned_matches_are_of_the_points_with_most_sightings() -> None:
    everywhere = [(i, i) for i in range(60)]
    in_two = [(i, i) for i in range(60, 100)]
    pairs = [_pair(0, 1, everywhere + in_two), _pair(1, 2, everywhere), _pair(0, 2, everywhere)]
    found = thinned_matches(pairs, [100, 100, 100], 60)
    assert [pair.matches.tolist() for pair in found] == [[list(match) for match in everywhere]] * 3


def test_a_pair_with_few_matches_keeps_all_of_them() -> None:
    everywhere = [(i, i) for i in range(60)]
    alone = [(i, i) for i in range(60, 100)]
    pairs = [_pair(0, 1, everywhere), _pair(1, 2, everywhere), _pair(2, 3, alone)]
    found = thinned_matches(pairs, [100, 100, 100, 100], 10)
    assert [len(pair.matches) for pair in found] == [60, 60, 40]


def test_pieces_share_points() -> None:
    """Twelve keyframes, each of which sees twelve points together with the next, but for the fifth and sixth."""
    keyframes, tracks = [], []
    for first in range(10):
        if first in (3, 4):
            continue
        for point in range(12):
            keyframes += [first, first + 1, first + 2]
            tracks += [12 * first + point] * 3
    _, numbers = np.unique(tracks, return_inverse=True)
    observations = Observations(np.array(keyframes), numbers, np.zeros((len(keyframes), 2)))
    piece = pieces_of(14, observations)
    assert piece.tolist() == [1, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0, -1, -1]


def test_features_are_numbered_through_all_keyframes() -> None:
    first_feature = np.array([0, 3, 5, 9])
    links, label = linked_features(first_feature, [_pair(0, 1, [(2, 0)]), _pair(1, 2, [(0, 3), (1, 1)])])
    assert links.tolist() == [[2, 3], [3, 8], [4, 6]]
    assert label[2] == label[3] == label[8]
    assert label[4] == label[6]
    assert len(np.unique(label)) == 6
    links, label = linked_features(first_feature, [])
    assert links.shape == (0, 2)
    assert len(np.unique(label)) == 9


def test_no_sightings_are_of_no_points() -> None:
    nothing = Observations.none()
    assert nothing.points == len(nothing) == 0
    assert len(nothing.thinned(3)) == len(nothing.joined(nothing)) == 0
    some = Observations(np.arange(3), np.zeros(3, np.int64), np.zeros((3, 2)))
    assert nothing.joined(some).tracks.tolist() == [0, 0, 0]
    assert some.joined(some).tracks.tolist() == [0, 0, 0, 1, 1, 1]
    assert pieces_of(2, nothing).tolist() == [-1, -1]


@pytest.mark.parametrize(
    ("together", "count", "pieces"), [(9, 4, [-1] * 4), (10, 4, [0] * 4), (10, 2, [-1] * 2), (10, 3, [0] * 3)]
)
def test_a_piece_is_three_keyframes_that_see_ten_points_each_together(
    together: int, count: int, pieces: list[int]
) -> None:
    keyframes, tracks = (one.ravel() for one in np.meshgrid(np.arange(count), np.arange(together)))
    assert pieces_of(count, Observations(keyframes, tracks, np.zeros((len(tracks), 2)))).tolist() == pieces


def test_corners_lie_where_all_rows_were_read_at_once() -> None:
    class Late:
        def pixels_at_once(self, frame: int, pixels: FloatArray) -> FloatArray:
            return np.add(pixels, [10.0 * frame, 1.0])

    pixels = np.array([in_pixels(cloud(40), one) for one in arc(5, 0.4)])
    flow = followed(np.arange(5.0), (640, 480), pixels, np.ones((5, 40), np.bool_))
    plain, _ = followed_corners(flow, np.arange(5), CAMERA, None, None)
    late, _ = followed_corners(flow, np.arange(5), CAMERA, None, Late())  # type: ignore[arg-type]
    shift = np.column_stack([10.0 * plain.keyframes, np.ones(len(plain))])
    np.testing.assert_allclose(late.pixels, plain.pixels + shift)


def test_a_corner_that_comes_into_view_later_is_followed_from_there() -> None:
    pixels = np.array([in_pixels(cloud(60), one) for one in arc(8, 0.4)])
    seen = np.ones((8, 60), np.bool_)
    seen[:3, 9] = False
    seen[4:, 11] = False
    found, _ = followed_corners(followed(np.arange(8.0), (640, 480), pixels, seen), np.arange(8), CAMERA, None, None)
    for number, expected in ((9, [3, 4, 5, 6, 7]), (11, [0, 1, 2, 3]), (20, list(range(8)))):
        here = np.isin(found.pixels, pixels[:, number]).all(axis=1)
        assert len(np.unique(found.tracks[here])) == 1
        assert np.sort(found.keyframes[here]).tolist() == expected


@pytest.mark.parametrize(("fewest", "points"), [(3, 1), (2, 2)])
def test_points_that_two_pictures_show_count_where_that_is_enough(fewest: int, points: int) -> None:
    places = [np.arange(4.0).reshape(2, 2)] * 3
    pairs = [_pair(0, 1, [(0, 0), (1, 1)]), _pair(1, 2, [(0, 0)])]
    found = matched_features(places, pairs, fewest)
    assert found.points == points
    assert found.thinned(5).points == points
