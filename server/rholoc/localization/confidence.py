"""Confidence: the probability that a pose is within 10 cm and 5°.

That is the probability that it is the right place, times that of being that exact there. Of the former, a logistic in
what verification found (:mod:`rholoc.localization.support`): which share of the landmarks that it should show a picture
shows, how surely they are not there by chance, in how many of its parts, how many matches chance alone would find, and
how well the matches' colours agree; where colours are not known, another one without them. A light that the map has not
seen may change what is bright and what is dark, so that colours that disagree do no more than halve the odds. Of the
latter, a logistic in how well the curvature fixes the position. What rivals the pose has is counted apart
(:mod:`rholoc.localization.rivals`), and so is another focal length (:mod:`rholoc.localization.focal`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import expit

from rholoc.features import Metric, get_extractor
from rholoc.geometry import FloatArray
from rholoc.localization.support import Support
from rholoc.localization.verification import Verified

_REFERENCE_SIGMA_M = 0.1
_MOST_AGAINST = math.log(2)  # of the log odds: what colours that disagree cost
_TELLING_OCTAVES = (-2.0, 1.0)  # of the sigma over the reference: beyond that it says no more

MIN_CONFIDENCE = 0.5
"""Poses of lower confidence are not given out: what is as likely wrong as right helps nobody."""


@dataclass(frozen=True)
class Grounds:
    """What confidence weighs.

    Attributes:
        place: (4,) log₂ of the share of landmarks found, of the nats by which they are more than chance puts there, of
            the parts of the picture that bear the pose out, and of the matches that chance would find.
        colours: how well colours agree, 0 by chance, 1 at best; NaN where they are not known.
        sigma: log₂ of the position's greatest sigma over 10 cm, from -2 to 1.
    """

    place: tuple[float, float, float, float]
    colours: float
    sigma: float

    @property
    def has_colours(self) -> bool:
        """Whether colours are known."""
        return not math.isnan(self.colours)


@dataclass(frozen=True)
class Weights:
    """What each of the grounds weighs, intercepts first.

    Attributes:
        by_colours: (6,) of the place and the colours.
        without: (5,) of the place, where colours are not known.
        exact: (2,) of the sigma.
    """

    by_colours: tuple[float, ...]
    without: tuple[float, ...]
    exact: tuple[float, ...]


# Fitted by benchmarks/calibrate_confidence.py, the extractors of each metric together, but for those that find so much
# alike that the others' weights do not hold.
_BY_METRIC = {
    Metric.HAMMING: Weights((-0.5, 1.09, 0.26, 1.74, -0.79, 3.87), (-1.02, 1.15, 0.51, 2.07, -0.82), (3.15, -1.95)),
    Metric.EUCLIDEAN: Weights((-1.07, 1.11, 0.94, 1.23, -1.58, 4.02), (-1.67, 1.21, 1.19, 1.7, -1.52), (2.89, -2.02)),
}
_OWN = {
    "lab": Weights((-1.25, 0.52, 0.09, 1.18, -0.57, 4.87), (-2.41, 0.58, 0.29, 1.86, -0.5), (2.64, -2.48)),
    "xfeat": Weights((3.49, 1.75, 0.05, 0.56, -1.15, 4.95), (3.45, 1.9, 0.38, 0.93, -1.14), (0.47, -1.54)),
}


def has_own_weights(extractor: str) -> bool:
    """Whether an extractor, by its name, is fitted apart from the others of its metric."""
    return extractor in _OWN


def weights_for(extractor: str) -> Weights:
    """What the grounds weigh for features of an extractor, by its name."""
    return _OWN.get(extractor) or _BY_METRIC[get_extractor(extractor).metric]


def grounds_of(verified: Sequence[Verified], covariance: FloatArray) -> Grounds:
    """What confidence weighs, of frames verified together and the covariance (6, 6) of the one asked for."""
    supports = [one.support for one in verified]
    found, expected = sum(one.found for one in supports), sum(one.expected for one in supports)
    sigma_m = math.sqrt(max(float(np.linalg.eigvalsh(covariance[:3, :3])[-1]), 1e-12))
    place = (
        math.log2((1 + found) / (1 + expected)),
        math.log2(1 + sum(one.beyond_chance for one in supports)),
        math.log2(1 + sum(one.parts for one in supports)),
        math.log2(1 + sum(one.by_chance for one in verified)),
    )
    octaves = math.log2(sigma_m / _REFERENCE_SIGMA_M)
    return Grounds(place, _mean_colours(supports), float(np.clip(octaves, *_TELLING_OCTAVES)))


def confidence_of(verified: Verified, weights: Weights) -> float:
    """0..1, the probability that the pose is within 10 cm and 5°."""
    return joint_confidence((verified,), verified.covariance, weights)


def joint_confidence(verified: Sequence[Verified], covariance: FloatArray, weights: Weights) -> float:
    """As :func:`confidence_of`, of frames verified together; ``covariance`` (6, 6) is of the one asked for."""
    return probability(grounds_of(verified, covariance), weights)


def probability(grounds: Grounds, weights: Weights) -> float:
    """0..1, what they come to."""
    return float(expit(_place_logit(grounds, weights)) * expit(_weighed((grounds.sigma,), weights.exact)))


def _place_logit(grounds: Grounds, weights: Weights) -> float:
    """Of the probability that it is the right place."""
    without = _weighed(grounds.place, weights.without)
    if not grounds.has_colours:
        return without
    return max(_weighed((*grounds.place, grounds.colours), weights.by_colours), without - _MOST_AGAINST)


def _weighed(inputs: tuple[float, ...], weights: tuple[float, ...]) -> float:
    intercept, *slopes = weights
    return float(intercept + np.dot(slopes, inputs))


def _mean_colours(supports: Sequence[Support]) -> float:
    """How well colours agree in the frames where they are known, by what each shows of the map."""
    known = [one for one in supports if not math.isnan(one.colours)]
    found = sum(one.found for one in known)
    return sum(one.found * one.colours for one in known) / found if found else math.nan
