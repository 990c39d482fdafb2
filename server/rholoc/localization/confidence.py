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


# Fitted by benchmarks/calibrate_confidence.py, to the answers of each; how exact they are, to those of all but xfeat's.
_EXACT = (2.82, -1.6)
_FITTED = {
    "gray": Weights(
        place=(-1.67, 0.97, 1.4, -0.12, -0.09, 1.35),
        colours=(-0.09, 0.9, 1.02, -0.14, -0.14, 1.39, 2.56),
        exact=_EXACT,
        patches=(0.4, 0.51, 0.49, -0.18, -0.03, 1.21, 2.68),
        both=(0.56, 0.53, 0.33, -0.19, -0.03, 1.14, 2.59, 1.65),
    ),
    "lab": Weights(
        place=(-3.91, 0.74, 1.76, -0.58, -0.16, 0.65),
        colours=(-4.22, 0.56, 1.52, -0.57, -0.24, 0.5, 3.51),
        exact=_EXACT,
        patches=(-3.31, 0.41, 1.08, -0.76, -0.19, 0.2, 2.88),
        both=(-3.95, 0.27, 0.95, -0.73, -0.24, 0.05, 2.74, 2.84),
    ),
    "lab3": Weights(
        place=(-3.51, 0.6, 1.78, -0.44, -0.18, 0.95),
        colours=(-2.49, 0.32, 1.46, -0.47, -0.29, 0.97, 3.37),
        exact=_EXACT,
        patches=(-1.49, 0.11, 0.87, -0.5, -0.15, 0.88, 3.12),
        both=(-1.22, 0.07, 0.72, -0.49, -0.23, 0.82, 2.89, 2.44),
    ),
    "rgb": Weights(
        place=(-2.5, 1.24, 1.6, -0.37, -0.03, 1.13),
        colours=(1.64, 1.48, 0.95, -0.41, -0.07, 1.62, 3.5),
        exact=_EXACT,
        patches=(0.26, 1.03, 0.69, -0.48, -0.03, 1.24, 2.98),
        both=(0.25, 1.2, 0.59, -0.48, -0.03, 1.23, 2.66, 2.18),
    ),
    "sift": Weights(
        place=(-1.92, 1.72, 1.65, -0.33, -0.29, 1.23),
        colours=(-1.87, 1.6, 1.11, -0.39, -0.36, 0.96, 5.44),
        exact=_EXACT,
        patches=(1.18, 1.43, 0.57, -0.74, -0.06, 0.97, 3.13),
        both=(0.54, 1.44, 0.42, -0.72, -0.15, 0.8, 2.66, 3.6),
    ),
    "sift48": Weights(
        place=(-3.43, 2.18, 2.0, -0.04, -0.94, 1.05),
        colours=(-3.32, 2.08, 1.62, -0.04, -1.09, 0.84, 4.06),
        exact=_EXACT,
        patches=(-0.92, 2.14, 0.78, -0.29, -0.46, 0.65, 3.33),
        both=(-1.1, 2.11, 0.61, -0.21, -0.62, 0.56, 3.07, 2.94),
    ),
    "xfeat": Weights(
        place=(2.76, 0.79, 1.08, -0.83, -0.67, 1.46),
        colours=(2.12, 0.43, 0.62, -0.84, -0.87, 1.27, 6.56),
        exact=(1.1, -1.77),
    ),
}
_MOST_LIKE = {Metric.HAMMING: "lab3", Metric.EUCLIDEAN: "sift48"}  # of extractors that nothing was fitted to


def weights_for(extractor: str) -> Weights:
    """What the grounds weigh for features of an extractor, by its name."""
    return _FITTED.get(extractor) or _FITTED[_MOST_LIKE[get_extractor(extractor).metric]]


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
