"""Confidence: the probability that a pose is within 10 cm and 5°.

A logistic in what verification found: how much likelier the matches are than by chance (the density's own value at
the optimum), how many matches chance alone would have found there, and how well the curvature fixes the position.
"""

from __future__ import annotations

import math

import numpy as np

from rholoc.features import Metric
from rholoc.geometry import FloatArray
from rholoc.localization.verification import Verified

# Intercept and weights, fitted by benchmarks/calibrate_confidence.py.
_LOGISTIC = {
    Metric.HAMMING: np.array([-10.31, 4.01, -3.08, -1.67]),
    Metric.EUCLIDEAN: np.array([-10.9, 3.14, -2.07, -0.37]),
}
_REFERENCE_SIGMA_M = 0.05

MIN_CONFIDENCE = 0.7
"""Poses of lower confidence are not given out: what refuses 99 % of other rooms' frames and hardly a good answer."""


def confidence_inputs(verified: Verified) -> FloatArray:
    """The three numbers (3,) that the logistic weighs.

    log₂ of the optimum's value (nats), log₂ of the matches that chance would find, and log₂ of the position's
    greatest sigma over 5 cm where it is more.
    """
    sigma_m = math.sqrt(max(float(np.linalg.eigvalsh(verified.covariance[:3, :3])[-1]), 1e-12))
    return np.array(
        [
            math.log2(1 + verified.optimum.value),
            math.log2(1 + verified.by_chance),
            max(math.log2(sigma_m / _REFERENCE_SIGMA_M), 0.0),
        ]
    )


def confidence_of(verified: Verified, metric: Metric) -> float:
    """0..1, the probability that the pose is within 10 cm and 5°, for descriptors of one metric."""
    intercept, *weights = _LOGISTIC[metric]
    score = intercept + float(np.dot(weights, confidence_inputs(verified)))
    return 1 / (1 + math.exp(-float(np.clip(score, -50, 50))))
