"""How surely a pose is right: that it is the right place, and that it is exact there.

``recognized`` is the probability that a pose is of the right place (within 50 cm and 20°), ``exact`` the probability
that it is within 10 cm and 5° if so; ``confidence`` is their product. Both are logistics, with the same weights for
every extractor. ``recognized`` depends on the evidence for the pose (:mod:`rholoc.localization.pose.pose_evidence`):
the log-likelihood ratio of the matches' clustering against chance, the nats in favour of the pose, the share of the
expected landmarks that is found, and, if known, the agreement of the matches in orientation and size, and in colour.
Other light than in the map may change colours, so disagreeing colours halve the odds at most. ``exact`` depends on the
position's standard deviation.

Missing landmarks only count through that share: from one or two metres away, four of five are not found again, and a
model with further terms for them predicts unseen rooms no better. Among several places they still decide which is
likelier (:mod:`rholoc.localization.pose.rivals`). The focal length is a separate factor
(:mod:`rholoc.localization.pose.focal`).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import expit

from rholoc.geometry import FloatArray
from rholoc.localization.index.map_error import INDEPENDENT_SHARE, PLACE_M, PLACE_RAD, probability_right, worst_sigma
from rholoc.localization.pose.pose_evidence import Support
from rholoc.localization.pose.rematching import Verified
from rholoc.localization.types import Belief

_MIN_SIGMA_M = 1e-6
_REFERENCE_SIGMA_M = 0.1
_MAX_AGAINST = math.log(2)  # of the log odds: what colours that disagree cost
_SIGMA_OCTAVES = (-2.0, 1.0)  # over the reference: a sigma beyond says no more
_PATCH_NATS = (-0.5, 1.2)

MIN_RECOGNIZED = 0.6
"""Poses that are less probably of the right place are withheld: each of two places that look alike has a half."""


@dataclass(frozen=True)
class ConfidenceFeatures:
    """Inputs of the confidence model: the evidence for a pose.

    Attributes:
        place: (3,) log₂ of the nats per match by which the matches exceed chance, at most zero; log₂ of one plus the
            nats in favour of the pose; log₂ of the share of the expected landmarks that was found.
        colours: agreement of colours, from 0 (chance) to 1; NaN if unknown.
        patches: agreement of orientation and size [nats per match], from -½ to 1.2; NaN if unknown.
        sigma: log₂ of the largest standard deviation of the position over 10 cm, from -2 to 1.
    """

    place: tuple[float, float, float]
    colours: float
    patches: float
    sigma: float

    @property
    def has_colours(self) -> bool:
        """Whether the agreement of colours is known."""
        return not math.isnan(self.colours)

    @property
    def has_patches(self) -> bool:
        """Whether the agreement of orientations and sizes is known."""
        return not math.isnan(self.patches)


@dataclass(frozen=True)
class Weights:
    """Weights of the confidence model; each tuple begins with the intercept.

    Attributes:
        place: (4,) of ``place`` alone, if neither colours nor patches are known.
        colours: (5,) of ``place`` and the colours.
        patches: (5,) of ``place`` and the patches.
        both: (6,) of ``place``, the patches and the colours.
        exact: (2,) of ``sigma``.
    """

    place: tuple[float, ...]
    colours: tuple[float, ...]
    patches: tuple[float, ...]
    both: tuple[float, ...]
    exact: tuple[float, ...]


# Fitted as benchmarks/calibrate_confidence.py does: the place to answers of sift48 and lab3 in the kitchen, the bedroom
# and the living room. Exactness: to those of lab3 in the kitchen, the bedroom and the living room and of sift48 in all
# rooms; of the fits with one recording held back, the one with the lowest probabilities.
WEIGHTS = Weights(
    place=(-6.18, 1.39, 2.57, 1.62),
    colours=(-4.95, 0.98, 1.99, 1.63, 5.1),
    patches=(-2.35, 0.44, 0.87, 0.94, 4.42),
    both=(-2.15, 0.31, 0.7, 0.95, 4.16, 2.47),
    exact=(3.78, -1.26),
)


def confidence_features(verified: Sequence[Verified], covariance: FloatArray) -> ConfidenceFeatures:
    """Confidence features of jointly verified frames.

    Args:
        verified: evidence for each frame's pose; counts and nats are summed over frames.
        covariance: (6, 6) of the pose to answer, position [m] first.
    """
    supports = [one.support for one in verified]
    found, expected = sum(one.found for one in supports), sum(one.expected for one in supports)
    inliers = sum(one.inliers for one in verified)
    sigma_m = max(worst_sigma(covariance[:3, :3]), _MIN_SIGMA_M)
    place = (
        min(math.log2((1 + sum(one.beyond_chance for one in supports)) / (1 + inliers)), 0.0),
        math.log2(1 + sum(one.seen for one in supports)),
        math.log2((1 + found) / (1 + expected)),
    )
    octaves = math.log2(sigma_m / _REFERENCE_SIGMA_M)
    colours = _mean_known(supports, [one.colours for one in supports])
    patches = float(np.clip(_mean_known(supports, [one.patches for one in supports]), *_PATCH_NATS))
    return ConfidenceFeatures(place, colours, patches, float(np.clip(octaves, *_SIGMA_OCTAVES)))


def belief_of(verified: Verified) -> Belief:
    """Belief in one verified pose, before rivals and doubts about the focal length lower it."""
    return joint_belief((verified,), verified.covariance)


def joint_belief(verified: Sequence[Verified], covariance: FloatArray) -> Belief:
    """Belief in a pose from jointly verified frames.

    ``covariance`` (6, 6) is of the frame to answer. ``recognized`` is multiplied by the probability that this
    covariance, without the errors that landmarks share, leaves the pose within 50 cm and 20°: it falls as the standard
    deviation nears half a metre.
    """
    belief = belief_by(confidence_features(verified, covariance))
    known = probability_right(INDEPENDENT_SHARE * covariance, PLACE_M, PLACE_RAD)
    return Belief(belief.recognized * known, belief.exact)


def belief_by(features: ConfidenceFeatures, weights: Weights = WEIGHTS) -> Belief:
    """Evaluate the confidence model: features → probabilities of the right place and, there, of an exact pose."""
    exact = float(expit(_weighed((features.sigma,), weights.exact)))
    return Belief(float(expit(_place_logit(features, weights))), exact)


def _place_logit(features: ConfidenceFeatures, weights: Weights) -> float:
    """Log odds that the place is right, with the weights for those of colours and patches that are known. Colours lower
    them by at most log 2 against the odds without colours.
    """
    known: tuple[float, ...] = features.place
    alone, by_colours = weights.place, weights.colours
    if features.has_patches:
        known, alone, by_colours = (*features.place, features.patches), weights.patches, weights.both
    without = _weighed(known, alone)
    if not features.has_colours:
        return without
    return max(_weighed((*known, features.colours), by_colours), without - _MAX_AGAINST)


def _weighed(inputs: tuple[float, ...], weights: tuple[float, ...]) -> float:
    """The first weight plus the products of the inputs with the others."""
    intercept, *slopes = weights
    return float(intercept + np.dot(slopes, inputs))


def _mean_known(supports: Sequence[Support], values: Sequence[float]) -> float:
    """Mean of the values that are not NaN, weighted by each frame's number of found landmarks; NaN if none is known."""
    known = [(one.found, value) for one, value in zip(supports, values, strict=True) if not math.isnan(value)]
    found = sum(weight for weight, _ in known)
    return sum(weight * value for weight, value in known) / found if found else math.nan
