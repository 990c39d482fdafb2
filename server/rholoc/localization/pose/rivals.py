"""Rivals: other poses that the picture may show equally well.

Two identical desks, two doors in a corridor: whichever is found first looks right. A pose is believed only as far as it
is better than the best alternative, which is searched for among the matches that the pose leaves unexplained, and
among the other landmarks that its own features resemble.
"""

from collections.abc import Iterator
from itertools import islice

import numpy as np

from rholoc.geometry import FloatArray
from rholoc.localization.index.map_error import PLACE_M, PLACE_RAD
from rholoc.localization.index.map_index import MapIndex
from rholoc.localization.index.matches import Matches, NearestLandmarks
from rholoc.localization.pose.ransac import credible_pose
from rholoc.localization.pose.rematching import Verified
from rholoc.localization.pose.seeds import places_by_votes
from rholoc.localization.types import Query

RIVAL_PLACES = 2
"""How many places are looked at for rivals."""

_VIEWS_EACH = 10
_EXPLAINED_PX = 24.0
_TOLERANCE_PX = 12.0
_SAMPLES = (300, 30)
_MIN_AGREEING, _MIN_OF_FOUND = 8, 0.2  # matches; of the matches of the pose that was found
_TELLING_NATS = 12.0  # lead in net evidence that multiplies the odds of two poses by e; about a cell of the picture


def rival_seeds(index: MapIndex, nearest: NearestLandmarks, query: Query, found: Verified) -> Iterator[FloatArray]:
    """Iterate over poses (4, 4) that unexplained matches agree with, at most one for each of ``RIVAL_PLACES`` places,
    most voted place first.

    Args:
        index: index of the map.
        nearest: nearest landmarks of the query's features.
        query: the frame.
        found: the pose for which rivals are sought.
    """
    looked_at = len(nearest) / max(len(query.features), 1)  # a share of the features
    fewest = fewest_agreeing(looked_at * found.inliers)
    for some in unexplained_by_place(index, nearest, query, found):
        if len(some) < fewest:
            continue
        seed = credible_pose(index, query, some, _TOLERANCE_PX, _SAMPLES)
        if seed is not None and seed[1] >= fewest:
            yield seed[0]


def fewest_agreeing(found: float) -> float:
    """Minimum number of inliers of a rival of a pose with ``found`` inliers: a fifth of them, at least eight."""
    return max(_MIN_AGREEING, _MIN_OF_FOUND * found)


def unexplained_by_place(
    index: MapIndex, nearest: NearestLandmarks, query: Query, found: Verified
) -> Iterator[Matches]:
    """Iterate over the ``RIVAL_PLACES`` most voted places; yield the matches there that the pose ``found`` does not
    explain, likeliest first.
    """
    pairs = _unexplained(index, nearest.pairs(), query, found)
    for place in islice(places_by_votes(index, pairs, _VIEWS_EACH), RIVAL_PLACES):
        there = np.zeros(len(index.map), dtype=bool)
        there[place.landmarks] = True
        yield pairs.take(np.flatnonzero(there[pairs.landmarks])).likeliest_first()


def _unexplained(index: MapIndex, pairs: Matches, query: Query, found: Verified) -> Matches:
    """Those of ``pairs`` whose landmark projects at least 24 px from its feature, or is behind the camera."""
    T = found.optimum.T_map_camera
    pixels = query.camera.project((index.landmarks[pairs.landmarks] - T[:3, 3]) @ T[:3, :3])
    off_px = np.linalg.norm(pixels - query.features.pixels[pairs.detections], axis=1)
    return pairs.take(np.flatnonzero(~(off_px <= _EXPLAINED_PX)))  # behind the camera it is NaN


def are_rivals(a: Verified, b: Verified) -> bool:
    """Whether two poses are of two places, more than ``PLACE_M`` or ``PLACE_RAD`` apart, and so exclude each other."""
    return a.is_apart(b, PLACE_M, PLACE_RAD)


def shares(places: FloatArray, nets: FloatArray) -> FloatArray:
    """Split the probability of one true place among M mutually exclusive poses.

    Args:
        places: (M,) probability that each is of the right place, if it were the only one.
        nets: (M,) net evidence for each [nats]; a lead of 12 nats multiplies the odds by e.

    Returns:
        (M,) factors that add up to 1: the part of each pose's probability that its rivals leave.
    """
    log_odds = np.log(np.maximum(places, 1e-12)) + nets / _TELLING_NATS
    weights = np.exp(log_odds - log_odds.max())
    return np.asarray(weights / weights.sum())
