"""What a search answers with: which candidate, how sure, and what is asked of a seed."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from rholoc.density import Evidence
from rholoc.features import FeatureSet
from rholoc.geometry import FloatArray, Pose
from rholoc.localization import (
    Belief,
    Cause,
    Dof,
    Intrinsics,
    Localizer,
    Prior,
    Query,
    Reason,
)
from rholoc.localization import localizer as module
from rholoc.localization.index.matches import Matches
from rholoc.localization.localizer import (
    SearchOptions,
    _Found,
    _likelier,
    _near_prior,
    _plausible,
    _Search,
    _Stopwatch,
    _true_to_gravity,
)
from rholoc.localization.pose import focal
from rholoc.localization.pose.ascent import Optimum
from rholoc.localization.pose.focal import FocalEstimate
from rholoc.localization.pose.pose_evidence import Support
from rholoc.localization.pose.rematching import (
    FINAL_TOLERANCE_PX,
    SEARCH_RADII_PX,
    Verified,
    matches_about,
    verify,
)
from rholoc.paper.density_localizer import TOLERANCES_PX

HERE = Pose.from_heading(np.array([1.0, 2.0, 1.5]), np.array([0.6, 0.8, 0.0]))


def found(
    recognized: float,
    net: float = 100.0,
    x: float = 0.0,
    near_prior: bool = True,
    exact: float = 1.0,
    focal: float = 1.0,
    value: float = 1.0,
) -> _Found:
    """A candidate ``x`` metres along the map's x axis."""
    T = np.eye(4)
    T[0, 3] = x
    nothing = np.zeros(0, np.int64)
    evidence = Evidence.of(nothing, np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros(0), 500.0)
    optimum = Optimum(T, value, np.zeros(0))
    verified = Verified(optimum, Matches.none(), evidence, np.zeros((0, 2)), Matches.none(), Support(net, 0.0))
    estimate = FocalEstimate(500.0, 1.0, 0.0, focal)
    camera: Any = None
    return _Found(verified, camera, estimate, Belief(recognized, exact), near_prior)


def search(*candidates: _Found, prior: Prior | None = None) -> _Search:
    query: Any = SimpleNamespace(prior=prior)
    begun = _Search(query, _Stopwatch(None))
    for candidate in candidates:
        begun.add(candidate)
    return begun


def test_of_two_candidates_the_better_supported_of_those_that_may_be_given_out_is_likelier() -> None:
    sure, surer, doubtful = found(0.7, 50.0), found(0.51, 80.0, x=5.0), found(0.49, 200.0, x=9.0)
    assert _likelier(None, doubtful) is doubtful
    assert _likelier(sure, surer) is surer is _likelier(surer, sure)
    assert _likelier(sure, doubtful) is sure is _likelier(doubtful, sure)
    same = found(0.9, 50.0)
    assert _likelier(sure, same) is sure  # the first of equals
    begun = search(sure, doubtful, surer)
    assert begun.best is surer
    assert begun.elsewhere is None
    begun.add(None)
    assert begun.found == [sure, doubtful, surer]


def test_in_one_place_the_product_of_densities_decides_and_not_the_support() -> None:
    denser, supported = found(0.9, 50.0, value=120.0), found(0.9, 80.0, x=0.1, value=100.0)
    assert _likelier(supported, denser) is denser is _likelier(denser, supported)


def test_a_search_is_hopeless_once_three_poses_are_hardly_of_the_right_place() -> None:
    options = SearchOptions()
    assert not search().is_hopeless(options)
    assert not search(found(0.01), found(0.001)).is_hopeless(options)
    assert search(found(0.01), found(0.001), found(0.019)).is_hopeless(options)
    assert not search(found(0.01), found(0.021), found(0.001), found(0.0)).is_hopeless(options)


@pytest.mark.parametrize(
    ("best", "elsewhere", "answer"),
    [
        (None, None, None),
        (0.3, None, "best"),
        (0.3, 0.89, "best"),
        (0.3, 0.9, "elsewhere"),
        (0.49, 0.95, "elsewhere"),
        (0.5, 0.95, "best"),
        (None, 0.95, "elsewhere"),
        (None, 0.5, None),
    ],
)
def test_what_contradicts_a_prior_is_given_only_where_it_is_sure_and_the_other_is_not(
    best: float | None, elsewhere: float | None, answer: str | None
) -> None:
    """In places 10 cm apart: the one is no rival of the other."""
    candidates = {
        "best": None if best is None else found(best),
        "elsewhere": None if elsewhere is None else found(elsewhere, x=0.1, near_prior=False),
    }
    outcome = search(*(one for one in candidates.values() if one is not None)).outcome(0.9)
    expected = None if answer is None else candidates[answer]
    assert (outcome and outcome.verified) is (expected and expected.verified)


def test_a_search_is_over_once_a_place_is_recognized_wherever_it_is() -> None:
    assert not search().is_over(0.9)
    assert not search(found(0.89)).is_over(0.9)
    assert not search(found(0.95)).is_over(0.9, max_sigma_m=0.07)  # nothing fixes that pose
    assert search(found(0.9, focal=0.2)).is_over(0.9)
    assert search(found(0.5), found(0.9, near_prior=False, focal=0.2)).is_over(0.9)


def test_only_what_lies_where_a_prior_expects_it_is_as_expected() -> None:
    prior = Prior(Pose(np.eye(4)))
    assert search(found(0.5), prior=prior).is_as_expected(0.5)
    assert search(found(0.5, exact=0.2, focal=0.2), prior=prior).is_as_expected(0.5)
    assert not search(found(0.49), prior=prior).is_as_expected(0.5)
    assert not search(found(0.5)).is_as_expected(0.5)
    assert not search(found(0.8, near_prior=False), prior=prior).is_as_expected(0.5)
    assert not search(prior=prior).is_as_expected(0.5)


@pytest.mark.parametrize(("recognized", "places"), [(0.5, 1), (0.4, 9)])
def test_a_pose_that_may_be_given_out_where_it_was_expected_is_answered_with_without_a_look_elsewhere(
    localizer: Localizer, point_room: Any, monkeypatch: pytest.MonkeyPatch, recognized: float, places: int
) -> None:
    truth = point_room.walk(9)[4]
    query = Query(point_room.see(truth, 8), point_room.camera)
    looked, closely, look, look_closely = [], [], localizer._look, localizer._look_closely
    monkeypatch.setattr(module, "belief_of", lambda *_: Belief(recognized, 1.0))
    monkeypatch.setattr(localizer, "_look", lambda place, *how: (looked.append(place), look(place, *how))[1])
    monkeypatch.setattr(
        localizer, "_look_closely", lambda place, *how: (closely.append(place), look_closely(place, *how))[1]
    )
    localizer._search(query, _Stopwatch(None))
    assert len(looked) == localizer.options.places  # nothing was expected
    looked.clear()
    closely.clear()
    found = localizer._search(replace(query, prior=Prior(truth, 0.5, 0.3)), _Stopwatch(None))
    assert (len(looked), len(closely)) == (places, places)
    assert found.best is not None
    assert found.best.near_prior


def test_a_candidate_is_as_sure_as_it_is_better_than_its_best_rival() -> None:
    best = found(0.95, 100.0)
    lesser, near, nearer = found(0.9, 70.0, x=9.0), found(0.9, 94.0, x=5.0), found(0.9, 99.0, x=0.1)
    alone = search(best, nearer).outcome(0.9)
    assert alone is not None
    assert (alone.verified, alone.belief) == (best.verified, best.belief)  # what is beside it is the same place
    contested = search(best, lesser, near, nearer).outcome(0.9)
    assert contested is not None
    assert contested.verified is best.verified
    of_near, of_lesser = 0.9 * np.exp(-0.5), 0.9 * np.exp(-2.5)
    whole = 0.95 + of_near + of_lesser
    assert contested.recognized == pytest.approx(0.95 * 0.95 / whole)
    assert [weight for weight, _ in contested.rivals] == pytest.approx([0.9 * of_near / whole, 0.9 * of_lesser / whole])
    assert [rival for _, rival in contested.rivals] == [near, lesser]
    aside = replace(near, near_prior=False)
    beside = search(best, aside).outcome(0.9)
    assert beside is not None
    assert beside.belief == best.belief  # the prior speaks against that one
    far = replace(best, near_prior=False)
    rivalled = search(far, found(0.2, 94.0, x=5.0)).elsewhere
    assert rivalled is not None
    begun = search(far, found(0.2, 112.0, x=5.0))
    answer = begun.outcome(0.9)
    assert answer is not None
    assert answer.near_prior  # the one elsewhere is no longer sure


@pytest.mark.parametrize(("tilt_deg", "true"), [(0.0, True), (9.5, True), (10.5, False), (180.0, False)])
def test_gravity_may_be_off_by_ten_degrees(tilt_deg: float, true: bool) -> None:
    down = HERE.R_map_camera.T @ (0.0, 0.0, -1.0)
    tilt = np.deg2rad(tilt_deg)
    aside = HERE.R_map_camera.T @ (0.8, -0.6, 0.0)
    gravity = 9.81 * (np.cos(tilt) * down + np.sin(tilt) * aside)
    assert _true_to_gravity(HERE.T_map_camera, gravity) is true
    assert _true_to_gravity(HERE.T_map_camera, None)
    features: Any = None
    query = Query(features, features, gravity=gravity)
    assert _plausible(HERE.T_map_camera, query) is true


@pytest.mark.parametrize(("roll_deg", "plausible"), [(0.0, True), (14.5, True), (-14.5, True), (15.5, False)])
def test_a_seed_may_roll_by_fifteen_degrees_where_upright_is_asked_for(roll_deg: float, plausible: bool) -> None:
    T = Pose.from_heading(HERE.position, HERE.heading, np.deg2rad(roll_deg)).T_map_camera
    features: Any = None
    assert _plausible(T, Query(features, features, dof=Dof.UPRIGHT)) is plausible
    assert _plausible(T, Query(features, features, dof=Dof.AUTO))


@pytest.mark.parametrize(
    ("apart_m", "turned_deg", "near"), [(0.49, 19.0, True), (0.51, 0.0, False), (0.0, 21.0, False), (0.0, 0.0, True)]
)
def test_a_pose_is_near_a_prior_in_place_and_heading(apart_m: float, turned_deg: float, near: bool) -> None:
    turned = np.arctan2(0.8, 0.6) + np.deg2rad(turned_deg)
    there = Pose.from_heading(
        HERE.position + np.array([0, 0, apart_m]), np.array([np.cos(turned), np.sin(turned), 0.0])
    )
    assert _near_prior(there.T_map_camera, Prior(HERE, 0.5, math.radians(20))) is near
    assert _near_prior(there.T_map_camera, None)
    usual = Prior(Pose(there.T_map_camera))  # within a metre and 0.6 radians
    for away_m, aside, expected in ((0.99, 0.59, True), (1.01, 0.0, False), (0.0, 0.61, False)):
        heading = np.array([np.cos(turned + aside), np.sin(turned + aside), 0.0])
        beside = Pose.from_heading(there.position + np.array([0, 0, away_m]), heading)
        assert _near_prior(beside.T_map_camera, usual) is expected


def test_a_stopwatch_adds_up_stages_and_knows_its_deadline(monkeypatch: pytest.MonkeyPatch) -> None:
    now = iter([10.0, 10.0, 10.1, 10.4, 10.5, 10.9, 11.1])
    monkeypatch.setattr(module.time, "perf_counter", lambda: next(now))
    watch = _Stopwatch.__new__(_Stopwatch)
    watch.deadline_s, watch.started, watch.timings_ms, watch._last = 1.0, next(now), {}, next(now)
    watch.lap("match")
    watch.lap("seed")
    watch.lap("match")
    assert watch.timings_ms == pytest.approx({"match": 200.0, "seed": 300.0})
    assert [watch.late, watch.late] == [False, True]
    watch.deadline_s = None
    assert not watch.late


def test_close_about_a_prior_what_agrees_decides_and_not_the_prior(localizer: Localizer, point_room: Any) -> None:
    truth = point_room.walk(9)[4]
    seen = point_room.see(truth, 8)
    rays, near = point_room.camera.rays(seen.pixels), Pose.from_heading(truth.position + 0.03, truth.heading)
    query = Query(seen, point_room.camera, prior=Prior(near))
    tracked = localizer._track(Prior(near), query, rays, _Stopwatch(None))
    assert tracked is not None
    assert np.linalg.norm(tracked.verified.optimum.T_map_camera[:3, 3] - truth.position) < 0.01
    away = Prior(Pose.from_heading(truth.position + 1.0, -truth.heading))
    astray = localizer._track(away, query, rays, _Stopwatch(None))
    assert astray is None or astray.confidence < 0.1


def test_a_place_is_looked_at_closely_from_ransacs_pose_and_from_samples_where_they_are_better(
    localizer: Localizer, point_room: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    truth = point_room.walk(9)[4]
    seen = point_room.see(truth, 8)
    query, rays = Query(seen, point_room.camera, Dof.FREE), point_room.camera.rays(seen.pixels)
    (place,) = [next(iter(module.places_by_votes(localizer.index, localizer.index.match_everywhere(seen), 10)))]

    def looks(
        ransac: FloatArray | None, samples: list[FloatArray], gravity: FloatArray | None = None
    ) -> list[FloatArray]:
        verified: list[FloatArray] = []
        with monkeypatch.context() as patch:
            patch.setattr(localizer, "_ransac_seed", lambda *_: ransac)
            patch.setattr(module, "minimal_samples", lambda *_: np.array(samples).reshape(-1, 4, 4))
            patch.setattr(localizer, "_verified", lambda optimum, *_: verified.append(optimum.T_map_camera))
            asked = replace(query, gravity=gravity)
            list(localizer._look_closely(place, asked, rays, _Stopwatch(None)))
        return verified

    good = truth.T_map_camera
    far = Pose.from_heading(truth.position + 1.0, -truth.heading).T_map_camera
    upside_down = Pose.from_heading(truth.position, truth.heading, np.pi).T_map_camera
    down = truth.R_map_camera.T @ (0.0, 0.0, -1.0)
    assert len(looks(good, [far])) == 1  # samples that are worse are not verified
    assert len(looks(far, [good])) == 2
    assert len(looks(None, [far, good])) == 1
    assert looks(None, []) == []
    best = looks(None, [far, good])[0]
    assert np.linalg.norm(best[:3, 3] - truth.position) < 0.05
    third = looks(None, [far, far, good])[0]
    assert np.linalg.norm(third[:3, 3] - truth.position) > 0.5  # two are climbed from
    assert looks(upside_down, [upside_down], down) == []
    assert len(looks(upside_down, [upside_down, far, good], down)) == 1


@pytest.mark.parametrize("unknown", [False, True])
def test_rivals_are_looked_for_with_the_camera_that_was_found(
    localizer: Localizer, point_room: Any, monkeypatch: pytest.MonkeyPatch, unknown: bool
) -> None:
    truth = point_room.walk(13, sideways_m=0.1)[6]
    wrong = point_room.camera.zoomed(1.4) if unknown else point_room.camera
    intrinsics = Intrinsics.UNKNOWN if unknown else Intrinsics.GIVEN
    asked: list[float] = []

    def rivals(index: Any, nearest: Any, query: Query, rays: FloatArray, best: Any) -> list[FloatArray]:
        np.testing.assert_allclose(rays, query.camera.rays(query.features.pixels))
        asked.append(query.camera.focal)
        return []

    monkeypatch.setattr(module, "rival_seeds", rivals)
    answer = localizer.localize(Query(point_room.see(truth, 501), wrong, intrinsics=intrinsics))
    assert answer.localized
    assert asked == pytest.approx([point_room.camera.focal], rel=0.03)
    assert asked[0] == (answer.camera.focal if answer.camera else wrong.focal)


@pytest.mark.parametrize(("dof", "rolled"), [(Dof.UPRIGHT, False), (Dof.FREE, True)])
def test_candidates_come_with_their_confidence_however_doubtful(
    localizer: Localizer, point_room: Any, dof: Dof, rolled: bool
) -> None:
    held = point_room.walk(9)[4]
    truth = Pose.from_heading(held.position, held.heading, roll=np.deg2rad(1.5))
    query = Query(point_room.see(truth, 5, share=0.06), point_room.camera, dof)
    answer = Localizer(localizer.map, min_recognized=0.999999, index=localizer.index).localize(query)
    assert not answer.localized
    assert answer.reason is Reason.NOT_RECOGNIZED
    assert answer.pose is None
    candidate = localizer.candidate(query)
    assert candidate is not None
    verified, belief = candidate
    assert belief == answer.belief
    assert verified.inliers == answer.inliers == len(answer.inlier_pixels) > 0
    again = localizer._search(localizer.adapted(query), _Stopwatch(None))
    for matches in (0, 10_000):  # with the whole map, against those around the pose
        again.matches = matches
        assert localizer._answer(again).matches == max(matches, len(verified.wide), len(verified.matches))
    given_out = Localizer(localizer.map, min_recognized=belief.recognized, index=localizer.index).localize(query)
    assert given_out.pose is not None
    assert (abs(given_out.pose.roll) > 1e-6) is rolled


def test_without_matches_the_reason_is_that_there_are_none(localizer: Localizer, point_room: Any) -> None:
    seen = point_room.see(point_room.walk(9)[4], 8)
    strange = replace(seen, descriptors=np.random.default_rng(1).integers(0, 256, seen.descriptors.shape, np.uint8))
    answer = localizer.localize(Query(strange, point_room.camera))
    assert answer.reason is Reason.NO_MATCHES
    assert answer.inlier_pixels.shape == (0, 2)
    assert answer.inlier_features.shape == (0,)
    assert (answer.confidence, answer.matches >= 0, answer.inliers) == (0.0, True, 0)
    blind = localizer.localize(Query(seen.take(np.arange(7)), point_room.camera))
    assert (blind.reason, blind.matches) == (Reason.NO_FEATURES, 0)
    votes = localizer.view_votes(seen)
    assert abs(int(votes.argmax()) - 30) <= 4  # the fifth of nine poses on the way of sixty views


def test_in_a_dense_picture_a_sample_is_matched_first_and_every_feature_once(
    localizer: Localizer, point_room: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = point_room.see(point_room.walk(9)[4], 8)
    strange = replace(seen, descriptors=np.random.default_rng(1).integers(0, 256, seen.descriptors.shape, np.uint8))
    many = FeatureSet.concatenate([strange] * (1 + 600 // len(seen)))
    assert len(many.sample) < len(many)
    for intrinsics in Intrinsics:
        looked_up: list[Any] = []
        nearest = localizer.index.nearest_everywhere
        with monkeypatch.context() as patch:
            patch.setattr(
                localizer.index,
                "nearest_everywhere",
                lambda features, some: (looked_up.append(some), nearest(features, some))[1],  # noqa: B023
            )
            localizer._search(Query(many, point_room.camera, intrinsics=intrinsics), _Stopwatch(None))
        np.testing.assert_array_equal(np.sort(np.concatenate(looked_up)), np.arange(len(many)))
        assert len(looked_up) == (2 if intrinsics is Intrinsics.GIVEN else 1)
        if intrinsics is Intrinsics.GIVEN:
            np.testing.assert_array_equal(looked_up[0], many.sample)


def test_verification_looks_at_some_features_where_those_are_enough(
    localizer: Localizer, point_room: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = point_room.see(point_room.walk(9)[4], 8)
    many = FeatureSet.concatenate([seen] * (1 + 600 // len(seen)))
    query, T = Query(many, point_room.camera), HERE.T_map_camera
    hundred = Matches(np.arange(100), np.arange(100), np.full(100, 0.5))

    def looks(count: int, query: Query = query) -> list[bool]:
        """Whether at some alone, each time."""
        asked: list[bool] = []

        def match_near(features: Any, camera: Any, pose: Any, radius: float, some: Any = None) -> Any:
            asked.append(some is not None)
            return hundred.take(np.arange(count)), None

        with monkeypatch.context() as patch:
            patch.setattr(localizer.index, "match_near", match_near)
            assert len(matches_about(localizer.index, query, T, 14.0)) == count
        return asked

    assert looks(60) == [True]
    assert looks(59) == [True, False]
    assert looks(60, replace(query, features=seen)) == [False]


@pytest.mark.parametrize(("wide", "narrow", "found"), [(5, 6, False), (6, 5, False), (6, 6, True)])
def test_a_pose_is_verified_by_six_matches(
    localizer: Localizer, point_room: Any, monkeypatch: pytest.MonkeyPatch, wide: int, narrow: int, found: bool
) -> None:
    truth = point_room.walk(9)[4]
    seen = point_room.see(truth, 8)
    query, index = Query(seen, point_room.camera), localizer.index
    every, by_chance = index.match_near(seen, point_room.camera, truth.T_map_camera, 5.0)
    counts = {14.0: wide, 5.0: narrow}
    monkeypatch.setattr(index, "match_near", lambda *asked: (every.take(np.arange(counts[asked[3]])), by_chance))
    verified = verify(index, query, point_room.camera.rays(seen.pixels), truth.T_map_camera)
    assert (verified is not None) is found
    if verified is not None:
        assert len(verified.pixels) == len(verified.matches) == 6


@pytest.mark.parametrize(
    "tolerances_px",
    [
        SearchOptions().seed_tolerances_px,
        focal._TOLERANCES_PX,
        focal._FIRST_TOLERANCES_PX,
        TOLERANCES_PX,
        SEARCH_RADII_PX,
    ],
)
def test_each_tolerance_holds_what_the_one_before_it_finds(tolerances_px: tuple[float, ...]) -> None:
    """Narrowing to a third at most at a time, from no more than an eighth of a picture to where matches agree."""
    ratios = np.array(tolerances_px[:-1]) / tolerances_px[1:]
    assert (ratios > 1.4).all()
    assert (ratios <= 3).all()
    assert tolerances_px[0] <= 80
    assert FINAL_TOLERANCE_PX <= tolerances_px[-1] <= 6


def test_how_hard_is_looked_is_what_the_options_say(
    localizer: Localizer, point_room: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    truth = point_room.walk(9)[4]
    seen = point_room.see(truth, 8)
    query, rays = Query(seen, point_room.camera, Dof.FREE), point_room.camera.rays(seen.pixels)
    ransac: list[tuple[Any, ...]] = []
    samples: list[tuple[Any, ...]] = []
    places: list[int] = []
    voted = module.places_by_votes

    def vote(index: Any, matches: Any, views_each: int, prior: Any) -> Any:
        for place in voted(index, matches, views_each, prior):
            places.append(views_each)
            yield place

    monkeypatch.setattr(module, "lo_ransac", lambda plane, points, *how: ransac.append(how))
    monkeypatch.setattr(module, "minimal_samples", lambda *how: (samples.append(how[3:]), np.zeros((0, 4, 4)))[1])
    monkeypatch.setattr(module, "places_by_votes", vote)
    search = localizer._search(query, _Stopwatch(None))
    assert search.best is None
    assert search.reason is Reason.NO_AGREEMENT
    assert set(ransac) == {(point_room.camera.focal, 12.0, 1000, 30)}
    assert places == [10] * 8
    assert samples == [(150, 8)] * 8
    assert len(ransac) == 2 * 8  # at a glance and closely
    assert np.isfinite(rays).all()
    places.clear()
    localizer._search(replace(query, more_features=lambda: seen), _Stopwatch(None))
    assert places == [10]  # a quick look is at the likeliest place alone
    strict = Localizer(localizer.map, options=SearchOptions(places=3, seeds=5, samples=7), index=localizer.index)
    samples.clear()
    strict._search(query, _Stopwatch(None))
    assert samples == [(7, 20)] * 3


def test_a_sure_pose_in_the_priors_place_ends_the_search(
    localizer: Localizer, point_room: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    options = SearchOptions(settled_sigma_m=0.1)  # the room of points is known no better
    localizer = Localizer(localizer.map, options=options, index=localizer.index)
    truth = point_room.walk(9)[4]
    query = Query(point_room.see(truth, 8), point_room.camera, prior=Prior(truth, 0.5, 0.3))
    monkeypatch.setattr(localizer, "_track", lambda *_: pytest.fail("tracked where the place was enough"))
    search = localizer._search(query, _Stopwatch(None))
    assert search.everywhere is None  # the whole map was not searched
    assert search.best is not None
    assert search.best.near_prior
    localizer._search(replace(query, intrinsics=Intrinsics.UNKNOWN), _Stopwatch(None))


def test_where_a_priors_place_leaves_a_doubt_it_is_tracked_from_before_the_map_is_searched(
    localizer: Localizer, point_room: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    truth = point_room.walk(9)[4]
    query = Query(point_room.see(truth, 8), point_room.camera, prior=Prior(truth, 0.5, 0.3))
    monkeypatch.setattr(localizer.index, "match_within", lambda *_, **__: Matches.none())
    search = localizer._search(query, _Stopwatch(None))
    assert search.everywhere is None
    assert search.best is not None
    assert np.linalg.norm(search.best.verified.optimum.T_map_camera[:3, 3] - truth.position) < 0.03


def test_more_features_are_looked_up_where_a_quick_look_was_not_sure(localizer: Localizer, point_room: Any) -> None:
    options = SearchOptions(settled_sigma_m=0.1)  # the room of points is known no better
    localizer = Localizer(localizer.map, options=options, index=localizer.index)
    truth = point_room.walk(9)[4]
    every = point_room.see(truth, 8)
    few = Query(every.take(np.arange(7)), point_room.camera, more_features=lambda: every)
    sure = Query(every, point_room.camera, more_features=lambda: pytest.fail("asked for more"))
    assert localizer.attempt(few) is None
    answer = localizer.attempt(sure)
    assert answer is not None
    assert answer.confidence >= 0.9
    assert localizer.localize(sure).localized
    unknown = localizer.localize(replace(few, intrinsics=Intrinsics.UNKNOWN))
    assert "extract" in unknown.timings_ms
    assert localizer.candidate(few) is not None


@pytest.mark.parametrize(("count", "cause"), [(39, Cause.TOO_LITTLE_TEXTURE), (40, Cause.UNKNOWN_PLACE)])
def test_a_refusal_of_few_features_is_for_a_bare_wall(
    localizer: Localizer, point_room: Any, count: int, cause: Cause
) -> None:
    seen = point_room.see(point_room.walk(9)[4], 8)
    strange = replace(seen, descriptors=np.random.default_rng(1).integers(0, 256, seen.descriptors.shape, np.uint8))
    answer = localizer.localize(Query(strange.take(np.arange(count)), point_room.camera))
    assert answer.diagnosis is not None
    assert answer.diagnosis.cause is cause
