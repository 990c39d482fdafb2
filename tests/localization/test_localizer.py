"""The localizer, in a room of points."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rholoc.errors import InvalidDescriptors
from rholoc.features import FeatureSet
from rholoc.geometry import Pose, angles_between, pose_distances, pose_matrix
from rholoc.localization import Cause, Dof, Localizer, Prior, Query, Reason
from rholoc.localization.index.matches import Matches
from rholoc.localization.pose.seeds import place_of_prior
from rholoc.localization.search import SearchOptions
from rholoc.maps import Map


def _off(answer: Any, truth: Pose) -> tuple[float, float]:
    assert answer.pose is not None, answer.reason
    angle = Rotation.from_matrix(answer.pose.R_map_camera.T @ truth.R_map_camera).magnitude()
    return float(np.linalg.norm(answer.pose.position - truth.position)), float(np.degrees(angle))


@pytest.mark.parametrize("dof", list(Dof))
def test_frames_between_the_views_are_localized(localizer: Localizer, point_room: Any, dof: Dof) -> None:
    for seed, truth in enumerate(point_room.walk(12, sideways_m=0.12)[::2]):
        answer = localizer.localize(Query(point_room.see(truth, 1000 + seed), point_room.camera, dof))
        distance, angle = _off(answer, truth)
        assert distance < 0.03
        assert angle < 0.5
        assert answer.recognized > 0.9  # a wall straight ahead leaves the distance as open as the focal length
        assert answer.inliers == len(answer.inlier_pixels) == len(answer.inlier_features)


def test_a_little_roll_does_not_shift_an_upright_answer(localizer: Localizer, point_room: Any) -> None:
    held = point_room.walk(7)[3]
    truth = Pose.from_heading(held.position, held.heading, roll=np.deg2rad(1.5))
    answer = localizer.localize(Query(point_room.see(truth, 5), point_room.camera, Dof.UPRIGHT))
    assert _off(answer, truth)[0] < 0.02
    assert answer.pose.roll == pytest.approx(0, abs=1e-9)


def test_a_rolled_camera_is_found_with_six_degrees_of_freedom(localizer: Localizer, point_room: Any) -> None:
    upright = point_room.walk(7)[3]
    truth = Pose.from_heading(upright.position, upright.heading, roll=0.5)
    answer = localizer.localize(Query(point_room.see(truth, 5), point_room.camera, Dof.FREE))
    assert _off(answer, truth)[0] < 0.03
    assert answer.pose.roll == pytest.approx(0.5, abs=0.01)


def test_more_features_are_asked_for_only_where_few_do_not_suffice(localizer: Localizer, point_room: Any) -> None:
    options = SearchOptions(settled_sigma_m=0.1)  # the room of points is known no better
    localizer = Localizer(localizer.map, options=options, index=localizer.index)
    truth, asked = point_room.walk(5)[2], []
    every = point_room.see(truth, 3)

    def more() -> FeatureSet:
        asked.append(True)
        return every

    sure = localizer.localize(Query(every, point_room.camera, more_features=more))
    assert sure.localized
    assert not asked
    few = every.take(np.arange(7))
    assert not localizer.localize(Query(few, point_room.camera)).localized
    answer = localizer.localize(Query(few, point_room.camera, more_features=more))
    assert asked == [True]
    assert "extract" in answer.timings_ms
    expected = localizer.localize(Query(every, point_room.camera)).pose
    np.testing.assert_array_equal(answer.pose.T_map_camera, expected.T_map_camera)


def test_a_sample_is_spread_over_all_features(point_room: Any) -> None:
    features = point_room.see(point_room.walk(5)[2], 3)
    few, many = features.take(np.arange(300) % len(features)), features.take(np.arange(1000) % len(features))
    np.testing.assert_array_equal(few.sample, np.arange(300))
    assert len(np.unique(many.sample)) == len(many.sample) < 400
    assert np.diff(many.sample).max() <= 5
    assert (many.sample[0], many.sample[-1]) == (0, 999)


def test_the_same_query_gives_the_same_answer(localizer: Localizer, point_room: Any) -> None:
    query = Query(point_room.see(point_room.walk(5)[2], 3), point_room.camera)
    first, second = localizer.localize(query), localizer.localize(query)
    np.testing.assert_array_equal(first.pose.T_map_camera, second.pose.T_map_camera)


def test_no_more_matches_agree_than_there_are(localizer: Localizer, point_room: Any) -> None:
    """Some of the features find the place; those that agree are counted among all of them."""
    truth = point_room.walk(5)[2]
    seen = point_room.see(truth, 3)
    looked_at = len(seen) // 4
    seen.__dict__["sample"] = np.arange(0, len(seen), 4)
    answer = localizer.localize(Query(seen, point_room.camera, Dof.FREE, more_features=lambda: seen))
    assert looked_at < answer.inliers <= answer.matches


def test_errors_are_consistent_with_the_covariance(localizer: Localizer, point_room: Any) -> None:
    inside = []
    for seed, truth in enumerate(point_room.walk(20, sideways_m=0.1)):
        answer = localizer.localize(Query(point_room.see(truth, 2000 + seed), point_room.camera, Dof.FREE))
        error = answer.pose.position - truth.position
        inside.append(error @ np.linalg.solve(answer.covariance[:3, :3], error) < 7.81)
    assert np.mean(inside) >= 0.85


def test_a_prior_is_used_and_kept_to(localizer: Localizer, point_room: Any) -> None:
    truth = point_room.walk(9)[4]
    features = point_room.see(truth, 8)
    near = Pose(pose_matrix(truth.R_map_camera, truth.position + np.array([0.05, -0.04, 0.02])))
    answer = localizer.localize(Query(features, point_room.camera, prior=Prior(near, 0.5, 0.3)))
    assert _off(answer, truth)[0] < 0.03
    assert answer.near_prior


@pytest.mark.parametrize("turned_deg", [0, 90])
def test_a_wrong_prior_is_recovered_from(localizer: Localizer, point_room: Any, turned_deg: float) -> None:
    truth = point_room.walk(9)[4]
    turn = Rotation.from_euler("z", turned_deg, degrees=True).as_matrix()
    far = Pose(pose_matrix(turn @ truth.R_map_camera, truth.position + np.array([5.0, 0.0, 0.0])))
    answer = localizer.localize(Query(point_room.see(truth, 8), point_room.camera, prior=Prior(far, 0.5, 0.3)))
    assert _off(answer, truth)[0] < 0.03
    assert answer.near_prior is False


def test_a_prior_of_another_heading_was_not_met(localizer: Localizer, point_room: Any) -> None:
    truth = point_room.walk(9)[4]
    features = point_room.see(truth, 8)
    turn = Rotation.from_euler("z", 60, degrees=True).as_matrix()
    turned = Pose(pose_matrix(turn @ truth.R_map_camera, truth.position))
    for radius_deg, met in ((45, False), (75, True)):
        prior = Prior(turned, 0.5, math.radians(radius_deg))
        answer = localizer.localize(Query(features, point_room.camera, prior=prior))
        assert _off(answer, truth)[0] < 0.03
        assert answer.near_prior is met


def test_a_priors_place_is_seen_by_views_that_look_its_way(localizer: Localizer, point_room: Any) -> None:
    index, truth = localizer.index, point_room.walk(9)[4]
    place = place_of_prior(index, Prior(truth, 4.0, 0.1), views_each=60)
    turned = angles_between(index.view_headings, truth.heading)
    alike = np.flatnonzero(turned < 0.1 + np.deg2rad(30))
    assert 0 < len(alike) < len(turned)
    np.testing.assert_array_equal(place.landmarks, np.unique(index.visibility[alike].indices))
    upwards = Pose.from_heading(truth.position, np.array([0.01, 0.0, 1.0]))
    assert place_of_prior(index, Prior(upwards, 4.0, 0.1), views_each=60) is None


@pytest.mark.parametrize("turned_deg", [1.5, 10.0, 20.0])
def test_near_a_prior_the_whole_map_is_not_searched(
    localizer: Localizer, point_room: Any, turned_deg: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    truth = point_room.walk(9)[4]
    turn = Rotation.from_euler("z", turned_deg, degrees=True).as_matrix()
    prior = Prior(Pose(pose_matrix(turn @ truth.R_map_camera, truth.position)), 0.5, 0.6)
    monkeypatch.setattr(localizer.index, "nearest_everywhere", None)
    answer = localizer.localize(Query(point_room.see(truth, 8), point_room.camera, prior=prior))
    assert _off(answer, truth)[0] < 0.03


def test_where_few_features_are_left_a_close_prior_finds_the_pose(localizer: Localizer, point_room: Any) -> None:
    """Matched without an idea of where, so few of them do not tell which place it is."""
    truth = point_room.walk(9)[4]
    features = point_room.see(truth, 8)
    some = features.take(np.arange(0, len(features), len(features) // 12))
    near = Prior(Pose(pose_matrix(truth.R_map_camera, truth.position + np.array([0.01, 0.0, 0.01]))), 0.5, 0.3)
    index = localizer.index
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(index, "match_within", lambda *_, **__: Matches.none())
        found = localizer.candidate(Query(some, point_room.camera, prior=near))
    assert pose_distances(found[0].optimum.T_map_camera, truth.T_map_camera)[0] < 0.05


def test_a_roll_that_only_the_request_forbids_is_named(localizer: Localizer, point_room: Any) -> None:
    held = point_room.walk(7)[3]
    rolled = point_room.see(Pose.from_heading(held.position, held.heading, roll=0.5), 5)
    answer = localizer.localize(Query(rolled, point_room.camera, Dof.UPRIGHT))
    assert not answer.localized
    assert answer.diagnosis.cause is Cause.ROLLED
    assert "29°" in answer.diagnosis.message


def test_a_camera_that_rolls_in_an_upright_map_needs_no_option(localizer: Localizer, point_room: Any) -> None:
    held = point_room.walk(7)[3]
    for roll in (0.0, 0.1, 0.5, -2.0):
        truth = Pose.from_heading(held.position, held.heading, roll=roll)
        answer = localizer.localize(Query(point_room.see(truth, 5), point_room.camera))
        assert _off(answer, truth)[0] < 0.02, roll


def test_gravity_that_contradicts_forbids_an_answer(localizer: Localizer, point_room: Any) -> None:
    truth = point_room.walk(9)[4]
    features, down = point_room.see(truth, 8), truth.R_map_camera.T @ np.array([0, 0, -1.0])
    agreed = localizer.localize(Query(features, point_room.camera, Dof.FREE, gravity=down))
    assert _off(agreed, truth)[0] < 0.03
    contradicted = localizer.localize(Query(features, point_room.camera, Dof.FREE, gravity=-down))
    assert not contradicted.localized
    assert contradicted.diagnosis.cause is Cause.WRONG_GRAVITY


def test_another_room_is_refused(localizer: Localizer, point_room: Any) -> None:
    rng = np.random.default_rng(99)
    for _ in range(20):
        n = 400
        features = FeatureSet(
            rng.uniform((0, 0), (640, 480), (n, 2)).astype(np.float32),
            np.zeros(n, np.uint8),
            rng.integers(0, 256, (n, 32), dtype=np.uint8),
            np.zeros(n, np.float32),
            np.zeros(n, np.float32),
        )
        answer = localizer.localize(Query(features, point_room.camera, Dof.FREE))
        assert not answer.localized
        assert answer.pose is None
        assert answer.reason is not None
        assert answer.diagnosis.cause is Cause.UNKNOWN_PLACE


def test_nothing_to_see_is_an_answer(localizer: Localizer, point_room: Any) -> None:
    answer = localizer.localize(Query(FeatureSet.empty(32), point_room.camera))
    assert answer.reason is Reason.NO_FEATURES
    assert answer.diagnosis.cause is Cause.TOO_LITTLE_TEXTURE


def test_a_deadline_that_has_passed_is_an_answer(localizer: Localizer, point_room: Any) -> None:
    features = point_room.see(point_room.walk(5)[2], 3)
    answer = localizer.localize(Query(features, point_room.camera, deadline_s=0.0))
    assert answer.reason is Reason.DEADLINE
    assert answer.diagnosis.cause is Cause.TOO_LITTLE_TIME


def test_descriptors_of_another_kind_are_refused(localizer: Localizer, point_room: Any) -> None:
    with pytest.raises(InvalidDescriptors, match="128 bytes"):
        localizer.localize(Query(FeatureSet.empty(128), point_room.camera))


@pytest.mark.parametrize(
    ("roll_deg", "upright", "dof", "keeps_gravity"),
    [(1.0, True, Dof.AUTO, True), (8.0, True, Dof.FREE, True), (1.0, False, Dof.FREE, False)],
)
def test_a_query_is_freed_of_what_means_nothing_in_a_map(
    room_map: Map, point_room: Any, roll_deg: float, upright: bool, dof: Dof, keeps_gravity: bool
) -> None:
    poses = [Pose.from_heading(np.zeros(3), np.array([1.0, 0.0, 0.0]), np.deg2rad(roll_deg)).T_map_camera] * 60
    map_ = replace(
        room_map,
        info=replace(room_map.info, upright=upright),
        views=replace(room_map.views, T_map_camera=np.array(poses)),
    )
    features = point_room.see(point_room.walk(9)[4], 0)
    query = Query(features, point_room.camera, Dof.AUTO, gravity=np.array([0.0, 1.0, 0.0]))
    adapted = Localizer(map_).adapted(query)
    assert adapted.dof is dof
    assert (adapted.gravity is not None) == keeps_gravity
    assert Localizer(map_).adapted(replace(query, dof=Dof.UPRIGHT)).dof is Dof.UPRIGHT
