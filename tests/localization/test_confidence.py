"""Confidence: it follows what speaks for a pose and against it, and tells right answers from made-up ones."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from rholoc.features import FeatureSet, Metric
from rholoc.geometry import FloatArray
from rholoc.localization import MIN_CONFIDENCE, Dof, Localizer, Query
from rholoc.localization.confidence import confidence_inputs, confidence_of, joint_confidence
from rholoc.maps import Map


def _covariance(sigma_m: float) -> FloatArray:
    return np.diag([1e-6, sigma_m**2, 1e-6, 0.1, 0.1, 0.1])


def _verified(seen: float = 100.0, missing: float = 0.0, by_chance: float = 10.0, sigma_m: float = 0.01) -> Any:
    support = SimpleNamespace(seen=seen, missing=missing)
    return SimpleNamespace(support=support, by_chance=by_chance, covariance=_covariance(sigma_m))


@pytest.mark.parametrize("metric", list(Metric))
def test_it_rises_with_what_is_seen_and_falls_with_what_is_missing_chance_and_uncertainty(metric: Metric) -> None:
    by_seen = [confidence_of(_verified(seen=nats), metric) for nats in (0, 10, 30, 100, 300, 1000)]
    by_missing = [confidence_of(_verified(missing=nats), metric) for nats in (0, 10, 30, 100, 300, 1000)]
    by_chance = [confidence_of(_verified(by_chance=count), metric) for count in (0, 3, 10, 30, 100, 300)]
    by_sigma = [confidence_of(_verified(sigma_m=sigma_m), metric) for sigma_m in (0.06, 0.1, 0.3, 1.0)]
    for confidences, sign in ((by_seen, 1), (by_missing, -1), (by_chance, -1), (by_sigma, -1)):
        assert (sign * np.diff(confidences) > 0).all()
        assert all(0 < confidence < 1 for confidence in confidences)
    assert by_seen[0] < 0.01
    assert by_seen[-1] > 0.99
    assert by_missing[-1] < 0.05


def test_what_it_weighs_is_in_octaves_and_a_sigma_below_5_cm_costs_nothing() -> None:
    inputs = [
        ([_verified(127.0, 0.0, 7.0)], 0.2, [7, 0, 3, 2]),
        ([_verified(30.0, 10.0, 0.0)], 0.05, [np.log2(31), 0.25, 0, 0]),
        ([_verified(0.0, 0.0, 0.0)], 0.001, [0, 0, 0, 0]),
        ([_verified(100.0, 0.0, 3.0), _verified(27.0, 127.0, 4.0)], 0.1, [7, 0.5, 3, 1]),
    ]
    for verified, sigma_m, expected in inputs:
        np.testing.assert_allclose(confidence_inputs(verified, _covariance(sigma_m)), expected, atol=1e-12)


def test_answers_are_sure_where_much_is_seen_and_unsure_where_hardly_anything_is(
    room_map: Map, point_room: Any
) -> None:
    localizer = Localizer(room_map, min_confidence=0.0)
    of_share: dict[float, list[float]] = {0.7: [], 0.03: []}
    for share, confidences in of_share.items():
        for seed, truth in enumerate(point_room.walk(6, sideways_m=0.1)):
            seen = _among_clutter(point_room.see(truth, 700 + seed, share), seed)
            confidences.append(localizer.localize(Query(seen, point_room.camera, Dof.FREE)).confidence)
    assert min(of_share[0.7]) > 0.9
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


@pytest.mark.parametrize("metric", list(Metric))
def test_it_is_a_logistic_in_its_inputs(metric: Metric) -> None:
    def logit(verified: Any, covariance: FloatArray) -> float:
        confidence = joint_confidence([verified], covariance, metric)
        return float(np.log(confidence / (1 - confidence)))

    cases = [
        (_verified(seen, missing, by_chance), _covariance(sigma_m))
        for seen, missing, by_chance, sigma_m in (
            (0.0, 0.0, 0.0, 0.01),
            (15.0, 0.0, 0.0, 0.01),
            (15.0, 15.0, 0.0, 0.01),
            (15.0, 0.0, 7.0, 0.01),
            (15.0, 0.0, 0.0, 0.4),
        )
    ]
    intercept, at_sixteen, at_half_missing, at_eight_by_chance, at_eightfold_sigma = [logit(*case) for case in cases]
    seen, missing, by_chance, sigma = (
        (at_sixteen - intercept) / 4,
        (at_half_missing - at_sixteen) / 0.5,
        (at_eight_by_chance - at_sixteen) / 3,
        (at_eightfold_sigma - at_sixteen) / 3,
    )
    assert intercept < -4  # of what nothing speaks for
    assert 1 < seen < 8
    assert -30 < missing < -3
    assert -4 < by_chance < -0.3
    assert -1 < sigma < -0.05
    mixed = _verified(63.0, 21.0, 15.0)
    expected = intercept + 6 * seen + missing / 4 + 4 * by_chance + sigma
    assert logit(mixed, _covariance(0.1)) == pytest.approx(expected)
    assert confidence_of(_verified(63.0, 21.0, 15.0, 0.1), metric) == joint_confidence(
        [mixed], _covariance(0.1), metric
    )
    assert joint_confidence([_verified(1e300)], _covariance(0.01), metric) == 1.0
    assert joint_confidence([_verified(by_chance=1e300)], _covariance(0.01), metric) < 1e-9
