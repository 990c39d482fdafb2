"""Confidence: it follows what speaks for a pose and against it, and tells right answers from made-up ones."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.special import expit

from rholoc.features import FeatureSet, extractor_names
from rholoc.geometry import FloatArray
from rholoc.localization import MIN_CONFIDENCE, Dof, Localizer, Query
from rholoc.localization.confidence import (
    Grounds,
    Weights,
    confidence_of,
    grounds_of,
    joint_confidence,
    probability,
    weights_for,
)
from rholoc.localization.support import Support
from rholoc.maps import Map


def _covariance(sigma_m: float) -> FloatArray:
    return np.diag([1e-6, sigma_m**2, 1e-6, 0.1, 0.1, 0.1])


def _verified(
    seen: float = 100.0,
    missing: float = 5.0,
    beyond_chance: float = 30.0,
    by_chance: float = 10.0,
    sigma_m: float = 0.01,
    found: float = 49.0,
    inliers: int = 60,
    expected: float = 199.0,
    colours: float = np.nan,
    patches: float = np.nan,
) -> Any:
    support = Support(seen, missing, found, expected, beyond_chance, colours, patches)
    return SimpleNamespace(support=support, by_chance=by_chance, covariance=_covariance(sigma_m), inliers=inliers)


@pytest.mark.parametrize("features", [name for name in extractor_names() if name != "xfeat"])
@pytest.mark.parametrize("colours", [np.nan, 0.5])
@pytest.mark.parametrize("patches", [np.nan, 0.5])
def test_it_rises_with_what_is_found_and_falls_with_chance_and_uncertainty(
    features: str, colours: float, patches: float
) -> None:
    known, weights = {"colours": colours, "patches": patches}, weights_for(features)
    fewest = 1 if features == "rgb" else 0  # of what is not found no patches are known: rgb is a little surer then

    def confidences(name: str, values: tuple[float, ...]) -> list[float]:
        return [confidence_of(_verified(**(known | {name: value})), weights) for value in values]

    rising = [
        confidences("seen", (0, 3, 10, 30, 100, 300)),
        confidences("found", (fewest, 3, 10, 30, 100, 199)),
        confidences("colours", (0.6, 0.7, 0.8, 0.9)),
        confidences("patches", (-0.4, 0.0, 0.6, 1.1)),
    ]
    falling = [
        confidences("missing", (0, 3, 10, 30, 100)),
        confidences("by_chance", (0, 3, 10, 30, 100, 300)),
        confidences("sigma_m", (0.026, 0.05, 0.1, 0.19)),
    ]
    for some, sign in [(one, 1) for one in rising] + [(one, -1) for one in falling]:
        assert (sign * np.diff(some) > 0).all()
        assert all(0 < confidence < 1 for confidence in some)
    by_surprise = np.diff(confidences("beyond_chance", (0, 3, 10, 30, 60, 300)))
    assert (by_surprise >= 0).all()
    assert by_surprise[-1] == 0  # a nat a match is all that it says


def test_what_it_weighs_is_in_octaves_and_sigmas_far_from_10_cm_say_no_more() -> None:
    one = _verified(4.0, 1.0, 1.0, 3.0, found=19.0, expected=39.0, inliers=10, colours=0.2, patches=0.9)
    other = _verified(3.0, 2.0, 4.0, 4.0, found=29.0, expected=57.0, inliers=12, colours=0.7)
    grounds = [
        ([_verified(31.0, 7.0, 3.0, 15.0, inliers=15)], 0.2, (-2, 5, 3, 4, -2), np.nan, np.nan, 1),
        ([_verified(1.0, 0.0, 99.0, 0.0, inliers=7, colours=0.4)], 0.05, (0, 1, 0, 0, -2), 0.4, np.nan, -1),
        ([_verified(0.0, 0.0, 0.0, 0.0, inliers=0)], 0.001, (0, 0, 0, 0, -2), np.nan, np.nan, -2),
        ([one, other], 4.0, (np.log2(6 / 23), 3, 2, 3, np.log2(49 / 97)), (19 * 0.2 + 29 * 0.7) / 48, 0.9, 1),
        (
            [_verified(3.0, 1.0, 19.0, 7.0, inliers=39, patches=3.0)],
            0.1,
            (-1, 2, 1, 3, -2),
            np.nan,
            1.2,
            0,
        ),
        (
            [_verified(3.0, 0.0, 0.0, 0.0, found=0.0, expected=63.0, inliers=0, colours=0.5)],
            0.1,
            (0, 2, 0, 0, -6),
            np.nan,
            np.nan,
            0,
        ),
    ]
    for verified, sigma_m, place, colours, patches, sigma in grounds:
        found = grounds_of(verified, _covariance(sigma_m))
        np.testing.assert_allclose(
            (*found.place, found.colours, found.patches, found.sigma), (*place, colours, patches, sigma), atol=1e-12
        )
        assert (found.has_colours, found.has_patches) == (not np.isnan(colours), not np.isnan(patches))


def test_answers_are_sure_where_much_is_seen_and_unsure_where_hardly_anything_is(
    room_map: Map, point_room: Any
) -> None:
    localizer = Localizer(room_map, min_confidence=0.0)
    of_share: dict[float, list[float]] = {0.7: [], 0.03: []}
    for share, confidences in of_share.items():
        for seed, truth in enumerate(point_room.walk(6, sideways_m=0.1)):
            seen = _among_clutter(point_room.see(truth, 700 + seed, share), seed)
            confidences.append(localizer.localize(Query(seen, point_room.camera, Dof.FREE)).confidence)
    assert min(of_share[0.7]) > 0.7  # the least sure are hardly exact
    assert np.mean(of_share[0.7]) > 0.9
    assert max(of_share[0.03]) < MIN_CONFIDENCE
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
        place=(0.5, 1.5, 2.5, 3.5, -4.5, 0.0),
        colours=(1.0, 2.0, 3.0, 4.0, -5.0, 0.0, 6.0),
        patches=(0.6, 1.5, 2.5, 3.5, -4.5, 0.0, 0.7),
        both=(1.1, 2.0, 3.0, 4.0, -5.0, 0.0, 0.8, 6.0),
        exact=(0.25, -0.75),
    )
    exact = expit(0.25 - 0.75 * 1.2)
    place = (-0.1, 0.2, 0.3, 0.4, 9.0)
    by_colours = 1.0 - 0.2 + 0.6 + 1.2 - 2.0 + 3.0
    assert probability(Grounds(place, 0.5, np.nan, 1.2), weights) == pytest.approx(expit(by_colours) * exact)
    both = by_colours + 0.1 + 0.8 * 2.5
    assert probability(Grounds(place, 0.5, 2.5, 1.2), weights) == pytest.approx(expit(both) * exact)
    without = 0.5 - 0.15 + 0.5 + 1.05 - 1.8
    assert probability(Grounds(place, np.nan, np.nan, 1.2), weights) == pytest.approx(expit(without) * exact)
    by_patches = without + 0.1 - 0.7 * 1.5
    assert probability(Grounds(place, np.nan, -1.5, 1.2), weights) == pytest.approx(expit(by_patches) * exact)
    for patches, alone in ((np.nan, without), (-1.5, by_patches)):
        surely_not = expit(alone - np.log(2))
        assert probability(Grounds(place, -9.0, patches, 1.2), weights) == pytest.approx(surely_not * exact)
    assert probability(Grounds((0, 1e300, 0, 0, 0), np.nan, np.nan, -2.0), weights) == pytest.approx(expit(1.75))
    assert probability(Grounds((0, 0, 0, 1e300, 0), np.nan, np.nan, -2.0), weights) == 0.0


@pytest.mark.parametrize("colours", [np.nan, 0.5])
def test_features_that_are_neither_turned_nor_sized_go_without_patches_even_where_a_map_has_some(
    colours: float,
) -> None:
    weights = weights_for("xfeat")
    said = [confidence_of(_verified(colours=colours, patches=patches), weights) for patches in (np.nan, -0.4, 1.1)]
    assert said[0] > MIN_CONFIDENCE
    assert said == [said[0]] * 3


@pytest.mark.parametrize("features", ["gray", "sift48"])
def test_where_colours_agree_it_is_surer_than_where_they_are_unknown_and_where_they_do_not_less(features: str) -> None:
    agreeing, unknown, other = (
        confidence_of(_verified(40.0, 5.0, 20.0, colours=one), weights_for(features)) for one in (0.8, np.nan, 0.1)
    )
    assert agreeing > unknown > other
    joint = joint_confidence([_verified(sigma_m=0.3)], _covariance(0.3), weights_for(features))
    assert joint == confidence_of(_verified(sigma_m=0.3), weights_for(features))
