"""Add the uncertainty that a frame's own covariance lacks, and withhold poses that are too doubtful or too inexact."""

from __future__ import annotations

from dataclasses import replace

from rholoc.geometry import FloatArray
from rholoc.localization.diagnosis import too_inexact
from rholoc.localization.index.map_error import (
    INDEPENDENT_SHARE,
    PLACE_M,
    PLACE_RAD,
    rms_position_error,
    widening_factor,
    worst_sigma,
)
from rholoc.localization.index.map_index import MapIndex
from rholoc.localization.types import MAX_ALTERNATIVES, MIN_WEIGHT, Alternative, Belief, Localization, Query, Reason

_VIEWS_HERE = 10  # views that saw most of an answer's inlier landmarks, and hence are near the pose
# How probably a pose is exact in a map that failed a check, beside one in a map that passed. Such maps differ: of sure
# answers in those of simulated walks nearly all were right, or hardly any.
_IN_UNTRUSTED_MAP = 0.8  # factor on ``exact``


def with_map_error(index: MapIndex, answer: Localization, spread: FloatArray | None = None) -> Localization:
    """Add the map's own error to the covariances and probabilities of an answer.

    In a map that failed a check, ``exact`` is multiplied by 0.8. Covariances are only changed for a pose in a metric
    map.

    Args:
        index: index of the map.
        answer: an answer that treats the map as exact.
        spread: (6, 6) second moment of other poses that the picture may show, by other focal lengths or of other modes,
            to add to the covariance: the answer's belief allows for them already. None without any.

    Returns:
        The answer relative to the real world, with ``expected_error_m`` if the map has covariances there.
    """
    trusted = index.trust.trusted
    belief = Belief(answer.belief.recognized, answer.belief.exact * (_IN_UNTRUSTED_MAP if trusted is False else 1.0))
    answer = replace(answer, map_trusted=trusted, belief=belief)
    if answer.pose is None or answer.covariance is None or not index.map.info.metric:
        return answer
    covariance = answer.covariance
    of_map = index.map_covariance(answer.inlier_features, answer.pose.position, _VIEWS_HERE)
    if of_map is not None:
        own = INDEPENDENT_SHARE * covariance
        covariance = own + of_map
        answer = replace(answer, belief=_lowered(belief, own, of_map), expected_error_m=rms_position_error(of_map))
    if spread is not None:
        covariance = covariance + spread
    alternatives = tuple(_alternative(index, one) for one in answer.alternatives)
    return replace(answer, covariance=covariance, alternatives=alternatives)


def _alternative(index: MapIndex, one: Alternative) -> Alternative:
    """The alternative with the map's error at its own place; unchanged if the map has no covariances there."""
    of_map = index.map_covariance(one.inlier_features, one.pose.position, _VIEWS_HERE)
    return one if of_map is None else replace(one, covariance=INDEPENDENT_SHARE * one.covariance + of_map)


def _lowered(belief: Belief, own: FloatArray, of_map: FloatArray) -> Belief:
    """The belief lowered by the ratios in which the map's covariance (6, 6), added to the pose's ``own``, lowers the
    probabilities of being within 50 cm and 20°, and within 10 cm and 5°.
    """
    here, exact = widening_factor(own, of_map, PLACE_M, PLACE_RAD), widening_factor(own, of_map)
    exact_if_here = min(exact / here, 1.0) if here > 0 else 0.0
    return Belief(belief.recognized * here, belief.exact * exact_if_here)


def gated(answer: Localization, min_recognized: float, query: Query) -> Localization:
    """Withhold the pose if the place is too doubtful, or the pose less exact than the query demands.

    Args:
        answer: an answer with or without a pose; one without is returned unchanged.
        min_recognized: minimum probability of the right place.
        query: its ``max_sigma_m`` and ``max_sigma_rad`` bound the standard deviations along the worst axes.

    Returns:
        The answer, or one that is not localized, with reason NOT_RECOGNIZED (the pose becomes its first alternative) or
        TOO_INEXACT (with a diagnosis).
    """
    if answer.pose is None or answer.covariance is None:
        return answer
    refused = replace(answer, localized=False, pose=None, covariance=None, expected_error_m=None)
    if answer.recognized < min_recognized:
        withheld = Alternative(answer.recognized, answer.pose, answer.covariance, answer.inlier_features)
        poses = (withheld, *answer.alternatives) if withheld.weight >= MIN_WEIGHT else answer.alternatives
        return replace(refused, reason=Reason.NOT_RECOGNIZED, alternatives=poses[:MAX_ALTERNATIVES])
    sigma_m, sigma_rad = worst_sigma(answer.covariance[:3, :3]), worst_sigma(answer.covariance[3:, 3:])
    if sigma_m <= query.max_sigma_m and sigma_rad <= query.max_sigma_rad:
        return answer
    diagnosis = too_inexact(sigma_m, sigma_rad, query.max_sigma_m, query.max_sigma_rad)
    return replace(refused, reason=Reason.TOO_INEXACT, diagnosis=diagnosis)
