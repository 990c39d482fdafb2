"""Confidence: the probability that a pose is within 10 cm and 5°.

That is the probability that it is the right place, times that of being that exact there. Of the former, a logistic in
what verification found (:mod:`rholoc.localization.support`): how surely its matches are not where they are by chance,
what they say for the pose, what speaks against it where other things are seen than should be, how many matches chance
alone would find, which share of the landmarks there is found, and, where both sides know them, how well matches agree
in orientation and size and in their colours. A light that the map has not seen may change what is bright and what is
dark, so that colours that disagree do no more than halve the odds. Of the latter, a logistic in how well the curvature
fixes the position. What rivals the pose has is counted apart (:mod:`rholoc.localization.rivals`), and so is another
focal length (:mod:`rholoc.localization.focal`).
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
        place: (5,) log₂ of the nats a match by which more are there than chance puts there, at most one; log₂, each
            more by one, of the nats that matches say for the pose, of those that other things say against it, and of
            the matches that chance would find; and log₂ of the share of landmarks found.
        colours: how well colours agree, 0 by chance, 1 at best; NaN where they are not known.
        patches: nats, what a match says by its orientation and size, from -½ to 1.2; NaN where they are not known.
        sigma: log₂ of the position's greatest sigma over 10 cm, from -2 to 1.
    """

    place: tuple[float, float, float, float, float]
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
        place: (6,) of the place alone, where neither colours nor patches are known.
        colours: (7,) of the place and the colours.
        exact: (2,) of the sigma.
        patches: (7,) of the place and the patches; none for features that have neither orientation nor size.
        both: (8,) of the place, the patches, and the colours; likewise.
    """

    place: tuple[float, ...]
    colours: tuple[float, ...]
    exact: tuple[float, ...]
    patches: tuple[float, ...] = ()
    both: tuple[float, ...] = ()


# Fitted by benchmarks/calibrate_confidence.py, the extractors of each metric together, but for those that find so much
# alike that the others' weights do not hold.
_BY_METRIC = {
    Metric.HAMMING: Weights(
        place=(-4.37, 0.42, 1.95, -0.4, -0.46, 0.89),
        colours=(-3.37, 0.15, 1.48, -0.42, -0.53, 0.81, 4.01),
        patches=(-1.89, 0.0, 1.02, -0.43, -0.45, 0.85, 2.68),
        both=(-1.58, 0.0, 0.75, -0.42, -0.49, 0.71, 2.36, 3.14),
        exact=(3.15, -1.95),
    ),
    Metric.EUCLIDEAN: Weights(
        place=(-4.84, 1.67, 2.28, -0.25, -0.87, 1.1),
        colours=(-3.98, 1.46, 1.83, -0.29, -0.99, 0.95, 3.52),
        patches=(-1.2, 1.23, 1.01, -0.55, -0.59, 0.81, 3.07),
        both=(-1.08, 1.18, 0.85, -0.55, -0.66, 0.73, 2.86, 2.03),
        exact=(2.89, -2.02),
    ),
}
_OWN = {
    "lab": Weights(
        place=(-4.81, 0.31, 1.38, -0.43, -0.13, 0.27),
        colours=(-3.35, 0.17, 0.93, -0.34, -0.35, 0.22, 4.4),
        patches=(-4.97, 0.1, 1.2, -0.51, -0.17, 0.08, 1.1),
        both=(-3.57, 0.05, 0.86, -0.39, -0.37, 0.1, 0.64, 4.11),
        exact=(2.64, -2.48),
    ),
    "xfeat": Weights(
        place=(1.28, 0.29, 1.34, -0.75, -1.12, 1.57),
        colours=(1.64, 0.0, 0.87, -0.85, -1.31, 1.34, 5.18),
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
    found, expected = sum(one.found for one in supports), sum(one.expected for one in supports)
    by_chance, inliers = sum(one.by_chance for one in verified), sum(one.inliers for one in verified)
    sigma_m = math.sqrt(max(float(np.linalg.eigvalsh(covariance[:3, :3])[-1]), 1e-12))
    place = (
        min(math.log2((1 + sum(one.beyond_chance for one in supports)) / (1 + inliers)), 0.0),
        math.log2(1 + sum(one.seen for one in supports)),
        math.log2(1 + sum(one.missing for one in supports)),
        math.log2(1 + by_chance),
        math.log2((1 + found) / (1 + expected)),
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
    if grounds.has_patches and weights.patches:
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
