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
from rholoc.localization.support import Support
from rholoc.maps import Map


def _covariance(sigma_m: float) -> FloatArray:
    return np.diag([1e-6, sigma_m**2, 1e-6, 0.1, 0.1, 0.1])


def _verified(
    seen: float = 100.0,
    found: float = 49.0,
    beyond_chance: float = 30.0,
    by_chance: float = 10.0,
    sigma_m: float = 0.01,
    expected: float = 199.0,
    parts: float = 15.0,
) -> Any:
    support = Support(seen, 0.0, found, expected, beyond_chance, parts)
    return SimpleNamespace(support=support, by_chance=by_chance, covariance=_covariance(sigma_m))


@pytest.mark.parametrize("metric", list(Metric))
def test_it_rises_with_what_is_seen_and_found_and_falls_with_chance_and_uncertainty(metric: Metric) -> None:
    by_seen = [confidence_of(_verified(seen=nats), metric) for nats in (0, 10, 30, 100, 300, 1000)]
    by_share = [confidence_of(_verified(found=count), metric) for count in (0, 3, 10, 30, 100, 199)]
    by_agreeing = [confidence_of(_verified(beyond_chance=count), metric) for count in (0, 3, 10, 30, 100)]
    by_parts = [confidence_of(_verified(parts=count), metric) for count in (0, 3, 10, 30)]
    by_chance = [confidence_of(_verified(by_chance=count), metric) for count in (0, 3, 10, 30, 100, 300)]
    by_sigma = [confidence_of(_verified(sigma_m=sigma_m), metric) for sigma_m in (0.21, 0.4, 1.0, 3.0)]
    rising, falling = (by_seen, by_share, by_agreeing, by_parts), (by_chance, by_sigma)
    for confidences, sign in [(one, 1) for one in rising] + [(one, -1) for one in falling]:
        assert (sign * np.diff(confidences) > 0).all()
        assert all(0 < confidence < 1 for confidence in confidences)


def test_what_it_weighs_is_in_octaves_and_a_sigma_below_20_cm_costs_nothing() -> None:
    two = [_verified(100.0, 19.0, 3.0, 3.0), _verified(27.0, 29.0, 4.0, 4.0, parts=16.0)]
    inputs = [
        ([_verified(127.0, 49.0, 3.0, 7.0)], 0.8, [7, -2, 2, 4, 3, 2]),
        ([_verified(30.0, 199.0, 0.0, 0.0)], 0.2, [np.log2(31), 0, 0, 4, 0, 0]),
        ([_verified(0.0, 0.0, 0.0, 0.0, expected=0.0, parts=0.0)], 0.001, [0, 0, 0, 0, 0, 0]),
        (two, 0.4, [7, np.log2(49 / 399), 3, 5, 3, 1]),
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

    nothing = {"seen": 0.0, "found": 199.0, "beyond_chance": 0.0, "by_chance": 0.0, "parts": 0.0}
    sixteen = nothing | {"seen": 15.0}
    intercept = logit(_verified(**nothing), _covariance(0.01))
    at_sixteen = logit(_verified(**sixteen), _covariance(0.01))
    seen = (at_sixteen - intercept) / 4
    share = -(logit(_verified(**(sixteen | {"found": 49.0})), _covariance(0.01)) - at_sixteen) / 2
    agreeing = (logit(_verified(**(sixteen | {"beyond_chance": 7.0})), _covariance(0.01)) - at_sixteen) / 3
    parts = (logit(_verified(**(sixteen | {"parts": 7.0})), _covariance(0.01)) - at_sixteen) / 3
    by_chance = (logit(_verified(**(sixteen | {"by_chance": 7.0})), _covariance(0.01)) - at_sixteen) / 3
    sigma = (logit(_verified(**sixteen), _covariance(1.6)) - at_sixteen) / 3
    assert 0.5 < seen < 4
    assert 0.1 < share < 2
    assert 0.1 < agreeing < 2
    assert 0.5 < parts < 4
    assert -4 < by_chance < -0.3
    assert -2 < sigma < -0.05
    mixed = _verified(63.0, 24.0, 3.0, 15.0)
    expected = intercept + 6 * seen - 3 * share + 2 * agreeing + 4 * parts + 4 * by_chance + sigma
    assert logit(mixed, _covariance(0.4)) == pytest.approx(expected)
    mixed.covariance = _covariance(0.4)
    assert confidence_of(mixed, metric) == joint_confidence([mixed], _covariance(0.4), metric)
    assert joint_confidence([_verified(1e300)], _covariance(0.01), metric) == 1.0
    assert joint_confidence([_verified(by_chance=1e300)], _covariance(0.01), metric) < 1e-9
