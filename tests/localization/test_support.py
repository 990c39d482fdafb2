"""What a picture says for a pose, cell by cell."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rholoc.density import Evidence
from rholoc.features import FeatureSet
from rholoc.geometry import Camera, Pose
from rholoc.localization import Dof, Localizer, Query
from rholoc.localization.index.matches import Matches
from rholoc.localization.pose.ascent import Optimum
from rholoc.localization.pose.pose_evidence import Support, _beyond_chance, _Grid, support_of
from rholoc.maps import Map

WIDE = Camera(640, 360, 500.0, 500.0, 319.5, 179.5)


def features_at(pixels: np.ndarray) -> FeatureSet:
    """Features of nothing in particular."""
    count = len(pixels)
    nothing = np.zeros(count, dtype=np.float32)
    return FeatureSet(pixels, np.zeros(count, np.uint8), np.zeros((count, 32), np.uint8), nothing, nothing)


def test_cells_are_square_and_pixels_beyond_the_picture_count_in_its_outermost() -> None:
    grid = _Grid.of(WIDE)
    assert (grid.size_px, grid.rows) == (80.0, 5)
    assert _Grid.of(Camera(360, 640, 500.0, 500.0, 179.5, 319.5)).rows == 8
    pixels = np.array([[0.0, 0.0], [79.9, 79.9], [80.0, 0.0], [639.0, 359.0], [-5.0, 900.0]])
    cells = grid.sums(pixels)
    assert cells.shape == (40,)
    assert {cell: cells[cell] for cell in np.flatnonzero(cells)} == {0: 2, 1: 1, 39: 1, 32: 1}
    assert grid.sums(pixels, np.array([1.0, 2.0, 4.0, 8.0, 16.0]))[[0, 1, 39, 32]].tolist() == [3, 4, 8, 16]


def supported(localizer: Localizer, point_room: Any, chosen: int, density: float, by_chance: float = 0.0) -> Support:
    """The support of a view's own pose by so many matches, whose density there is as given, in one cell."""
    index = localizer.index
    landmarks = index.visibility[[20]].indices[:chosen].astype(np.int64)
    count, camera = len(landmarks), point_room.camera
    pixels = np.full((count, 2), 100.0)
    found = Matches(np.arange(count), landmarks, np.full(count, 0.5))
    rays = np.tile([0.0, 0.0, 1.0], (count, 1))
    evidence = Evidence.of(landmarks, rays, index.landmarks[landmarks], np.zeros((count, 3, 3)), found.chances, 500.0)
    optimum = Optimum(index.map.views.T_map_camera[20], 1.0, np.full(count, density))
    query = Query(features_at(pixels), camera)
    return support_of(index, query, found, evidence, optimum, np.full(count, by_chance), Matches.none())


def test_without_matches_that_agree_nothing_speaks_for_a_pose(localizer: Localizer, point_room: Any) -> None:
    assert supported(localizer, point_room, 5, 0.0) == Support(0.0, 0.0)


def test_a_cell_says_the_odds_of_its_matches_less_those_by_chance_and_ten_nats_at_most(
    localizer: Localizer, point_room: Any
) -> None:
    one = np.log1p(1.0 / 0.1)
    assert supported(localizer, point_room, 3, 1.0).seen == pytest.approx(3 * one)
    assert supported(localizer, point_room, 3, 1.0, by_chance=0.5).seen == pytest.approx(3 * (one - 0.75))
    assert supported(localizer, point_room, 3, 0.01, by_chance=1.0).seen == 0.0
    assert supported(localizer, point_room, 40, 1.0).seen == 10.0


def test_what_is_net_is_what_was_seen_less_what_was_missing() -> None:
    assert Support(12.0, 5.0).net == 7.0


def _cell(pixel: np.ndarray) -> int:
    """The number of a pixel's cell, of eight across a picture 640 wide."""
    return int(pixel[1] // 80) * 8 + int(pixel[0] // 80)


@pytest.mark.parametrize(("share", "crowd"), [(1.0, 3), (0.5, 3), (0.5, 2), (1.0, 0)])
def test_what_should_be_in_a_cell_and_is_not_counts_where_something_else_is(
    localizer: Localizer, point_room: Any, monkeypatch: pytest.MonkeyPatch, share: float, crowd: int
) -> None:
    """Matches in the left part of a picture, ``crowd`` features of other things in each cell of the right."""
    index, camera, T = localizer.index, point_room.camera, localizer.map.views.T_map_camera[20]
    seen = index.visibility[[20]].indices.astype(np.int64)
    where = camera.project((index.landmarks[seen] - T[:3, 3]) @ T[:3, :3])
    left = np.flatnonzero((where[:, 0] < 320) & camera.contains(where))
    chosen = left[: int(share * len(left))]
    others = [(80 * i + 40.0, 80 * j + 40.0) for i in range(4, 8) for j in range(6)] * crowd
    pixels = np.concatenate([where[chosen], np.array(others).reshape(-1, 2)])
    count = len(chosen)
    found = Matches(np.arange(count), seen[chosen], np.full(count, 0.5))
    rays = np.tile([0.0, 0.0, 1.0], (count, 1))
    landmarks = index.landmarks[seen[chosen]]
    evidence = Evidence.of(seen[chosen], rays, landmarks, np.zeros((count, 3, 3)), found.chances, 500.0)
    by_chance = np.zeros(len(pixels))
    seen_alike = index.seen_alike
    asked: list[int] = []
    monkeypatch.setattr(index, "seen_alike", lambda rows, views: (asked.append(views), seen_alike(rows, views))[1])
    optimum = Optimum(T, 1.0, np.ones(count))
    support = support_of(index, Query(features_at(pixels), camera), found, evidence, optimum, by_chance, found)

    assert asked == [10]
    shared = np.array([np.isin(index.visibility[[view]].indices, seen[chosen]).sum() for view in range(60)])
    alike = np.argsort(-shared, kind="stable")[:10]
    expected, matched, detected = np.zeros(48), np.zeros(48), np.zeros(48)
    for landmark in np.unique(index.visibility[alike].indices):
        pixel = camera.project(((index.landmarks[landmark] - T[:3, 3]) @ T[:3, :3])[None])
        if index.present(T[:3, 3])[landmark] and camera.contains(pixel)[0]:
            expected[_cell(pixel[0])] += 1
            matched[_cell(pixel[0])] += landmark in seen[chosen]
    for pixel in pixels:
        detected[_cell(pixel)] += 1
    rate = min(matched.sum() / expected[matched > 0].sum(), 0.9)
    empty = (matched == 0) & (expected >= 2) & (detected >= 3)
    missing = sum(min(-np.log(1 - rate) * expected[cell], 10.0) for cell in np.flatnonzero(empty))
    assert support.missing == pytest.approx(missing)
    assert (missing > 20) == (crowd == 3)
    assert support.found == matched.sum()
    assert support.expected == min(expected.sum(), len(pixels))
    assert support.beyond_chance == pytest.approx(count * np.log(count / 0.15) - (count - 0.15))
    assert np.isnan(support.colours)


def test_matches_close_to_their_landmarks_count_by_how_improbable_they_are_by_chance(
    localizer: Localizer, point_room: Any
) -> None:
    """Ten matches within four pixels of where they should be, 45 in the ring from there to fourteen pixels."""
    index, camera, T = localizer.index, point_room.camera, localizer.map.views.T_map_camera[20]
    landmarks = np.resize(index.visibility[[20]].indices.astype(np.int64), 60)
    off_px = np.array([3.9] * 10 + [4.1] * 20 + [13.9] * 25 + [14.1] * 5)
    pixels = camera.project((index.landmarks[landmarks] - T[:3, 3]) @ T[:3, :3]) + np.outer(off_px, (0.6, 0.8))

    def nats(count: float, by_chance: float) -> float:
        return count * np.log(count / by_chance) - (count - by_chance)

    wide = Matches(np.arange(60), landmarks, np.full(60, 0.5))
    assert _beyond_chance(index, pixels, camera, wide, T) == pytest.approx(nats(10, 0.15 + 45 * 16 / 180))
    assert _beyond_chance(index, pixels, camera, wide.take(np.arange(10, 60)), T) == 0.0
    assert _beyond_chance(index, pixels, camera, Matches.none(), T) == 0.0
    chances = np.where((np.arange(60) < 10) & (np.arange(60) % 2 == 0), 0.9, 0.5)  # five of the close ones are alike
    wide = Matches(np.arange(60), landmarks, chances)
    assert _beyond_chance(index, pixels, camera, wide, T) == pytest.approx(nats(5, 0.15))


def test_colours_are_those_of_the_picture_and_of_the_landmarks_that_agree(point_room: Any, room_map: Map) -> None:
    rng = np.random.default_rng(5)
    coloured = replace(
        room_map,
        landmarks=replace(room_map.landmarks, colours=rng.integers(0, 255, (len(room_map), 3), dtype=np.uint8)),
    )
    seen = point_room.see(Pose(room_map.views.T_map_camera[20]), 3, 1.0)
    query = Query(seen, point_room.camera, Dof.FREE)
    plain, verified = (Localizer(one).candidate(query) for one in (room_map, coloured))
    assert plain is not None
    assert verified is not None
    assert np.isnan(plain[0].support.colours)
    assert np.isnan(verified[0].support.colours)  # of the picture nothing is known
    right = np.full((len(seen), 3), 7, dtype=np.uint8)
    right[verified[0].matches.detections] = coloured.landmarks.colours[verified[0].matches.landmarks]
    for colours, least, most in ((right, 0.9, 1.0), (rng.permutation(right), -0.3, 0.3)):
        found = Localizer(coloured).candidate(replace(query, features=replace(seen, colours=colours)))
        assert found is not None
        assert least < found[0].support.colours < most
