"""Confidence: the probability that a pose is within 10 cm and 5°.

A logistic in what verification found (:mod:`rholoc.localization.support`): what the picture says for the pose, in how
many of its parts, which share of the landmarks that it should show it does, how many matches of a wider search agree,
and how many chance alone would find; and how well the curvature fixes the position. What rivals the pose has is counted
apart (:mod:`rholoc.localization.rivals`), and so is another focal length (:mod:`rholoc.localization.focal`).
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
    Metric.HAMMING: np.array([-6.9, 1.3, 0.5, 0.45, 1.65, -1.05, -1.2]),
    Metric.EUCLIDEAN: np.array([-5.95, 1.4, 0.9, 0.95, 1.25, -2.25, -0.1]),
}
_REFERENCE_SIGMA_M = 0.2

MIN_CONFIDENCE = 0.5
"""Poses of lower confidence are not given out: what is as likely wrong as right helps nobody."""


def confidence_inputs(verified: Sequence[Verified], covariance: FloatArray) -> FloatArray:
    """The six numbers (6,) that the logistic weighs, of frames verified together and the covariance (6, 6) asked for.

    log₂ of what speaks for the pose (nats), of the share of landmarks found, of the matches that agree beyond chance in
    a wider search, of the parts of the picture that bear it out, and of the matches that chance would find; and log₂ of
    the position's greatest sigma over 20 cm where it is more.
    """
    supports = [one.support for one in verified]
    found, expected = sum(one.found for one in supports), sum(one.expected for one in supports)
    sigma_m = math.sqrt(max(float(np.linalg.eigvalsh(covariance[:3, :3])[-1]), 1e-12))
    return np.array(
        [
            math.log2(1 + sum(one.seen for one in supports)),
            math.log2((1 + found) / (1 + expected)),
            math.log2(1 + sum(one.beyond_chance for one in supports)),
            math.log2(1 + sum(one.parts for one in supports)),
            math.log2(1 + sum(one.by_chance for one in verified)),
            max(math.log2(sigma_m / _REFERENCE_SIGMA_M), 0.0),
        ]
    )


def confidence_of(verified: Verified, metric: Metric) -> float:
    """0..1, the probability that the pose is within 10 cm and 5°, for descriptors of one metric."""
    return joint_confidence((verified,), verified.covariance, metric)


def joint_confidence(verified: Sequence[Verified], covariance: FloatArray, metric: Metric) -> float:
    """As :func:`confidence_of`, of frames verified together; ``covariance`` (6, 6) is of the one asked for."""
    return logistic(confidence_inputs(verified, covariance), metric)


def logistic(inputs: FloatArray, metric: Metric) -> float:
    """0..1, what the numbers of :func:`confidence_inputs` come to."""
    intercept, *weights = _LOGISTIC[metric]
    return float(expit(intercept + np.dot(weights, inputs)))
