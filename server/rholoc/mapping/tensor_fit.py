"""A map's ``tensor`` densities: one for each place that a feature was seen from (locality, the paper's section 4)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rholoc.density.tensor import TensorDensities, fit_tensors
from rholoc.geometry import FloatArray, IntArray
from rholoc.maps import DensityKind, Map
from rholoc.progress import ProgressListener, Stage, silent

DEFAULT_DEGREE = 2
_SAME_PLACE_RAD = np.deg2rad(20.0)  # how far apart a place's views may see a feature from
_SAME_PLACE_RATIO = 1.7  # of their distances from it
_MAX_PLACES = 4  # a feature
_MIN_VIEWS = 2  # of every place but a feature's first
_MAX_DENSITIES = 20_000  # 6.5 kB each with degree 2
_RADIUS_SHARE = 0.6  # of the distance, at least: the fit is exact in the position, the headings are its limit
_MAX_RADIUS_SHARE = 0.95  # at most: a landmark must stay ahead
_RADIUS_MARGIN = 1.2  # times the distance of the views from the middle of their place
_CHUNK = 256


def fit_map_tensors(map_: Map, degree: int = DEFAULT_DEGREE, progress: ProgressListener = silent) -> Map:
    """The map, of ``ray`` densities, with ``tensor`` ones.

    A feature's views are gathered into places, from each of which it is seen from one side and from like distances;
    the observations enter by the landmark, their intersection. Where the densities would be too many, each feature
    keeps that of its first place, and of the others those of the most views.
    """
    positions = map_.view_positions[map_.observation_views]
    order = np.argsort(map_.observation_features, kind="stable")
    bounds = np.searchsorted(map_.observation_features[order], np.arange(len(map_) + 1))
    landmarks = map_.landmarks.astype(np.float64)
    features, places, radii, support = [], [], [], []
    for feature, landmark in enumerate(landmarks):
        seen_from = positions[order[bounds[feature] : bounds[feature + 1]]]
        for rank, members in enumerate(gather_places(landmark, seen_from)):
            place, radius_m = _place(landmark, seen_from[members])
            features.append(feature)
            places.append(place)
            radii.append(radius_m)
            support.append(len(members) if rank else len(positions))
    most = max(_MAX_DENSITIES, len(map_))
    kept = np.sort(np.argsort(-np.array(support, dtype=np.int64), kind="stable")[:most])
    owners = np.array(features, dtype=np.int64)[kept]
    # fitted to what is stored, so that a map read back is the one that was fitted
    places_ = np.array(places).reshape(-1, 3)[kept].astype(np.float32).astype(np.float64)
    radii_ = np.array(radii)[kept].astype(np.float32).astype(np.float64)
    coefficients = _fit(landmarks[owners], places_, radii_, degree, progress)
    tensors = TensorDensities(degree, coefficients, owners, landmarks[owners], places_, radii_)
    return replace(map_, info=replace(map_.info, density=DensityKind.TENSOR), fitted=tensors)


def gather_places(landmark: FloatArray, seen_from: FloatArray) -> list[IntArray]:
    """The views, rows of the positions ``seen_from`` (N, 3), of each place that a landmark (3,) was seen from.

    The place with most views first.
    """
    away = seen_from - landmark
    distance = np.linalg.norm(away, axis=1)
    unit = away / distance[:, None]
    alike = (unit @ unit.T >= np.cos(_SAME_PLACE_RAD)) & (
        np.abs(np.log(distance[:, None] / distance)) <= np.log(_SAME_PLACE_RATIO)
    )
    left = np.ones(len(seen_from), dtype=bool)
    places: list[IntArray] = []
    while left.any() and len(places) < _MAX_PLACES:
        counts = np.where(left, (alike & left).sum(axis=1), 0)
        members = np.flatnonzero(alike[int(np.argmax(counts))] & left)
        if places and len(members) < _MIN_VIEWS:
            break
        places.append(members)
        left[members] = False
    return places


def _place(landmark: FloatArray, positions: FloatArray) -> tuple[FloatArray, float]:
    """The middle (3,) of a place's views and the radius around it that its density is to be valid in."""
    middle = positions.mean(axis=0)
    distance = float(np.linalg.norm(landmark - middle))
    reach = _RADIUS_MARGIN * float(np.linalg.norm(positions - middle, axis=1).max())
    return middle, min(max(reach, _RADIUS_SHARE * distance), _MAX_RADIUS_SHARE * distance)


def _fit(
    landmarks: FloatArray, places: FloatArray, radii: FloatArray, degree: int, progress: ProgressListener
) -> FloatArray:
    count = len(landmarks)
    parts = []
    for start in range(0, max(count, 1), _CHUNK):
        rows = slice(start, start + _CHUNK)
        parts.append(fit_tensors(landmarks[rows], places[rows], radii[rows], degree).coefficients)
        progress(Stage.DENSITIES, min(1.0, (start + _CHUNK) / max(count, 1)), f"{count} densities")
    return np.concatenate(parts)
