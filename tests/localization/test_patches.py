"""Orientation and size of what is matched: what they say of a match and of a pose."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rholoc.features import FeatureSet
from rholoc.geometry import FloatArray, patch_appearance
from rholoc.localization import Localizer, Query
from rholoc.localization.index.matches import Matches
from rholoc.localization.pose.patch_evidence import (
    patch_agreement,
    patch_log_odds,
    size_log_odds,
    turn_log_odds,
)
from rholoc.maps import Map

VIEW = 20


@pytest.fixture(scope="module")
def patched(room_map: Map, point_room: Any) -> Map:
    """The room's map with the true patch of every landmark but the first."""
    apart = np.linalg.norm(room_map.landmarks.positions[:, None].astype(float) - point_room.points, axis=2)
    patches = point_room.patches[apart.argmin(axis=1)].astype(np.float32)
    patches[0] = np.nan
    return replace(room_map, landmarks=replace(room_map.landmarks, patches=patches))


def seen_from_view(map_: Map, point_room: Any) -> tuple[FeatureSet, Matches]:
    """All that a view saw, as it saw it, each matched with its landmark."""
    first, last = map_.view_offsets[VIEW : VIEW + 2]
    rows = map_.observations.features[first:last].astype(np.int64)
    T, camera = map_.views.T_map_camera[VIEW], point_room.camera
    landmarks = map_.landmarks.positions[rows].astype(np.float64)
    angles, sizes_px = patch_appearance(camera, T, landmarks, map_.landmarks.known_patches[rows])
    pixels = camera.project((landmarks - T[:3, 3]) @ T[:3, :3]).astype(np.float32)
    nothing = np.zeros((len(rows), 32), np.uint8)
    features = FeatureSet(pixels, nothing[:, 0], nothing, sizes_px.astype(np.float32), angles.astype(np.float32))
    return features, Matches(np.arange(len(rows)), rows, np.full(len(rows), 0.5))


def test_what_is_as_foretold_is_likelier_true_and_what_is_not_false() -> None:
    turned = turn_log_odds(np.deg2rad([0.0, 5.0, 20.0, 60.0, 180.0, 361.0, np.nan]))
    assert (np.diff(turned[:5]) < 0).all()
    assert turned[0] == pytest.approx(np.log(0.9 * 2 / np.deg2rad(8) + 0.1))
    assert turned[2] > 0 > turned[3] > np.log(0.1)
    assert turned[5] == pytest.approx(float(turn_log_odds(np.deg2rad([1.0]))[0]))
    assert np.isnan(turned[6])
    grown = size_log_odds(np.array([0.0, 0.3, 1.0, -1.0, 9.0, 2.5, np.nan, np.inf]))
    assert grown[0] > grown[1] > 0 > grown[2] == grown[3] > np.log(0.1)
    assert grown[4] == grown[5] < 0
    assert (grown[6:] == 0).all()


@given(st.floats(-20.0, 20.0), st.floats(-3.0, 3.0))
def test_odds_are_even_to_the_left_and_right_and_whole_turns_change_nothing(turned_rad: float, octaves: float) -> None:
    one, other, round_ = turn_log_odds(np.array([turned_rad, -turned_rad, turned_rad + 4 * np.pi]))
    assert one == pytest.approx(other)
    assert one == pytest.approx(round_)
    larger, smaller = size_log_odds(np.array([octaves, -octaves]))
    assert larger == pytest.approx(smaller)


def test_few_matches_say_less_and_unknown_ones_nothing() -> None:
    assert patch_agreement(np.full(3, 2.0)) == pytest.approx(1.0)
    assert patch_agreement(np.array([2.0, np.nan, 2.0, 2.0])) == pytest.approx(1.0)
    assert patch_agreement(np.full(3000, 2.0)) == pytest.approx(2.0, abs=0.01)
    assert patch_agreement(np.full(3, -1.0)) == pytest.approx(-0.5)
    assert np.isnan(patch_agreement(np.array([np.nan])))


def test_matches_of_a_pose_are_told_from_shuffled_ones(patched: Map, room_map: Map, point_room: Any) -> None:
    features, matches = seen_from_view(patched, point_room)
    T, camera = patched.views.T_map_camera[VIEW], point_room.camera

    def log_odds(map_: Map, landmarks: FloatArray) -> FloatArray:
        return patch_log_odds(map_, features, camera, T, matches.detections, landmarks)

    right = log_odds(patched, matches.landmarks)
    shuffled = log_odds(patched, np.roll(matches.landmarks, 7))
    assert (np.isnan(right) == (matches.landmarks == 0)).all()
    assert np.nanmin(right) > 3
    assert np.nanmean(shuffled) < 0
    assert np.isnan(log_odds(room_map, matches.landmarks)).all()


def test_a_pose_that_is_right_is_borne_out_by_its_patches_and_one_that_they_contradict_is_none(
    patched: Map, room_map: Map, point_room: Any
) -> None:
    (truth,) = point_room.walk(1, sideways_m=0.1)
    seen = point_room.see(truth, 11, 0.5)
    angles = np.random.default_rng(1).uniform(-np.pi, np.pi, len(seen)).astype(np.float32)

    def agreement(map_: Map, features: FeatureSet) -> float:
        """How well patches agree with the pose found."""
        found = Localizer(map_).candidate(Query(features, point_room.camera))
        return found[0].support.patches

    assert agreement(patched, seen) > 2
    assert np.isnan(agreement(room_map, seen))
    assert np.isnan(agreement(patched, replace(seen, angles=angles * np.nan)))
    shuffled = Query(replace(seen, angles=angles), point_room.camera)
    assert Localizer(patched).candidate(shuffled) is None  # chance would not turn true matches so
    assert Localizer(room_map).candidate(shuffled) is not None
