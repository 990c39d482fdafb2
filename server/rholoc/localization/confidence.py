"""Confidence: the probability that a pose is within 10 cm and 5°.

A logistic in what verification found: what the picture says for the pose and against it, cell by cell
(:mod:`rholoc.localization.support`), how many matches chance alone would have found there, and how well the curvature
fixes the position. What rivals the pose has is counted apart (:mod:`rholoc.localization.rivals`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.special import expit

from rholoc.features import Metric
from rholoc.geometry import FloatArray
from rholoc.localization.verification import Verified

# Intercept and weights, fitted by benchmarks/calibrate_confidence.py.
_LOGISTIC = {
    Metric.HAMMING: np.array([-5.7, 2.2, -11.5, -0.85, -0.2]),
    Metric.EUCLIDEAN: np.array([-12.5, 3.15, -7.5, -1.55, -0.1]),
}
_REFERENCE_SIGMA_M = 0.05

MIN_CONFIDENCE = 0.6
"""Poses of lower confidence are not given out: of frames of other rooms, hardly one in a thousand comes so far."""


def confidence_inputs(verified: Sequence[Verified], covariance: FloatArray) -> FloatArray:
    """The four numbers (4,) that the logistic weighs, of frames verified together and the covariance (6, 6) asked for.

    log₂ of what speaks for the pose (nats), what speaks against it as a share of both, log₂ of the matches that chance
    would find, and log₂ of the position's greatest sigma over 5 cm where it is more.
    """
    seen = sum(one.support.seen for one in verified)
    missing = sum(one.support.missing for one in verified)
    sigma_m = math.sqrt(max(float(np.linalg.eigvalsh(covariance[:3, :3])[-1]), 1e-12))
    return np.array(
        [
            math.log2(1 + seen),
            missing / max(seen + missing, 1e-9),
            math.log2(1 + sum(one.by_chance for one in verified)),
            max(math.log2(sigma_m / _REFERENCE_SIGMA_M), 0.0),
        ]
    )


def confidence_of(verified: Verified, metric: Metric) -> float:
    """0..1, the probability that the pose is within 10 cm and 5°, for descriptors of one metric."""
    return joint_confidence((verified,), verified.covariance, metric)


def joint_confidence(verified: Sequence[Verified], covariance: FloatArray, metric: Metric) -> float:
    """As :func:`confidence_of`, of frames verified together; ``covariance`` (6, 6) is of the one asked for."""
    intercept, *weights = _LOGISTIC[metric]
    return float(expit(intercept + np.dot(weights, confidence_inputs(verified, covariance))))
