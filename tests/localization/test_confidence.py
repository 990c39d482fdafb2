"""Confidence: it follows what speaks for a pose and against it, and tells right answers from made-up ones."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.special import expit

from rholoc.features import FeatureSet
from rholoc.geometry import FloatArray
from rholoc.localization import MIN_RECOGNIZED, Belief, Dof, Localizer, Query
from rholoc.localization.belief.confidence import (
    ConfidenceFeatures,
    Weights,
    belief_by,
    belief_of,
    confidence_features,
    joint_belief,
)
from rholoc.localization.pose.pose_evidence import Support
from rholoc.maps import Map


def _covariance(sigma_m: float) -> FloatArray:
    return np.diag([1e-6, sigma_m**2, 1e-6, 0.1, 0.1, 0.1])


def _verified(
    seen: float = 100.0,
    beyond_chance: float = 30.0,
    sigma_m: float = 0.01,
    found: float = 49.0,
    inliers: int = 60,
    expected: float = 199.0,
    colours: float = np.nan,
    patches: float = np.nan,
) -> Any:
    support = Support(seen, 5.0, found, expected, beyond_chance, colours, patches)
    return SimpleNamespace(support=support, covariance=_covariance(sigma_m), inliers=inliers)


@pytest.mark.parametrize("colours", [np.nan, 0.5])
@pytest.mark.parametrize("patches", [np.nan, 0.5])
def test_it_rises_with_what_is_found_and_falls_with_chance_and_uncertainty(colours: float, patches: float) -> None:
    known = {"colours": colours, "patches": patches}

    def confidences(name: str, values: tuple[float, ...]) -> list[float]:
        return [belief_of(_verified(**(known | {name: value}))).confidence for value in values]

    rising = [
        confidences("seen", (0, 3, 10, 30, 100, 300)),
        confidences("found", (0, 3, 10, 30, 100, 199)),
        confidences("colours", (0.6, 0.7, 0.8, 0.9)),
        confidences("patches", (-0.4, 0.0, 0.6, 1.1)),
    ]
    falling = [
        confidences("sigma_m", (0.026, 0.05, 0.1, 0.19)),
    ]
    for some, sign in [(one, 1) for one in rising] + [(one, -1) for one in falling]:
        assert (sign * np.diff(some) > 0).all()
        assert all(0 < confidence < 1 for confidence in some)
    by_surprise = np.diff(confidences("beyond_chance", (0, 3, 10, 30, 60, 300)))
    assert (by_surprise >= 0).all()
    assert by_surprise[-1] == 0  # a nat a match is all that it says


def test_what_it_weighs_is_in_octaves_and_sigmas_far_from_10_cm_say_no_more() -> None:
    one = _verified(4.0, 1.0, found=19.0, expected=39.0, inliers=10, colours=0.2, patches=0.9)
    other = _verified(3.0, 4.0, found=29.0, expected=57.0, inliers=12, colours=0.7)
    grounds = [
        ([_verified(31.0, 3.0, inliers=15)], 0.2, (-2, 5, -2), np.nan, np.nan, 1),
        ([_verified(1.0, 99.0, inliers=7, colours=0.4)], 0.05, (0, 1, -2), 0.4, np.nan, -1),
        ([_verified(0.0, 0.0, inliers=0)], 0.001, (0, 0, -2), np.nan, np.nan, -2),
        ([one, other], 4.0, (np.log2(6 / 23), 3, np.log2(49 / 97)), (19 * 0.2 + 29 * 0.7) / 48, 0.9, 1),
        ([_verified(3.0, 19.0, inliers=39, patches=3.0)], 0.1, (-1, 2, -2), np.nan, 1.2, 0),
        ([_verified(3.0, 0.0, found=0.0, expected=63.0, inliers=0, colours=0.5)], 0.1, (0, 2, -6), np.nan, np.nan, 0),
    ]
    for verified, sigma_m, place, colours, patches, sigma in grounds:
        found = confidence_features(verified, _covariance(sigma_m))
        np.testing.assert_allclose(
            (*found.place, found.colours, found.patches, found.sigma), (*place, colours, patches, sigma), atol=1e-12
        )
        assert (found.has_colours, found.has_patches) == (not np.isnan(colours), not np.isnan(patches))


def test_answers_are_sure_where_much_is_seen_and_unsure_where_hardly_anything_is(
    room_map: Map, point_room: Any
) -> None:
    localizer = Localizer(room_map, min_recognized=0.0)
    of_share: dict[float, list[float]] = {0.7: [], 0.03: []}
    for share, confidences in of_share.items():
        for seed, truth in enumerate(point_room.into_corners()):
            seen = _among_clutter(point_room.see(truth, 700 + seed, share), seed)
            answer = localizer.localize(Query(seen, point_room.camera, Dof.FREE))
            assert 0 <= answer.confidence <= answer.recognized <= 1
            confidences.append(answer.confidence)
    assert min(of_share[0.7]) > 0.7  # the least sure are hardly exact
    assert np.mean(of_share[0.7]) > 0.9
    assert max(of_share[0.03]) < MIN_RECOGNIZED
    assert np.mean(of_share[0.03]) < 0.2


def _among_clutter(seen: FeatureSet, seed: int, count: int = 300) -> FeatureSet:
    """What was seen, among detections of nothing in particular."""
    rng = np.random.default_rng(seed)
    pixels = rng.uniform((0, 0), (640, 480), (count, 2)).astype(np.float32)
    return replace(
        seen,
        pixels=np.concatenate([seen.pixels, pixels]),
        channels=np.concatenate([seen.channels, np.zeros(count, np.uint8)]),
        descriptors=np.concatenate([seen.descriptors, rng.integers(0, 256, (count, 32), dtype=np.uint8)]),
        sizes=np.concatenate([seen.sizes, np.full(count, 31, np.float32)]),
        angles=np.concatenate([seen.angles, np.zeros(count, np.float32)]),
    )


def test_it_is_the_probability_of_the_place_times_that_of_being_exact_there() -> None:
    weights = Weights(
        place=(0.5, 1.5, 2.5, 0.0),
        colours=(1.0, 2.0, 3.0, 0.0, 6.0),
        patches=(0.6, 1.5, 2.5, 0.0, 0.7),
        both=(1.1, 2.0, 3.0, 0.0, 0.8, 6.0),
        exact=(0.25, -0.75),
    )

    def belief(colours: float, patches: float) -> Belief:
        return belief_by(ConfidenceFeatures((-0.1, 0.2, 9.0), colours, patches, 1.2), weights)

    def approximately(logit: float) -> Belief:
        return Belief(pytest.approx(expit(logit)), pytest.approx(expit(0.25 - 0.75 * 1.2)))

    by_colours = 1.0 - 0.2 + 0.6 + 3.0
    assert belief(0.5, np.nan) == approximately(by_colours)
    assert belief(0.5, 2.5) == approximately(by_colours + 0.1 + 0.8 * 2.5)
    without = 0.5 - 0.15 + 0.5
    assert belief(np.nan, np.nan) == approximately(without)
    by_patches = without + 0.1 - 0.7 * 1.5
    assert belief(np.nan, -1.5) == approximately(by_patches)
    for patches, alone in ((np.nan, without), (-1.5, by_patches)):
        assert belief(-9.0, patches) == approximately(alone - np.log(2))
    said = belief(0.5, 2.5)
    assert said.confidence == said.recognized * said.exact
    surely, surely_not = (0, 1e300, 0), (-1e300, 0, 0)
    assert belief_by(ConfidenceFeatures(surely, np.nan, np.nan, -2.0), weights) == Belief(
        1.0, pytest.approx(expit(1.75))
    )
    assert belief_by(ConfidenceFeatures(surely_not, np.nan, np.nan, -2.0), weights).recognized == 0.0


def test_where_colours_agree_it_is_surer_than_where_they_are_unknown_and_where_they_do_not_less() -> None:
    agreeing, unknown, other = (belief_of(_verified(40.0, 20.0, colours=one)).recognized for one in (0.8, np.nan, 0.1))
    assert agreeing > unknown > other
    assert joint_belief([_verified(sigma_m=0.3)], _covariance(0.3)) == belief_of(_verified(sigma_m=0.3))


def test_a_pose_from_afar_is_recognized_though_most_landmarks_are_missing() -> None:
    """Seen from one to two metres from any view: 144 inliers, a fifth of the landmarks, orientations that agree."""
    from_afar = _verified(250.0, 130.0, found=144.0, inliers=144, expected=758.0, colours=0.57, patches=1.2)
    assert belief_of(from_afar).recognized > 0.95
