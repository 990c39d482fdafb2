"""Add to an answer the uncertainty that a frame's own covariance lacks: the map's own error, and other poses."""

from dataclasses import replace

from rholoc.geometry import FloatArray
from rholoc.localization.index.map_error import (
    INDEPENDENT_SHARE,
    PLACE_M,
    PLACE_RAD,
    rms_position_error,
    widening_factor,
)
from rholoc.localization.index.map_index import MapIndex
from rholoc.localization.types import Alternative, Belief, Localization

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
