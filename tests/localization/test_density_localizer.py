"""The paper's localizer: frames found by their densities alone, from the places that matches vote for."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from rholoc.geometry import pose_distances
from rholoc.localization import Localizer
from rholoc.localization.similar_views import likeliest_views
from rholoc.maps import Map
from rholoc.paper.density_localizer import TOLERANCES_PX, DensityLocalizer


@pytest.fixture(scope="module")
def by_densities(room_map: Map) -> DensityLocalizer:
    return DensityLocalizer(room_map, 2)


@pytest.mark.parametrize("at", [3, 20, 33])
def test_it_climbs_to_where_the_frame_was_taken(by_densities: DensityLocalizer, point_room: Any, at: int) -> None:
    truth = point_room.walk(40, sideways_m=0.1)[at]
    features = point_room.see(truth, 500 + at)
    every = list(by_densities.ascents(features, point_room.camera))
    assert len(every) == 2
    best = by_densities.localize(features, point_room.camera)
    assert best is not None
    assert best.optimum.value == max(one.optimum.value for one in every)
    apart_m, turned_rad = pose_distances(best.optimum.T_map_camera, truth.T_map_camera)
    assert apart_m < 0.03
    assert turned_rad < np.deg2rad(1.0)
    assert best.inliers == (best.optimum.density > 0).sum() >= 50
    np.testing.assert_array_equal(best.steps[-1].T_map_camera, best.optimum.T_map_camera)
    assert best.steps[-1].tolerance_px == TOLERANCES_PX[-1]
    starts = [by_densities.map.views.T_map_camera[view] for view in range(60)]
    assert any(np.array_equal(best.steps[0].T_map_camera, T) for T in starts)


def test_from_a_start_it_climbs_once(by_densities: DensityLocalizer, point_room: Any) -> None:
    truth = point_room.walk(40, sideways_m=0.1)[20]
    features = point_room.see(truth, 7)
    (only,) = by_densities.ascents(features, point_room.camera, start=truth.T_map_camera)
    np.testing.assert_array_equal(only.steps[0].T_map_camera, truth.T_map_camera)
    assert pose_distances(only.optimum.T_map_camera, truth.T_map_camera)[0] < 0.03


def test_too_few_matches_give_nothing(by_densities: DensityLocalizer, point_room: Any) -> None:
    few = point_room.see(point_room.walk(9)[4], 0).take(np.arange(5))
    assert by_densities.localize(few, point_room.camera) is None


def test_the_likeliest_views_are_those_beside_the_frame(localizer: Localizer, point_room: Any) -> None:
    map_ = localizer.map
    features = point_room.see(point_room.walk(60)[25], 900)
    found = likeliest_views(localizer, features, 4)
    assert len(found) == 4
    assert found[0].score > 0
    assert [one.score for one in found] == sorted((one.score for one in found), reverse=True)
    assert all(abs(one.view - 25) <= 4 for one in found)
    for one in found:
        np.testing.assert_array_equal(one.pose.T_map_camera, map_.views.T_map_camera[one.view])
    assert likeliest_views(localizer, features.take(np.zeros(0, np.int64)), 4) == []


def test_six_matches_are_climbed_by_and_five_are_not(by_densities: DensityLocalizer, point_room: Any) -> None:
    seen = point_room.see(point_room.walk(9)[4], 0)
    matched = by_densities.index.match_everywhere(seen).detections
    for count, ascents in ((5, 0), (6, 2)):
        assert len(list(by_densities.ascents(seen.take(matched[:count]), point_room.camera))) == ascents
