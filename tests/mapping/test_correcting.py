"""A map corrected by hand: answers move by exactly the transform that the map reports, and what is cut is gone."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rholoc.errors import Conflict, InvalidInput
from rholoc.geometry import UP, Similarity, angles_between, pose_distances
from rholoc.geometry.earth import EarthPlace, enu_of, place_at
from rholoc.localization import Dof, Localizer, Query
from rholoc.mapping.build.density_fitting import fit_densities
from rholoc.mapping.build.pipeline import _earth, _in_one_frame
from rholoc.mapping.build.stored_observations import with_landmarks
from rholoc.mapping.edit.correcting import (
    lay_over_plan,
    remove_region,
    remove_views,
    set_distance,
    set_names,
    set_north,
    set_origin,
    set_up,
    set_wall,
)
from rholoc.mapping.edit.cutting import in_region
from rholoc.mapping.edit.moving import move_map
from rholoc.mapping.edit.sources import forget_recording
from rholoc.mapping.learn.merging import merge_maps
from rholoc.maps import DensityKind, MapNames, NamedArea, NamedPoint, map_to_bytes, without_memory
from rholoc.maps.formats.rho_file import info_from_json, info_to_json
from rholoc.recordings import Recording, Waypoint
from rholoc.reports import LearningReport, MapReport, QueriesReport

SQUARE = ((0.0, 0.0), (2.0, 0.0), (2.0, 2.0), (0.0, 2.0))


@pytest.fixture(scope="module")
def walk(point_room):
    return point_room.walk(40)


@pytest.fixture(scope="module")
def room(point_room, walk):
    named = MapNames((NamedPoint("door", (1.0, 2.0, 0.5)),), (NamedArea("hall", SQUARE),))
    map_ = point_room.map_of(walk, "walk")
    return replace(map_, info=replace(map_.info, names=named))


def answers(map_, point_room, walk):
    localizer = Localizer(map_)
    seen = [point_room.see(walk[k], 1000 + k) for k in (3, 17, 31)]
    found = [localizer.localize(Query(features, point_room.camera, Dof.FREE)) for features in seen]
    assert all(one.pose is not None for one in found)
    return np.array([one.pose.T_map_camera for one in found]), np.array([one.covariance for one in found])


def reported(map_):
    done = map_.info.corrections[-1]
    return Similarity(done.scale, np.array(done.rotation), np.array(done.translation))


CORRECTIONS = {
    "origin": lambda map_: set_origin(map_, np.array([1.5, -0.5, 0.2])),
    "north": lambda map_: set_north(map_, np.array([1.0, 0.3, 0.1])),
    "wall": lambda map_: set_wall(map_, np.array([-1.0, 0.3, 0.0])),
    "up": lambda map_: set_up(map_, np.array([0.1, -0.05, 1.0])),
    "scale": lambda map_: set_distance(map_, np.array([0.0, 0.0, 0.0]), np.array([0.0, 2.0, 0.0]), 2.5),
    "plan": lambda map_: lay_over_plan(
        map_, np.array([[0.0, 0, 1], [2.0, 0, 0]]), np.array([[5.0, 5.0], [5.0, 8.0]]), scaled=True
    ),
}


@pytest.mark.parametrize("kind", CORRECTIONS)
def test_answers_move_by_exactly_the_transform_that_is_reported(kind, room, point_room, walk):
    corrected = CORRECTIONS[kind](room)
    assert corrected.info.corrections[-1].kind == kind
    assert (corrected.info.version, corrected.info.id) == (room.info.version + 1, room.info.id)
    similarity = reported(corrected)
    before, spread = answers(room, point_room, walk)
    after, spread_after = answers(corrected, point_room, walk)
    metres, radians = pose_distances(similarity.poses(before), after)
    assert metres.max() < 2e-5 * similarity.scale
    assert radians.max() < 2e-5
    patches = similarity.scale * room.landmarks.patches @ similarity.rotation.T
    metres_off = np.linalg.norm(corrected.landmarks.patches - patches, axis=1)
    assert (metres_off < 0.06 * np.linalg.norm(patches, axis=1)).all()  # rounded as files keep them
    J = np.kron(np.diag([similarity.scale, 1.0]), similarity.rotation)
    np.testing.assert_allclose(spread_after, J @ spread @ J.T, rtol=0.02, atol=1e-9)
    np.testing.assert_allclose(
        corrected.info.names.points[0].position, similarity.points(np.array([[1.0, 2.0, 0.5]]))[0], atol=1e-9
    )
    map_to_bytes(corrected)  # is valid
    assert info_from_json(info_to_json(corrected.info)).corrections == corrected.info.corrections


def test_each_correction_does_what_it_is_called(room):
    assert np.allclose(reported(CORRECTIONS["origin"](room)).points(np.array([[1.5, -0.5, 0.2]])), 0)
    turned = reported(CORRECTIONS["north"](room)).rotation @ [1.0, 0.3, 0.1]
    np.testing.assert_allclose(turned, [0, np.hypot(1, 0.3), 0.1], atol=1e-12)
    turned = reported(CORRECTIONS["wall"](room)).rotation @ [-1.0, 0.3, 0]
    np.testing.assert_allclose(turned, [np.hypot(1, 0.3), 0, 0], atol=1e-12)
    turned = reported(CORRECTIONS["up"](room)).rotation @ [0.1, -0.05, 1.0]
    assert turned[2] == pytest.approx(np.linalg.norm(turned))
    laid = reported(CORRECTIONS["plan"](room))
    np.testing.assert_allclose(laid.points(np.array([[0.0, 0, 0], [2.0, 0, 0]]))[:, :2], [[5, 5], [5, 8]], atol=1e-12)
    assert laid.scale == pytest.approx(1.5)
    assert set_up(room, np.array([0.0, 0.0, -1.0])).info.upright


def test_a_second_reconstruction_moves_with_the_map(room):
    second = room.views.positions.astype(np.float32)
    checked = replace(room, views=replace(room.views, second_positions=second))
    moved = move_map(checked, Similarity(2.0, Rotation.from_euler("z", 1.0).as_matrix(), np.array([3.0, 4.0, 5.0])))
    np.testing.assert_allclose(moved.views.second_positions, moved.views.positions, atol=1e-4)
    assert move_map(room, Similarity(2.0, np.eye(3), np.zeros(3))).views.second_positions is None


def test_a_version_has_its_own_time(room):
    named = set_names(replace(room, info=replace(room.info, created="2020-01-01T00:00:00+00:00")), MapNames())
    assert named.info.created == named.info.corrections[-1].created > "2020-01-01"


def test_a_plan_of_another_scale_is_missed_and_says_so(room):
    laid = lay_over_plan(room, np.array([[0.0, 0, 0], [2.0, 0, 0]]), np.array([[0.0, 0], [2.2, 0]]), scaled=False)
    assert laid.info.corrections[-1].residual_m == pytest.approx(0.1)
    assert reported(laid).scale == 1.0


def test_a_tilted_map_is_levelled_by_its_views(room):
    tilt = Similarity(1.0, Rotation.from_euler("xy", [40, 25], degrees=True).as_matrix(), np.zeros(3))
    tilted = move_map(room, tilt)
    tilted = replace(tilted, info=replace(tilted.info, upright=False))
    with pytest.raises(Conflict, match="upright"):
        set_north(tilted, np.array([1.0, 0, 0]))
    level = set_up(tilted)
    assert level.info.upright
    up = (reported(level).rotation @ tilt.rotation)[2]
    assert np.degrees(angles_between(up, UP)) < 3
    set_north(level, np.array([1.0, 0, 0]))


def test_lengths_in_the_report_follow_the_scale_and_the_map_is_metric(room):
    loose = replace(room, info=replace(room.info, metric=False))
    longer = CORRECTIONS["scale"](loose)
    assert longer.info.metric
    assert longer.info.report.landmark_sigma_median_m == pytest.approx(
        1.25 * set_origin(loose, np.zeros(3)).info.report.landmark_sigma_median_m, rel=1e-3
    )
    assert longer.info.report.coverage is not None


def test_errors_of_queries_in_the_report_follow_the_scale(room):
    queries = QueriesReport(9, 8, 2, 3, 0, 4, 0.5, 0.75, 0.02, None)
    learned = (LearningReport(2), LearningReport(3, queries=queries))
    longer = CORRECTIONS["scale"](replace(room, info=replace(room.info, report=MapReport(learned=learned))))
    scaled = replace(queries, median_before_m=pytest.approx(0.025))
    assert longer.info.report.learned == (LearningReport(2), LearningReport(3, queries=scaled))


@pytest.mark.parametrize("kind", ["wall", "up", "plan"])
def test_learning_goes_on_in_the_new_frame(kind, room):
    corrected = CORRECTIONS[kind](room)
    anew = with_landmarks(corrected)
    np.testing.assert_allclose(anew.landmarks.positions, corrected.landmarks.positions, atol=1e-4)


def test_measured_ranges_follow_the_scale(room):
    seen = room.observations
    away = room.landmarks.positions[seen.features] - room.views.positions[seen.views]
    ranged = replace(room, observations=replace(seen, ranges_m=np.linalg.norm(away, axis=1).astype(np.float32)))
    corrected = CORRECTIONS["scale"](with_landmarks(ranged))
    anew = with_landmarks(corrected)
    np.testing.assert_allclose(anew.landmarks.positions, corrected.landmarks.positions, atol=1e-3)


@pytest.mark.slow
def test_a_corrected_map_merges_and_forgets(point_room):
    walk = point_room.walk(80)
    west, east = point_room.map_of(walk[:45:2], "w"), point_room.map_of(walk[25:65:3], "e")
    moved = set_origin(set_wall(west, np.array([0.5, 1.0, 0.0])), np.array([1.0, 1.0, 0.0]))
    both = merge_maps(moved, east)
    assert len(both.info.corrections) == 2
    left = forget_recording(both, "e")
    np.testing.assert_allclose(left.landmarks.positions, moved.landmarks.positions, atol=1e-4)


def test_tensor_densities_move_with_the_map(room, point_room, walk):
    few = remove_region(room, np.array([[-9.0, -9], [9, -9], [9, -2.4], [-9, -2.4]]), None, None, keep_inside=True)
    tensor = fit_densities(few, DensityKind.TENSOR)
    for kind in ("origin", "plan"):
        moved = CORRECTIONS[kind](tensor)
        assert moved.info.density is DensityKind.TENSOR
        refitted = fit_densities(moved, DensityKind.TENSOR).densities
        np.testing.assert_allclose(refitted.places, moved.densities.places, atol=1e-4)
        off = np.abs(refitted.coefficients - moved.densities.coefficients)
        assert off.max() < 1e-3 * np.abs(refitted.coefficients).max()


def test_a_region_is_deleted_or_kept(room):
    outline = np.array([[-9.0, -9], [9, -9], [9, 0], [-9, 0]])
    south = in_region(room.landmarks.positions, outline)
    deleted = remove_region(room, outline, None, None, keep_inside=False)
    kept = remove_region(room, outline, None, None, keep_inside=True)
    np.testing.assert_array_equal(deleted.landmarks.positions, room.landmarks.positions[~south])
    np.testing.assert_array_equal(kept.landmarks.positions, room.landmarks.positions[south])
    assert deleted.info.corrections[-1].landmarks_removed == south.sum()
    assert kept.info.report.features == south.sum()
    low = remove_region(room, outline, None, 1.0, keep_inside=False)
    assert len(low) == len(room) - (south & (room.landmarks.positions[:, 2] <= 1.0)).sum()


def test_a_piece_of_the_walk_is_removed_as_if_it_had_never_been_walked(room, point_room, walk):
    cut = remove_views(room, 10, 39)
    assert cut.info.corrections[-1].views_removed == 30
    assert len(cut.views) == 10 == cut.info.sources[0].views
    assert len(cut) < len(room)
    np.testing.assert_allclose(with_landmarks(cut).landmarks.positions, cut.landmarks.positions, atol=1e-6)
    forgetful = without_memory(room)
    assert len(remove_views(forgetful, 10, 39).views.times) == 10


def test_what_makes_no_sense_is_refused(room):
    zero, x = np.zeros(3), np.array([1.0, 0, 0])
    with pytest.raises(InvalidInput, match="straight up"):
        set_north(room, np.array([0.0, 0, 1]))
    with pytest.raises(InvalidInput, match="nowhere"):
        set_up(room, zero)
    with pytest.raises(InvalidInput, match="two points are the same"):
        set_distance(room, x, x, 1.0)
    with pytest.raises(InvalidInput, match="stretched"):
        set_distance(room, zero, x, 1e9)
    with pytest.raises(InvalidInput, match="10 km"):
        set_origin(room, np.array([1e5, 0, 0]))
    with pytest.raises(InvalidInput, match="pairs"):
        lay_over_plan(room, zero[None], np.zeros((1, 2)), scaled=False)
    with pytest.raises(InvalidInput, match="on one vertical line"):
        lay_over_plan(room, np.array([zero, [0, 0, 1]]), np.array([[0.0, 0], [1, 0]]), scaled=True)
    with pytest.raises(InvalidInput, match="encloses nothing"):
        remove_region(room, np.array([[0.0, 0], [1, 1], [2, 2]]), None, None, keep_inside=True)
    with pytest.raises(Conflict, match="no landmark"):
        remove_region(room, np.array([[50.0, 50], [51, 50], [51, 51]]), None, None, keep_inside=False)
    with pytest.raises(Conflict, match="would be left"):
        remove_region(room, np.array([[50.0, 50], [51, 50], [51, 51]]), None, None, keep_inside=True)
    with pytest.raises(InvalidInput, match="views 0 to 39"):
        remove_views(room, 5, 40)
    with pytest.raises(Conflict, match="No view"):
        remove_views(room, 0, 39)
    twice = MapNames((NamedPoint("a", (0, 0, 0)), NamedPoint("a", (1, 0, 0))))
    with pytest.raises(InvalidInput, match="named a"):
        set_names(room, twice)
    with pytest.raises(InvalidInput, match="not a valid name"):
        set_names(room, MapNames((NamedPoint(" ", (0, 0, 0)),)))


ORIGIN = EarthPlace(52.52, 13.405, 74.0)
POINTS = np.array([[0.0, 0.0, 1.5], [4.0, 1.0, 1.5], [6.0, 5.0, 1.4]])


def waypoints(points, origin=ORIGIN):
    """As the reader makes them: metres around the first one."""
    places = [place_at(point, origin) for point in points]
    return tuple(
        Waypoint(f"W{number}", float(number), tuple(enu_of(place, places[0])), earth=place)
        for number, place in enumerate(places)
    )


def recording(points):
    return Recording(None, "walk", Path("walk"), waypoints=waypoints(points))


def test_recordings_with_other_first_waypoints_share_a_frame():
    first, second = _in_one_frame([recording(POINTS), recording(POINTS[::-1])])
    for one, other in zip(first.waypoints, second.waypoints[::-1], strict=True):
        assert one.position == pytest.approx(other.position, abs=1e-6)
    assert first.waypoints[0].position == pytest.approx((0, 0, 0), abs=1e-6)


def test_waypoints_in_metres_stay_as_they_are():
    plain = recording(POINTS)
    plain = replace(plain, waypoints=tuple(replace(one, earth=None) for one in plain.waypoints))
    assert _in_one_frame([plain])[0].waypoints == plain.waypoints
    assert _earth(plain.waypoints) is None
    assert _earth(()) is None


def test_the_maps_frame_is_east_north_up_at_the_first_waypoint():
    found = _earth(_in_one_frame([recording(POINTS)])[0].waypoints)
    first = place_at(POINTS[0], ORIGIN)
    assert np.linalg.norm(enu_of(found.origin, first)) < 1e-3
    assert (found.heading_deg + 180) % 360 - 180 == pytest.approx(0, abs=1e-3)
