"""What a search answers with: which candidate, how sure, and what is asked of a seed."""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from rholoc.density import Evidence
from rholoc.geometry import Pose
from rholoc.localization import (
    MIN_RECOGNIZED,
    Belief,
    Cause,
    Dof,
    Intrinsics,
    Localizer,
    Prior,
    Query,
    Reason,
)
from rholoc.localization.index.matches import Matches
from rholoc.localization.pose.ascent import Optimum
from rholoc.localization.pose.focal import FocalEstimate
from rholoc.localization.pose.pose_evidence import Support
from rholoc.localization.pose.rematching import Verified
from rholoc.localization.search import Found, Search, SearchOptions, Stopwatch


def found(
    recognized: float,
    net: float = 100.0,
    x: float = 0.0,
    near_prior: bool = True,
    exact: float = 1.0,
    focal: float = 1.0,
    value: float = 1.0,
) -> Found:
    """A candidate ``x`` metres along the map's x axis."""
    T = np.eye(4)
    T[0, 3] = x
    nothing = np.zeros(0, np.int64)
    evidence = Evidence.of(nothing, np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros(0), 500.0)
    optimum = Optimum(T, value, np.zeros(0))
    verified = Verified(optimum, Matches.none(), evidence, np.zeros((0, 2)), Matches.none(), Support(net, 0.0))
    estimate = FocalEstimate(500.0, 1.0, focal)
    camera: Any = None
    return Found(verified, camera, lambda: estimate, Belief(recognized, exact), near_prior)


def search(*candidates: Found | None, prior: Prior | None = None, seeds: int = 0) -> Search:
    query: Any = SimpleNamespace(prior=prior)
    begun = Search(query, Stopwatch(None), everywhere=Matches.none(), seeds=seeds)
    for candidate in candidates:
        begun.add(candidate)
    return begun


def test_a_search_is_hopeless_once_five_looks_found_hardly_the_right_place_or_two_found_nothing_at_all() -> None:
    options = SearchOptions()
    assert not search().is_hopeless(options)
    assert not search(None).is_hopeless(options)
    assert search(None, None).is_hopeless(options)
    assert not search(None, None, seeds=1).is_hopeless(options)
    assert not search(found(0.01), None, found(0.001), None, seeds=2).is_hopeless(options)
    assert search(found(0.01), None, found(0.001), None, found(0.019), seeds=2).is_hopeless(options)
    assert search(*[None] * 5, seeds=1).is_hopeless(options)
    assert not search(found(0.01), found(0.021), found(0.001), None, found(0.0), seeds=2).is_hopeless(options)


def test_a_pose_seen_from_afar_is_not_settled_however_exact_it_looks() -> None:
    near, afar = (
        replace(found(0.95), verified=replace(found(0.95).verified, support=one))
        for one in (Support(9.0, 1.0, 30.0, 100.0), Support(9.0, 1.0, 20.0, 100.0))
    )
    assert search(near).is_settled(math.inf)
    assert not search(afar).is_settled(math.inf)


@pytest.mark.parametrize(
    ("best", "elsewhere", "answer"),
    [
        (None, None, None),
        (0.3, None, "best"),
        (0.3, 0.89, "best"),
        (0.3, 0.9, "elsewhere"),
        (0.49, 0.95, "elsewhere"),
        (MIN_RECOGNIZED, 0.95, "best"),
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
    assert not search().is_over(0.9, math.inf)
    assert not search(found(0.89)).is_over(0.9, math.inf)
    assert not search(found(0.95)).is_over(0.9, max_sigma_m=0.07)  # nothing fixes that pose
    assert search(found(0.9, focal=0.2)).is_over(0.9, math.inf)
    assert search(found(0.5), found(0.9, near_prior=False, focal=0.2)).is_over(0.9, math.inf)


def test_only_what_lies_where_a_prior_expects_it_is_as_expected() -> None:
    prior = Prior(Pose(np.eye(4)))
    assert search(found(0.5), prior=prior).is_as_expected(0.5)
    assert search(found(0.5, exact=0.2, focal=0.2), prior=prior).is_as_expected(0.5)
    assert not search(found(0.49), prior=prior).is_as_expected(0.5)
    assert not search(found(0.5)).is_as_expected(0.5)
    assert not search(found(0.8, near_prior=False), prior=prior).is_as_expected(0.5)
    assert not search(prior=prior).is_as_expected(0.5)


def test_a_candidate_is_as_sure_as_it_is_better_than_its_best_rival() -> None:
    best = found(0.95, 100.0)
    lesser, near, nearer = found(0.9, 70.0, x=9.0), found(0.9, 94.0, x=5.0), found(0.9, 99.0, x=0.09)
    alone = search(best, nearer).outcome(0.9)
    assert (alone.verified, alone.belief) == (best.verified, best.belief)  # what is beside it is the same place
    weight = 0.9 * np.exp(-1 / 12) / (0.95 + 0.9 * np.exp(-1 / 12))
    assert alone.modes is not None
    assert alone.modes.right == 1
    np.testing.assert_allclose(alone.modes.moment, np.diag([weight * 0.09**2, 0, 0, 0, 0, 0]), atol=1e-12)
    assert search(best).outcome(0.9).modes is None  # type: ignore[union-attr]
    aside = search(best, found(0.9, 99.0, x=0.2)).outcome(0.9)
    assert aside is not None
    assert aside.recognized == best.recognized
    assert aside.belief.exact == pytest.approx((1 - weight) * best.belief.exact)
    contested = search(best, lesser, near, nearer).outcome(0.9)
    assert contested.verified is best.verified
    of_near, of_lesser = 0.9 * np.exp(-0.5), 0.9 * np.exp(-2.5)
    whole = 0.95 + of_near + of_lesser
    assert contested.recognized == pytest.approx(0.95 * 0.95 / whole)
    assert [weight for weight, _ in contested.rivals] == pytest.approx([0.9 * of_near / whole, 0.9 * of_lesser / whole])
    assert [rival for _, rival in contested.rivals] == [near, lesser]
    unlikely = replace(near, near_prior=False)
    beside = search(best, unlikely).outcome(0.9)
    assert beside is not None
    assert beside.belief == best.belief  # the prior speaks against that one
    far = replace(best, near_prior=False)
    rivalled = search(far, found(0.2, 94.0, x=5.0)).elsewhere
    assert rivalled is not None
    begun = search(far, found(0.2, 112.0, x=5.0))
    answer = begun.outcome(0.9)
    assert answer.near_prior  # the one elsewhere is no longer sure


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
    given_out = Localizer(localizer.map, min_recognized=answer.recognized, index=localizer.index).localize(query)
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


def test_more_features_are_looked_up_where_a_quick_look_was_not_sure(localizer: Localizer, point_room: Any) -> None:
    options = SearchOptions(settled_sigma_m=0.1)  # the room of points is known no better
    localizer = Localizer(localizer.map, options=options, index=localizer.index)
    truth = point_room.walk(9)[4]
    every = point_room.see(truth, 8)
    few = Query(every.take(np.arange(7)), point_room.camera, more_features=lambda: every)
    sure = Query(every, point_room.camera, more_features=lambda: pytest.fail("asked for more"))
    assert localizer.attempt(few) is None
    answer = localizer.attempt(sure)
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
    assert answer.diagnosis.cause is cause
