"""Matches: ordered, mutual, and how probable each is by its descriptors."""

import numpy as np
import pytest

from rholoc.features import Metric
from rholoc.features.matching import LIMITS
from rholoc.localization.index.matches import Matches, NearestLandmarks, guided_chances, is_least, match_chances


def matches(*rows: tuple[int, int, float]) -> Matches:
    detections, landmarks, chances = zip(*rows, strict=True)
    return Matches(np.array(detections), np.array(landmarks), np.array(chances))


def rows_of(some: Matches) -> list[tuple[int, int, float]]:
    return list(zip(some.detections.tolist(), some.landmarks.tolist(), some.chances.tolist(), strict=True))


def test_the_likeliest_comes_first_and_equal_ones_keep_their_order() -> None:
    ordered = matches((0, 1, 0.2), (1, 2, 0.9), (2, 3, 0.2)).likeliest_first()
    assert [row[0] for row in rows_of(ordered)] == [1, 0, 2]


def test_each_feature_has_its_nearest_landmark_unless_that_is_too_unlike() -> None:
    limits = LIMITS[Metric.HAMMING]
    far = limits.loose + 1
    nearest = NearestLandmarks(
        np.arange(5),
        np.array([[4, 5], [6, 4], [4, -1], [-1, -1], [9, 4]]),
        np.array([[10.0, 30.0], [limits.loose, 70.0], [20.0, 20.0], [0.0, 0.0], [far, far + 1]]),
        Metric.HAMMING,
    )
    found = nearest.matches()
    assert [row[:2] for row in rows_of(found)] == [(0, 4), (1, 6), (2, 4)]
    expected = match_chances(np.array([10.0, limits.loose]), np.array([30.0, 70.0]), Metric.HAMMING)
    np.testing.assert_allclose(found.chances[:2], expected)
    assert [row[:2] for row in rows_of(nearest.matches(mutual=True))] == [(0, 4), (1, 6)]
    assert (
        len(
            NearestLandmarks(np.arange(0), np.zeros((0, 2), int), np.zeros((0, 2)), Metric.HAMMING).matches(mutual=True)
        )
        == 0
    )


def test_a_rival_is_another_landmark() -> None:
    """The same landmark has several descriptors: the next distance to it says nothing."""
    several = NearestLandmarks(
        np.arange(1), np.array([[4, 4, 5]]), np.array([[10.0, 11.0, 60.0]]), Metric.HAMMING
    ).matches()
    alone = NearestLandmarks(np.arange(1), np.array([[4, 5]]), np.array([[10.0, 60.0]]), Metric.HAMMING).matches()
    ambiguous = NearestLandmarks(np.arange(1), np.array([[4, 5]]), np.array([[10.0, 11.0]]), Metric.HAMMING).matches()
    assert several.chances == pytest.approx(alone.chances)
    assert ambiguous.chances[0] < alone.chances[0]


def test_pairs_are_all_that_are_alike() -> None:
    limits = LIMITS[Metric.HAMMING]
    nearest = NearestLandmarks(
        np.arange(2),
        np.array([[4, 5], [6, -1]]),
        np.array([[10.0, limits.loose], [limits.loose + 1, 5.0]]),
        Metric.HAMMING,
    )
    pairs = nearest.pairs()
    assert [row[:2] for row in rows_of(pairs)] == [(0, 4), (0, 5)]
    np.testing.assert_allclose(pairs.chances, guided_chances(np.array([10.0, limits.loose]), Metric.HAMMING))


@pytest.mark.parametrize("metric", list(Metric))
def test_chances_fall_with_the_distance_and_rise_with_the_lead(metric: Metric) -> None:
    limits = LIMITS[metric]
    distances = np.linspace(0, limits.loose, 9)
    by_distance = match_chances(distances, distances + limits.spread, metric)
    assert np.all(np.diff(by_distance) <= 0)
    assert by_distance[0] > 0.5 > by_distance[-1]
    half = np.full(5, limits.strict / 2)
    by_lead = match_chances(half, half + limits.spread * np.arange(5), metric)
    assert np.all(np.diff(by_lead) >= 0)
    assert by_lead[0] < 0.5 < by_lead[-1]
    extremes = match_chances(np.array([0.0, 600.0]), np.array([600.0, 600.0]), metric)
    np.testing.assert_allclose(extremes, [0.95, 0.02])
    unrivalled = match_chances(np.array([limits.strict / 2]), np.array([np.inf]), metric)
    led = match_chances(np.array([limits.strict / 2]), np.array([1.5 * limits.strict]), metric)
    assert unrivalled == pytest.approx(led)


@pytest.mark.parametrize("metric", list(Metric))
def test_guided_chances_are_even_at_the_strict_limit(metric: Metric) -> None:
    limits = LIMITS[metric]
    found = guided_chances(np.array([0.0, limits.strict, 600.0]), metric)
    assert found[0] > 0.5
    assert found[1] == pytest.approx(0.5)
    assert found[2] == pytest.approx(0.1)


def test_the_least_of_each_group() -> None:
    least = is_least(np.array([3.0, 1.0, 2.0, 2.0, 5.0]), np.array([0, 0, 2, 2, -1]), 3)
    assert least.tolist() == [False, True, True, True, True]


@pytest.mark.parametrize("metric", list(Metric))
def test_a_chance_is_a_logistic_in_lead_and_distance(metric: Metric) -> None:
    limits = LIMITS[metric]
    distances = np.array([0.3, 0.6, 0.6, 0.8]) * limits.strict
    leads = np.array([1.0, 1.0, 1.5, 0.7]) * limits.spread
    logits = 2 * (leads / limits.spread - 1) - (distances - 0.6 * limits.strict) / limits.spread
    assert (np.abs(logits) < 2.9).all()  # so that no bound shows
    expected = 1 / (1 + np.exp(-logits))
    np.testing.assert_allclose(match_chances(distances, distances + leads, metric), expected)
    guided = guided_chances(limits.strict + limits.spread * np.array([-1.0, 0.5, -9.0]), metric)
    np.testing.assert_allclose(guided, [1 / (1 + np.exp(-1)), 1 / (1 + np.exp(0.5)), 0.95])


def test_looked_up_features_are_joined_and_a_landmark_alone_is_led_by_its_own_last_descriptor() -> None:
    one = NearestLandmarks(np.array([3]), np.array([[4, 4]]), np.array([[10.0, 30.0]]), Metric.HAMMING)
    other = NearestLandmarks(
        np.array([0, 5]), np.array([[6, 7], [4, 6]]), np.array([[5.0, 9], [8.0, 70]]), Metric.HAMMING
    )
    both = one.joined(other)
    assert len(both) == 3
    assert both.detections.tolist() == [3, 0, 5]
    assert both.landmarks.tolist() == [[4, 4], [6, 7], [4, 6]]
    expected = match_chances(np.array([10.0, 5, 8]), np.array([30.0, 9, 70]), Metric.HAMMING)
    np.testing.assert_allclose(both.matches().chances, expected)
    assert both.matches(mutual=True).detections.tolist() == [0, 5]  # of two with landmark 4 the nearer
    nothing = NearestLandmarks(np.array([1, 2]), np.full((2, 2), -1), np.full((2, 2), np.inf), Metric.HAMMING)
    assert len(nothing.matches(mutual=True)) == len(nothing.matches()) == len(nothing.pairs()) == 0
    limit = LIMITS[Metric.HAMMING].loose
    edge = NearestLandmarks(np.arange(2), np.array([[0], [0]]), np.array([[limit], [limit + 1]]), Metric.HAMMING)
    assert edge.matches().detections.tolist() == edge.pairs().detections.tolist() == [0]
