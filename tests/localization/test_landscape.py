"""Densities over pixels, positions and headings: what they are where they are known."""

from typing import Any

import numpy as np
import pytest

from rholoc.geometry import Pose, angles_between, pose_distances, pose_matrix
from rholoc.localization import Localizer
from rholoc.localization.pose.rematching import evidence_of
from rholoc.localization.similar_views import likeliest_views
from rholoc.maps import Map
from rholoc.paper.density_localizer import TOLERANCES_PX, DensityLocalizer
from rholoc.paper.landscape import (
    Grid,
    Look,
    landscape_around,
    over_headings,
    over_picture,
    over_positions,
    presence_of,
    product_over_positions,
    seen_from,
)

_TOLERANCE_PX = 60.0


@pytest.fixture(scope="module")
def look(room_map: Map) -> Look:
    """A feature in a view that saw it, well within the picture."""
    for row in range(len(room_map.observations.views)):
        found = Look.of_view(room_map, int(room_map.observations.features[row]), int(room_map.observations.views[row]))
        if abs(found.pixel[0] - 320) < 120 and abs(found.pixel[1] - 240) < 80:
            return found
    raise AssertionError("no such feature")


def _away_m(map_: Map, look: Look) -> float:
    return float(np.linalg.norm(map_.landmarks.positions[look.feature] - look.T_map_camera[:3, 3]))


def test_a_look_is_at_the_landmarks_pixel(room_map: Map, look: Look) -> None:
    inside = (room_map.landmarks.positions[look.feature] - look.T_map_camera[:3, 3]) @ look.T_map_camera[:3, :3]
    ray = look.camera.rays(look.pixel[None])[0]
    np.testing.assert_allclose(ray, inside / np.linalg.norm(inside), atol=1e-9)


def test_a_grid_reaches_as_far_as_asked_and_holds_its_centre() -> None:
    grid = Grid.about(np.array([1.0, 2.0, 3.0]), (0.2, 0.1, 0.0), 0.1)
    assert grid.shape == (5, 3, 1)
    x, y, z = grid.axes
    np.testing.assert_allclose(x, [0.8, 0.9, 1.0, 1.1, 1.2])
    np.testing.assert_allclose(y, [1.9, 2.0, 2.1])
    np.testing.assert_allclose(z, [3.0])
    np.testing.assert_allclose(grid.points[[0, 1, 5]], [[0.8, 1.9, 3.0], [0.9, 1.9, 3.0], [0.8, 2.0, 3.0]])
    folded = grid.folded(grid.points[:, 0])
    assert folded.shape == (1, 3, 5)
    np.testing.assert_allclose(folded[0, 2], x)
    np.testing.assert_allclose(grid.points[7], [1.0, 2.0, 3.0])


def test_over_the_picture_it_falls_with_the_square_of_the_pixels(room_map: Map, look: Look) -> None:
    density, pixels = over_picture(room_map, look, _TOLERANCE_PX, 20.0)
    assert density.shape == (24, 32)
    np.testing.assert_allclose(pixels[2, 3], [60.0, 40.0])
    camera, seen = look.camera, look.camera.rays(look.pixel[None])[0]
    apart = np.sin(angles_between(camera.rays(pixels.reshape(-1, 2)), seen)).reshape(density.shape)
    expected = np.maximum(1 - (apart * camera.focal / _TOLERANCE_PX) ** 2, 0)
    np.testing.assert_allclose(density, expected, atol=0.03)
    assert density.max() > 0.9


def test_over_positions_it_falls_across_the_ray_and_not_along_it(room_map: Map, look: Look) -> None:
    here = look.T_map_camera[:3, 3]
    bearing = look.T_map_camera[:3, :3] @ look.camera.rays(look.pixel[None])[0]
    density = over_positions(room_map, look, Grid.about(here, (0.2, 0.2, 0.2), 0.1), _TOLERANCE_PX)
    assert density.shape == (5, 5, 5)
    assert density[2, 2, 2] == pytest.approx(1.0, abs=1e-3)
    for (z, y, x), rho in np.ndenumerate(density):
        step = 0.1 * np.array([x - 2, y - 2, z - 2])
        along = step @ bearing
        tolerance_m = _TOLERANCE_PX / look.camera.focal * (_away_m(room_map, look) - along)
        expected = max(1 - (step @ step - along**2) / tolerance_m**2, 0)
        assert rho == pytest.approx(expected, abs=0.02)


def test_over_headings_it_falls_with_the_angle(room_map: Map, look: Look) -> None:
    half_rad = 0.15
    density, up, aside = over_headings(room_map, look, half_rad, 5, _TOLERANCE_PX)
    np.testing.assert_allclose(up, np.linspace(-half_rad, half_rad, 5))
    np.testing.assert_allclose(aside, up)
    assert density[2, 2] == pytest.approx(1.0, abs=1e-3)
    pose = Pose(look.T_map_camera)
    azimuth, elevation = np.arctan2(pose.heading[1], pose.heading[0]), np.arcsin(pose.heading[2])
    away = room_map.landmarks.positions[look.feature] - pose.position
    ray = look.camera.rays(look.pixel[None])[0]
    for (i, j), rho in np.ndenumerate(density):
        e, a = elevation + up[i], azimuth + aside[j]
        heading = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
        turned = Pose.from_heading(pose.position, heading, pose.roll).R_map_camera @ ray
        off = np.sin(angles_between(turned, away / np.linalg.norm(away)))
        assert rho == pytest.approx(max(1 - (off * look.camera.focal / _TOLERANCE_PX) ** 2, 0), abs=0.05)


def test_the_product_of_a_frame_peaks_where_it_was_taken(localizer: Localizer, point_room: Any) -> None:
    truth = point_room.walk(9)[4]
    features = point_room.see(truth, 77)
    index = localizer.index
    matches = index.match_everywhere(features)
    evidence = evidence_of(index, matches, point_room.camera.rays(features.pixels), point_room.camera)
    grid = Grid.about(truth.position, (0.3, 0.3, 0.0), 0.1)
    nats = product_over_positions(index.map, evidence, truth.T_map_camera, grid, 12.0)
    assert np.unravel_index(nats.argmax(), nats.shape) == (0, 3, 3)
    assert nats.max() > 5 * max(nats[0, 0, 0], nats[0, -1, -1])


def test_a_feature_may_be_seen_from_its_views_and_not_from_behind(room_map: Map, look: Look) -> None:
    here, landmark = look.T_map_camera[:3, 3], room_map.landmarks.positions[look.feature].astype(np.float64)
    assert seen_from(room_map, look.feature, Grid.about(here, (0.1, 0.1, 0.0), 0.1)).all()
    behind = landmark + 2 * (landmark - here)
    assert not seen_from(room_map, look.feature, Grid.about(behind, (0.1, 0.1, 0.0), 0.1)).any()


def test_headings_are_turned_about_the_cameras_place(room_map: Map, look: Look) -> None:
    """A camera that looks steeply down sees a point straight ahead; turned by a and tilted by e, it sees it aside."""
    landmark = room_map.landmarks.positions[look.feature].astype(np.float64)
    for elevation, azimuth in ((-0.9, 2.0), (0.6, -2.5)):
        away = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
        pose = Pose.from_heading(landmark - 3.0 * away, away, 0.3)
        centre = np.array([look.camera.cx, look.camera.cy])
        ahead = Look(look.feature, look.camera, pose.T_map_camera, centre)
        density, up, aside = over_headings(room_map, ahead, 0.12, 7, _TOLERANCE_PX)
        e, a = elevation + up[:, None], azimuth + aside
        turned = np.stack(np.broadcast_arrays(np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)), axis=-1)
        off_px = look.camera.focal * np.tan(angles_between(turned, away))
        np.testing.assert_allclose(density, np.maximum(1 - (off_px / _TOLERANCE_PX) ** 2, 0), atol=0.03)
    assert density.max() > 0.99


def test_a_camera_is_not_tilted_beyond_straight_up(room_map: Map, look: Look) -> None:
    steep = Pose.from_heading(np.zeros(3), np.array([np.cos(1.5), 0.0, np.sin(1.5)]))
    above = Look(look.feature, look.camera, steep.T_map_camera, look.pixel)
    density, up, _ = over_headings(room_map, above, 0.2, 5, 4000.0)
    beyond = 1.5 + up > 1.55
    assert beyond.sum() == 2
    np.testing.assert_allclose(density[beyond], np.tile(density[beyond][:1], (2, 1)))
    assert not np.allclose(density[0], density[2])


def test_a_square_holds_the_ways_that_end_near_a_place() -> None:
    centre = np.array([1.0, 2.0, 1.5])

    def half_m(*ways: list[tuple[float, float, float]]) -> float:
        grid = Grid.around_ways(centre, [centre + np.array(way) for way in ways], 16)
        assert grid.shape == (33, 33, 1)
        np.testing.assert_allclose(grid.points.mean(axis=0), centre)
        return float(np.ptp(grid.axes[0])) / 2

    assert half_m() == pytest.approx(0.4)
    assert half_m([(0.1, -0.2, 7.0), (0.0, 0.0, 0.0)]) == pytest.approx(0.4)
    assert half_m([(0.1, -1.0, 7.0), (0.0, 0.0, 0.4)]) == pytest.approx(1.2)
    assert half_m([(9.0, 0.1, 0.0), (0.1, 0.0, 0.0)]) == pytest.approx(3.0)
    assert half_m([(2.0, 0.0, 0.0), (0.51, 0.0, 0.0)]) == pytest.approx(0.4)  # ends elsewhere
    assert half_m([(0.5, 0, 0), (0, 0, 0)], [(0.0, 0.8, 0), (0.49, 0, 0)]) == pytest.approx(0.96)


def test_a_landscape_is_about_the_pose_at_its_height(localizer: Localizer, room_map: Map, point_room: Any) -> None:
    truth = point_room.walk(40, sideways_m=0.1)[20]
    features = point_room.see(truth, 7)
    by_densities = DensityLocalizer(room_map, 2, localizer.index)
    checks: list[None] = []
    around = landscape_around(by_densities, features, point_room.camera, None, lambda: checks.append(None))
    assert len(around.ascents) == 2
    assert around.ascents[0].optimum.value <= around.ascents[1].optimum.value
    assert len(checks) == 2 + around.values.size
    assert around.values.shape == (33, 33)
    np.testing.assert_array_equal(around.T_map_camera, around.ascents[-1].optimum.T_map_camera)
    y, x = np.unravel_index(around.values.argmax(), around.values.shape)
    peak = np.array([around.grid.axes[0][x], around.grid.axes[1][y]])
    assert np.abs(peak - truth.position[:2]).max() < 1.5 * around.grid.spacing_m
    assert around.values.max() == pytest.approx(around.values[16, 16], rel=0.2)
    np.testing.assert_allclose(around.grid.points.mean(axis=0), around.T_map_camera[:3, 3])
    evidence = around.ascents[-1].evidence
    expected = product_over_positions(room_map, evidence, around.T_map_camera, around.grid, 12.0)[0]
    np.testing.assert_allclose(around.values, expected)
    beside = Pose(pose_matrix(truth.R_map_camera, truth.position + np.array([0.2, 0.0, 0.0])))
    there = landscape_around(by_densities, features, point_room.camera, beside.T_map_camera)
    np.testing.assert_array_equal(there.T_map_camera, beside.T_map_camera)
    assert landscape_around(by_densities, features.take(np.arange(5)), point_room.camera, None) is None


def test_presence_is_of_the_views_that_saw_the_feature(room_map: Map, look: Look) -> None:
    views = room_map.observations.views[room_map.observations.features == look.feature]
    away = room_map.views.positions[views] - room_map.landmarks.positions[look.feature].astype(np.float64)
    distance = np.linalg.norm(away, axis=1)
    presence = presence_of(room_map, look.feature)
    nearest, farthest = presence.reach
    assert (nearest[0], farthest[0]) == pytest.approx((distance.min() / 2, distance.max() * 2))
    mean = (away / distance[:, None]).mean(axis=0)
    np.testing.assert_allclose(presence.direction[0], mean / np.linalg.norm(mean))


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
