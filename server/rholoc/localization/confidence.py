"""Confidence: the probability that a pose is within 10 cm and 5°.

A logistic in what verification found: how many matches agree, which share of those nearby, which share of the
landmarks that should be in view, and how well the curvature fixes the position.
"""

from __future__ import annotations

import math

import numpy as np

from rholoc.geometry import FloatArray
from rholoc.localization.verification import Verified

# Fitted by benchmarks/calibrate_confidence.py.
_INTERCEPT = -11.0
_PER_LOG2_INLIERS = 1.6
_PER_AGREEMENT = 6.0
_PER_LOG2_SIGMA = -0.3
_REFERENCE_SIGMA_M = 0.05


def confidence_inputs(verified: Verified, covariance: FloatArray) -> FloatArray:
    """The three numbers (3,) that the logistic weighs: log₂ inliers, agreement, log₂ of the position's sigma / 5 cm."""
    sigma_m = math.sqrt(max(float(np.linalg.eigvalsh(covariance[:3, :3])[-1]), 1e-12))
    return np.array(
        [math.log2(1 + verified.inliers), verified.agreement, max(math.log2(sigma_m / _REFERENCE_SIGMA_M), 0.0)]
    )


def confidence_of(verified: Verified, covariance: FloatArray) -> float:
    """0..1, the probability that the pose is within 10 cm and 5°."""
    weights = np.array([_PER_LOG2_INLIERS, _PER_AGREEMENT, _PER_LOG2_SIGMA])
    score = _INTERCEPT + float(weights @ confidence_inputs(verified, covariance))
    return 1 / (1 + math.exp(-float(np.clip(score, -50, 50))))
