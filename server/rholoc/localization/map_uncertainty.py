"""An answer as the map makes it: with the map's own uncertainty in its covariance and its confidence."""

from __future__ import annotations

from dataclasses import replace

from rholoc.localization.map_error import rms_position_error, trust_in_map
from rholoc.localization.map_index import MapIndex
from rholoc.localization.types import Localization

_VIEWS_HERE = 10  # the views that saw most of what an answer rests on: from hereabouts
# A frame's own covariance allows, threefold, for what it cannot see: neighbouring landmarks err together. Most of that
# is the map's own error; where that is counted apart, the factor three goes, and a little more: in simulated maps of
# exact poses 1/22 of the variance covers 95 % of the errors, in those of estimated poses 1/16.
_LEFT_OF_OWN = 1 / 16
# How much of a confidence is left in a map that failed a check. Such maps differ: of sure answers in those of simulated
# walks nearly all were right, or hardly any.
_IN_UNTRUSTED_MAP = 0.8


def with_map_error(index: MapIndex, answer: Localization) -> Localization:
    """The answer, which supposes that the map is exact, in the map as it is.

    Whether it is given out was settled before: that asks whether the place was recognised. Here the confidence becomes
    the probability that the pose is right in the world, and falls with the map's own uncertainty.
    """
    trusted = index.trust.trusted
    answer = replace(answer, map_trusted=trusted)
    confidence = answer.confidence * (_IN_UNTRUSTED_MAP if trusted is False else 1.0)
    if answer.pose is None or answer.covariance is None or not index.map.info.metric:
        return replace(answer, confidence=confidence)
    of_map = index.map_covariance(answer.inlier_features, answer.pose.position, _VIEWS_HERE)
    if of_map is None:
        return replace(answer, confidence=confidence)
    own = _LEFT_OF_OWN * answer.covariance
    return replace(
        answer,
        covariance=own + of_map,
        confidence=confidence * trust_in_map(own, of_map),
        expected_error_m=rms_position_error(of_map),
    )
