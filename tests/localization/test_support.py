"""What a picture says for a pose, cell by cell."""

from dataclasses import astuple, replace
from typing import Any

import numpy as np
import pytest

from rholoc.density import Evidence
from rholoc.features import FeatureSet
from rholoc.geometry import Pose
from rholoc.localization import Dof, Localizer, Query
from rholoc.localization.index.matches import Matches
from rholoc.localization.pose.ascent import Optimum
from rholoc.localization.pose.pose_evidence import Support, support_of
from rholoc.maps import Map


def features_at(pixels: np.ndarray) -> FeatureSet:
    """Features of nothing in particular."""
    count = len(pixels)
    nothing = np.zeros(count, dtype=np.float32)
    return FeatureSet(pixels, np.zeros(count, np.uint8), np.zeros((count, 32), np.uint8), nothing, nothing)


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
    found = supported(localizer, point_room, 5, 0.0)
    np.testing.assert_equal(astuple(found), astuple(Support(0.0, 0.0)))


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


def test_colours_are_those_of_the_picture_and_of_the_landmarks_that_agree(point_room: Any, room_map: Map) -> None:
    rng = np.random.default_rng(5)
    coloured = replace(
        room_map,
        landmarks=replace(room_map.landmarks, colours=rng.integers(0, 255, (len(room_map), 3), dtype=np.uint8)),
    )
    seen = point_room.see(Pose(room_map.views.T_map_camera[20]), 3, 1.0)
    query = Query(seen, point_room.camera, Dof.FREE)
    plain, verified = (Localizer(one).candidate(query) for one in (room_map, coloured))
    assert np.isnan(plain[0].support.colours)
    assert np.isnan(verified[0].support.colours)  # of the picture nothing is known
    right = np.full((len(seen), 3), 7, dtype=np.uint8)
    right[verified[0].matches.detections] = coloured.landmarks.colours[verified[0].matches.landmarks]
    for colours, least, most in ((right, 0.9, 1.0), (rng.permutation(right), -0.3, 0.3)):
        found = Localizer(coloured).candidate(replace(query, features=replace(seen, colours=colours)))
        assert least < found[0].support.colours < most
