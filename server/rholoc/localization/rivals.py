"""Rivals: other poses that a picture may show as well as the one found.

Two desks of a make, two doors in a corridor: whichever is found first looks right. A pose is only as sure as it is
better than the next best, so that one is looked for: among the matches that the pose leaves unexplained, and among
what its own matches might have been instead.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice

import numpy as np

from rholoc.geometry import FloatArray, pose_distances
from rholoc.localization.map_index import MapIndex
from rholoc.localization.matches import Matches, NearestLandmarks
from rholoc.localization.ransac import lo_ransac
from rholoc.localization.seeds import places_by_votes
from rholoc.localization.types import Query
from rholoc.localization.verification import Verified

RIVAL_PLACES = 2
"""How many places are looked at for rivals."""

_VIEWS_EACH = 10
_EXPLAINED_PX = 24.0
_TOLERANCE_PX = 12.0
_SAMPLES = (300, 30)
_FEWEST_AGREEING, _FEWEST_OF_FOUND = 8, 0.2  # matches; of the matches of the pose that was found
_APART_M, _APART_RAD = 0.2, np.deg2rad(10.0)
_TELLING_NATS = 12.0  # by which much more support one of two poses is twice as sure again; about a cell of the picture


def rival_seeds(
    index: MapIndex, nearest: NearestLandmarks, query: Query, rays: FloatArray, found: Verified
) -> Iterator[FloatArray]:
    """Poses (4, 4) that matches other than those of a pose agree with, the best place first."""
    looked_at = len(nearest) / max(len(query.features), 1)  # a share of the features
    fewest = fewest_agreeing(looked_at * found.inliers)
    for some in unexplained_by_place(index, nearest, query, found):
        if len(some) < fewest:
            continue
        landmarks = index.landmarks[some.landmarks]
        seed = lo_ransac(rays[some.detections], landmarks, query.camera.focal, _TOLERANCE_PX, *_SAMPLES)
        if seed is not None and seed[1] >= fewest:
            yield seed[0]


def fewest_agreeing(found: float) -> float:
    """How many matches must agree with a rival of a pose that so many were found to agree with."""
    return max(_FEWEST_AGREEING, _FEWEST_OF_FOUND * found)


def unexplained_by_place(
    index: MapIndex, nearest: NearestLandmarks, query: Query, found: Verified
) -> Iterator[Matches]:
    """What a picture is like and a pose does not bring together, place by place, the likeliest matches first."""
    pairs = _unexplained(index, nearest.pairs(), query, found)
    for place in islice(places_by_votes(index, pairs, _VIEWS_EACH), RIVAL_PLACES):
        there = np.zeros(len(index.map), dtype=bool)
        there[place.landmarks] = True
        yield pairs.take(np.flatnonzero(there[pairs.landmarks])).likeliest_first()


def _unexplained(index: MapIndex, pairs: Matches, query: Query, found: Verified) -> Matches:
    """The pairs that a pose does not bring together."""
    T = found.optimum.T_map_camera
    pixels = query.camera.project((index.landmarks[pairs.landmarks] - T[:3, 3]) @ T[:3, :3])
    off_px = np.linalg.norm(pixels - query.features.pixels[pairs.detections], axis=1)
    return pairs.take(np.flatnonzero(~(off_px <= _EXPLAINED_PX)))  # behind the camera it is NaN


def are_rivals(a: Verified, b: Verified) -> bool:
    """Whether two poses cannot both be right."""
    apart_m, turned_rad = pose_distances(a.optimum.T_map_camera, b.optimum.T_map_camera)
    return bool(apart_m > _APART_M or turned_rad > _APART_RAD)


def shares(places: FloatArray, nets: FloatArray) -> FloatArray:
    """How a frame's one true place is divided among M poses that exclude each other.

    Args:
        places: (M,) the probability that each is of the right place, were it the only one.
        nets: (M,) nats, what supports each.

    Returns:
        (M,) shares that add up to 1: of the probability of a pose they leave what its rivals do not take.
    """
    log_odds = np.log(np.maximum(places, 1e-12)) + nets / _TELLING_NATS
    weights = np.exp(log_odds - log_odds.max())
    return np.asarray(weights / weights.sum())
