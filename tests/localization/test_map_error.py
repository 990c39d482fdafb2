"""The map's own uncertainty in an answer: against samples, and in maps that are displaced by as much as they say."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import gammainc

from rholoc.geometry import Pose
from rholoc.localization import Alternative, Belief, Cause, Localization, Localizer, Query, Reason
from rholoc.localization.belief.map_uncertainty import with_map_error
from rholoc.localization.index.map_error import (
    PLACE_M,
    PLACE_RAD,
    RIGHT_M,
    RIGHT_RAD,
    carried_covariances,
    map_covariance_at,
    probability_right,
    rms_position_error,
    widening_factor,
    worst_sigma,
)
from rholoc.localization.index.map_index import MapIndex
from rholoc.mapping.build.view_covariance import storable_covariances
from rholoc.maps import Map
from rholoc.reports import MapReport, TrajectoryReport


def covariance(sigma_m: float, seed: int) -> np.ndarray:
    A = np.random.default_rng(seed).normal(size=(6, 6)) / np.sqrt(6)
    A[3:] /= 3
    return sigma_m**2 * A @ A.T


@pytest.mark.parametrize("sigma_m", [0.02, 0.05, 0.1])
@pytest.mark.parametrize("seed", range(2))
def test_the_probability_is_the_share_of_samples(sigma_m: float, seed: int) -> None:
    spread = covariance(sigma_m, seed)
    errors = np.random.default_rng(1).multivariate_normal(np.zeros(6), spread, 100_000)
    right = (np.linalg.norm(errors[:, :3], axis=1) < RIGHT_M) & (np.linalg.norm(errors[:, 3:], axis=1) < RIGHT_RAD)
    assert probability_right(spread) == pytest.approx(right.mean(), abs=0.012)


def chi(degrees: int, bound: float) -> float:
    """The χ distribution's share below ``bound``."""
    return float(gammainc(degrees / 2, bound**2 / 2))


def test_the_bounds_are_ten_centimetres_and_five_degrees() -> None:
    """Against the χ distribution with three degrees of freedom, where one of the two bounds alone counts."""
    for share in (0.3, 1.0, 3.0):
        expected = chi(3, 1 / share)
        place, heading = (0.1 * share) ** 2, (np.deg2rad(5) * share) ** 2
        for spread in ([place] * 3 + [1e-12] * 3, [1e-12] * 3 + [heading] * 3):
            assert probability_right(np.diag(spread)) == pytest.approx(expected, abs=0.01)
    along = chi(1, 1.0)
    assert probability_right(np.diag([0.01, 0, 0, 0, 0, 0])) == pytest.approx(along, abs=0.02)
    assert probability_right(np.zeros((6, 6))) == pytest.approx(1)
    wider = np.diag([0.04] * 3 + [1e-12] * 3)
    assert probability_right(wider, within_m=0.2) == pytest.approx(chi(3, 1.0), abs=0.01)
    turned = np.diag([1e-12] * 3 + [0.04] * 3)
    assert probability_right(turned, within_rad=0.2) == pytest.approx(chi(3, 1.0), abs=0.01)
    assert rms_position_error(np.diag([1.0, 4.0, 4.0, 9.0, 9.0, 9.0])) == 3.0
    lost = widening_factor(np.diag([0.01] * 3 + [1e-12] * 3), np.diag([0.03] * 3 + [0.0] * 3))
    assert lost == pytest.approx(chi(3, 0.5) / chi(3, 1.0), abs=0.01)
    assert widening_factor(1e30 * np.eye(6), np.eye(6)) == 1.0  # where nothing is left to lose


def test_a_covariance_is_carried_by_the_motions_derivative() -> None:
    rng = np.random.default_rng(8)
    positions, to = rng.normal(size=(5, 3)), rng.normal(size=3)
    spreads = np.array([covariance(0.02, seed) for seed in range(5)])
    carried = carried_covariances(spreads, positions, to)
    assert carried.shape == (5, 6, 6)
    for x, spread, found in zip(positions, spreads, carried, strict=True):
        J = np.eye(6)
        J[:3, 3:] = np.column_stack([np.cross(axis, to - x) for axis in np.eye(3)])
        np.testing.assert_allclose(found, J @ spread @ J.T, atol=1e-12)
    weights = np.array([1.0, 0.0, 2.0, 3.0, 4.0])
    expected = (weights[:, None, None] * carried).sum(axis=0) / 10
    np.testing.assert_allclose(map_covariance_at(spreads, positions, weights, to), expected)


def test_an_uncertain_map_lowers_the_probability_and_an_exact_one_does_not() -> None:
    local = covariance(0.01, 0)
    assert widening_factor(local, np.zeros((6, 6))) == pytest.approx(1)
    lowered = [widening_factor(local, covariance(sigma_m, 1)) for sigma_m in (0.01, 0.05, 0.1, 0.3)]
    assert lowered == sorted(lowered, reverse=True)
    assert lowered[0] > 0.99
    assert lowered[-1] < 0.2


def test_a_covariance_is_carried_as_its_samples_are() -> None:
    spread = covariance(0.02, 2)
    here, there = np.array([1.0, -2.0, 1.5]), np.array([2.0, 0.5, 1.0])
    motions = np.random.default_rng(3).multivariate_normal(np.zeros(6), spread, 50_000)
    turned = Rotation.from_rotvec(motions[:, 3:]).apply(there - here) + here + motions[:, :3] - there
    carried = carried_covariances(spread[None], here[None], there)[0]
    np.testing.assert_allclose(carried[:3, :3], np.cov(turned.T), atol=0.05 * np.trace(carried[:3, :3]))
    np.testing.assert_allclose(carried[3:, 3:], spread[3:, 3:])


def test_views_that_do_not_know_are_left_out() -> None:
    spreads = np.stack([covariance(0.02, 4), np.full((6, 6), np.nan), covariance(0.02, 4)])
    at = np.zeros((3, 3))
    found = map_covariance_at(spreads, at, np.array([1.0, 5.0, 2.0]), np.zeros(3))
    np.testing.assert_allclose(found, spreads[0])
    assert map_covariance_at(spreads, at, np.array([0.0, 1.0, 0.0]), np.zeros(3)) is None


def displaced(map_: Map, spread: np.ndarray) -> Map:
    """The map, which as a whole may be moved by what has this covariance (6, 6) at the origin."""
    at_views = [carried_covariances(spread[None], np.zeros((1, 3)), x)[0] for x in map_.views.positions]
    report = MapReport(trajectories=(TrajectoryReport("given", trusted=True),))
    return replace(
        map_,
        info=replace(map_.info, report=report),
        views=replace(map_.views, covariances=storable_covariances(np.array(at_views))),
    )


@pytest.mark.parametrize("sigma_m", [0.03, 0.1])
def test_answers_know_that_the_map_may_be_displaced(room_map: Map, point_room: Any, sigma_m: float) -> None:
    """The map is off by a rigid motion: of the true poses 95 % lie in the ellipsoids, confidences are shares."""
    spread = covariance(sigma_m, 5)
    spread[3:, 3:] /= 10
    spread[:3, 3:] = spread[3:, :3] = 0
    localizer = Localizer(displaced(room_map, spread), min_recognized=0.0)
    rng = np.random.default_rng(8)
    inside, right, confidences = [], [], []
    for seed, pose in enumerate(point_room.into_corners()):
        answer = localizer.localize(Query(point_room.see(pose, 100 + seed), point_room.camera))
        assert answer.covariance is not None
        assert answer.map_trusted is True
        for motion in rng.multivariate_normal(np.zeros(6), spread, 200):
            truth = Rotation.from_rotvec(motion[3:]).apply(pose.position) + motion[:3]
            off = answer.pose.position - truth
            inside.append(off @ np.linalg.solve(answer.covariance[:3, :3], off) <= 7.815)
            right.append(np.linalg.norm(off) <= RIGHT_M)
            confidences.append(answer.confidence)
        carried = carried_covariances(spread[None], np.zeros((1, 3)), answer.pose.position)[0]
        assert answer.expected_error_m == pytest.approx(np.sqrt(np.trace(carried[:3, :3])), rel=0.01)
    assert 0.9 <= np.mean(inside) <= 0.99
    assert np.mean(confidences) == pytest.approx(np.mean(right), abs=0.11)  # of a frame's own error they are careful


def test_an_answer_in_an_untrusted_map_is_less_sure(room_map: Map, point_room: Any) -> None:
    pose = point_room.walk(7)[3]
    query = Query(point_room.see(pose, 5), point_room.camera)
    answers = []
    for trusted in (True, False):
        report = MapReport(trajectories=(TrajectoryReport("given", trusted=trusted, why="Measured."),))
        map_ = replace(room_map, info=replace(room_map.info, report=report))
        answers.append(Localizer(map_, min_recognized=0.9).localize(query))
    assert all(answer.localized for answer in answers)
    assert [answer.map_trusted for answer in answers] == [True, False]
    assert answers[1].confidence < 0.9 < answers[0].confidence
    assert answers[1].recognized == answers[0].recognized  # the place is the same, however bent the map is
    assert answers[0].expected_error_m is None


def test_the_maps_error_is_added_to_a_sixteenth_of_the_frames_own(localizer: Localizer) -> None:
    map_ = localizer.map
    of_views = np.array([np.diag([(1e-3 * (1 + view)) ** 2] * 3 + [0.0] * 3) for view in range(len(map_.views))])
    report = MapReport(trajectories=(TrajectoryReport("given", trusted=False, why="Measured."),))
    info = replace(map_.info, report=report)
    known = MapIndex(replace(map_, info=info, views=replace(map_.views, covariances=of_views.astype(np.float32))))
    features, pose = known.visibility[[20]].indices.astype(np.int64), Pose(map_.views.T_map_camera[20])
    own = covariance(0.02, 7)
    elsewhere = known.visibility[[3]].indices.astype(np.int64)
    other = Alternative(0.05, Pose(map_.views.T_map_camera[3]), 2 * own, elsewhere)
    belief, alternatives = Belief(0.9, 8 / 9), (other,)
    answer = Localization(
        True, None, pose, own, belief, 300, 200, np.zeros((200, 2)), features, alternatives=alternatives
    )

    def error_at(view: int) -> np.ndarray:
        shared = known.shared_with(view)
        ten = np.argsort(-shared, kind="stable")[:10]
        of_map = np.zeros((6, 6))
        of_map[:3, :3] = np.eye(3) * (shared[ten] * (1e-3 * (1 + ten)) ** 2).sum() / shared[ten].sum()
        return of_map

    of_map = error_at(20)
    found = with_map_error(known, answer)
    assert found.covariance is not None
    np.testing.assert_allclose(found.covariance, own / 16 + of_map, rtol=1e-5, atol=1e-12)
    assert found.expected_error_m == pytest.approx(np.sqrt(np.trace(of_map)), rel=1e-5)
    assert found.confidence == pytest.approx(0.8 * 0.8 * widening_factor(own / 16, of_map), rel=1e-5)
    assert found.recognized == pytest.approx(0.9 * widening_factor(own / 16, of_map, PLACE_M, PLACE_RAD), rel=1e-5)
    np.testing.assert_allclose(found.alternatives[0].covariance, own / 8 + error_at(3), rtol=1e-5, atol=1e-12)
    assert found.map_trusted is False
    scaleless = MapIndex(replace(known.map, info=replace(info, metric=False)))
    for index, one in (
        (scaleless, answer),
        (known, replace(answer, pose=None)),
        (known, replace(answer, covariance=None)),
    ):
        less = with_map_error(index, one)
        assert less.covariance is one.covariance
        assert less.confidence == pytest.approx(0.64)
        assert less.expected_error_m is None
    unknown = with_map_error(localizer.index, answer)
    assert unknown.confidence == pytest.approx(0.8)
    assert unknown.covariance is own


def test_no_pose_is_given_where_the_map_may_be_off_by_more_than_a_place_and_that_is_named_as_the_cause(
    room_map: Map, point_room: Any
) -> None:
    query = Query(point_room.see(point_room.walk(7)[3], 5), point_room.camera)
    bent = Localizer(displaced(room_map, covariance(0.2, 5))).localize(query)
    assert bent.localized
    assert bent.confidence < 0.5 < bent.recognized
    answer = Localizer(displaced(room_map, covariance(1.5, 5))).localize(query)
    assert not answer.localized
    assert (answer.reason, answer.pose, answer.diagnosis.cause) == (Reason.NOT_RECOGNIZED, None, Cause.INEXACT_MAP)
    assert answer.confidence <= answer.recognized < 0.5


def test_a_map_that_is_too_inexact_for_the_request_is_refused_before_a_pose_is_given(
    room_map: Map, point_room: Any
) -> None:
    query = Query(point_room.see(point_room.walk(7)[3], 5), point_room.camera)
    localizer = Localizer(displaced(room_map, covariance(0.1, 5)))
    given = localizer.localize(query)
    assert given.covariance is not None
    sigma_m, sigma_rad = (worst_sigma(given.covariance[rows, rows]) for rows in (slice(3), slice(3, 6)))
    assert localizer.localize(replace(query, max_sigma_m=1.01 * sigma_m, max_sigma_rad=1.01 * sigma_rad)).localized
    for asked, option in (({"max_sigma_m": 0.99 * sigma_m}, "m"), ({"max_sigma_rad": 0.99 * sigma_rad}, "deg")):
        answer = localizer.localize(replace(query, **asked))
        assert (answer.localized, answer.pose, answer.covariance) == (False, None, None)
        assert answer.reason is Reason.TOO_INEXACT
        assert answer.recognized == given.recognized
        assert answer.diagnosis.cause is Cause.TOO_INEXACT
        assert f"max_sigma_{option}" in answer.diagnosis.hint
