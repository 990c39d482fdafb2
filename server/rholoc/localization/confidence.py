"""Confidence: the probability that a pose is within 10 cm and 5°.

That is the probability that it is the right place, times that of being that exact there. Of the former, a logistic in
what verification found (:mod:`rholoc.localization.support`): how surely its matches are not where they are by chance,
what they say for the pose, what speaks against it where other things are seen than should be, how many matches chance
alone would find, and, where both sides know them, how well matches agree in orientation and size and in their colours.
A light that the map has not seen may change what is bright and what is dark, so that colours that disagree do no more
than halve the odds. Of the latter, a logistic in how well the curvature fixes the position. What rivals the pose has is
counted apart (:mod:`rholoc.localization.rivals`), and so is another focal length (:mod:`rholoc.localization.focal`).
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
_TELLING_PATCH_NATS = (-0.5, 1.2)

MIN_CONFIDENCE = 0.5
"""Poses of lower confidence are not given out: what is as likely wrong as right helps nobody."""


@dataclass(frozen=True)
class Grounds:
    """What confidence weighs.

    Attributes:
        place: (4,) log₂ of the nats a match by which more are there than chance puts there, at most one; and log₂, each
            more by one, of the nats that matches say for the pose, of those that other things say against it, and of
            the matches that chance would find.
        colours: how well colours agree, 0 by chance, 1 at best; NaN where they are not known.
        patches: nats, what a match says by its orientation and size, from -½ to 1.2; NaN where they are not known.
        sigma: log₂ of the position's greatest sigma over 10 cm, from -2 to 1.
    """

    place: tuple[float, float, float, float]
    colours: float
    patches: float
    sigma: float

    @property
    def has_colours(self) -> bool:
        """Whether colours are known."""
        return not math.isnan(self.colours)

    @property
    def has_patches(self) -> bool:
        """Whether the orientations and sizes of matches are known."""
        return not math.isnan(self.patches)


@dataclass(frozen=True)
class Weights:
    """What each of the grounds weighs, intercepts first.

    Attributes:
        place: (5,) of the place alone, where neither colours nor patches are known.
        colours: (6,) of the place and the colours.
        patches: (6,) of the place and the patches; zeros for features that have neither orientation nor size.
        both: (7,) of the place, the patches, and the colours.
        exact: (2,) of the sigma.
    """

    place: tuple[float, ...]
    colours: tuple[float, ...]
    patches: tuple[float, ...]
    both: tuple[float, ...]
    exact: tuple[float, ...]


# Fitted by benchmarks/calibrate_confidence.py, the extractors of each metric together, but for those that find so much
# alike that the others' weights do not hold.
_BY_METRIC = {
    Metric.HAMMING: Weights(
        place=(-10.34, 0.64, 2.62, -0.65, -0.42),
        colours=(-8.83, 0.27, 2.08, -0.62, -0.5, 4.3),
        patches=(-7.25, 0.0, 1.52, -0.65, -0.38, 2.95),
        both=(-5.83, 0.0, 1.08, -0.6, -0.44, 2.58, 3.76),
        exact=(3.15, -1.95),
    ),
    Metric.EUCLIDEAN: Weights(
        place=(-10.8, 1.95, 2.93, -0.59, -0.84),
        colours=(-8.9, 1.69, 2.31, -0.58, -0.97, 4.08),
        patches=(-5.14, 1.42, 1.37, -0.79, -0.53, 3.31),
        both=(-4.59, 1.36, 1.13, -0.76, -0.62, 3.02, 2.5),
        exact=(2.89, -2.02),
    ),
}
_OWN = {
    "lab": Weights(
        place=(-6.43, 0.39, 1.56, -0.48, -0.1),
        colours=(-4.55, 0.24, 1.05, -0.39, -0.33, 4.44),
        patches=(-5.36, 0.1, 1.23, -0.52, -0.16, 1.18),
        both=(-4.05, 0.06, 0.89, -0.41, -0.36, 0.75, 4.08),
        exact=(2.64, -2.48),
    ),
    "xfeat": Weights(
        place=(-8.59, 0.44, 2.4, -0.75, -1.13),
        colours=(-6.66, 0.0, 1.7, -0.89, -1.39, 5.91),
        patches=(0.0,) * 6,
        both=(0.0,) * 7,
        exact=(0.47, -1.54),
    ),
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
    by_chance, inliers = sum(one.by_chance for one in verified), sum(one.inliers for one in verified)
    sigma_m = math.sqrt(max(float(np.linalg.eigvalsh(covariance[:3, :3])[-1]), 1e-12))
    place = (
        min(math.log2((1 + sum(one.beyond_chance for one in supports)) / (1 + inliers)), 0.0),
        math.log2(1 + sum(one.seen for one in supports)),
        math.log2(1 + sum(one.missing for one in supports)),
        math.log2(1 + by_chance),
    )
    octaves = math.log2(sigma_m / _REFERENCE_SIGMA_M)
    colours = _mean_known(supports, [one.colours for one in supports])
    patches = float(np.clip(_mean_known(supports, [one.patches for one in supports]), *_TELLING_PATCH_NATS))
    return Grounds(place, colours, patches, float(np.clip(octaves, *_TELLING_OCTAVES)))


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
    known: tuple[float, ...] = grounds.place
    alone, by_colours = weights.place, weights.colours
    if grounds.has_patches:
        known, alone, by_colours = (*grounds.place, grounds.patches), weights.patches, weights.both
    without = _weighed(known, alone)
    if not grounds.has_colours:
        return without
    return max(_weighed((*known, grounds.colours), by_colours), without - _MOST_AGAINST)


def _weighed(inputs: tuple[float, ...], weights: tuple[float, ...]) -> float:
    intercept, *slopes = weights
    return float(intercept + np.dot(slopes, inputs))


def _mean_known(supports: Sequence[Support], values: Sequence[float]) -> float:
    """The mean of the values that are known, by what each frame shows of the map."""
    known = [(one.found, value) for one, value in zip(supports, values, strict=True) if not math.isnan(value)]
    found = sum(weight for weight, _ in known)
    return sum(weight * value for weight, value in known) / found if found else math.nan
