"""The map as localization needs it: descriptors to search, landmarks to project, places to vote for."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from rholoc.density.presence import Presence
from rholoc.features import FeatureSet, Metric, get_extractor
from rholoc.features.matching import LIMITS, DescriptorIndex, descriptor_distances
from rholoc.geometry import BoolArray, Camera, FloatArray, IntArray, ranges
from rholoc.lazy import lazy
from rholoc.localization.index.map_error import map_covariance_at
from rholoc.localization.index.matches import Matches, NearestLandmarks, guided_chances, is_least
from rholoc.maps import Map, Trust, trust_of

_CANDIDATES = 4
_CHANCE_SAMPLES = 20_000
_MOST_VIEWS = 0.8
_ALL = slice(None)
_UPRIGHT_LEAN_RAD = np.deg2rad(4.0)  # a hand that holds a phone upright keeps within it


class MapIndex:
    """What is derived once from a map; immutable afterwards.

    Args:
        map_: the map.
        chance: its :func:`chance_of_likeness`, where that is known already.
    """

    def __init__(self, map_: Map, chance: float | None = None) -> None:
        self.map = map_
        self._chance = chance
        self.metric: Metric = get_extractor(map_.info.features).metric
        self.landmarks = map_.landmarks.positions.astype(np.float64)
        self.covariances = map_.landmarks.covariances.astype(np.float64)
        self.view_positions = map_.views.positions
        self.view_headings = map_.views.headings
        self._first_descriptor = np.searchsorted(map_.descriptors.features, np.arange(len(map_) + 1))
        self._descriptor_counts = np.diff(self._first_descriptor)
        self._medoids = self._first_descriptor[:-1]
        self._everywhere = DescriptorIndex(map_.descriptors.values[self._medoids], map_.landmarks.channels, self.metric)
        seen, seen_from = map_.observations.features, self.view_positions[map_.observations.views]
        self.presence = Presence.of(self.landmarks, seen_from, seen)
        ones = np.ones(len(seen), dtype=np.float32)
        self.visibility = csr_array((ones, seen, map_.view_offsets), shape=(len(map_.views), len(map_)))

    def map_covariance(self, landmarks: IntArray, position: FloatArray, views: int) -> FloatArray | None:
        """The map's own covariance (6, 6) at a ``position`` (3,), by the views that saw most of some landmarks (M,).

        None where the map does not know it.
        """
        if self.map.views.covariances is None:
            return None
        votes = self.seen_by_views(landmarks)
        nearest = np.argsort(-votes, kind="stable")[:views]
        covariances = self.map.views.covariances[nearest].astype(np.float64)
        return map_covariance_at(covariances, self.view_positions[nearest], votes[nearest], position)

    @lazy
    def trust(self) -> Trust:
        """Whether the map is to be trusted, by its own report."""
        return trust_of(self.map.info)

    def shared_with(self, view: int) -> FloatArray:
        """(K,) how many features each view shares with one of them."""
        first, last = self.map.view_offsets[view : view + 2]
        return self.seen_by_views(self.visibility.indices[first:last])

    @lazy
    def seen_upright(self) -> bool:
        """Whether the map's own views were taken by a camera held upright."""
        if not self.map.info.upright or len(self.map.views.T_map_camera) == 0:
            return False
        lean_rad = np.arcsin(np.clip(np.abs(self.map.views.T_map_camera[:, 2, 0]), 0, 1))  # of the camera's x axis
        return bool(np.quantile(lean_rad, _MOST_VIEWS) < _UPRIGHT_LEAN_RAD)

    @lazy
    def chance_of_likeness(self) -> float:
        """How often two descriptors of different landmarks are as alike as a match must be."""
        return chance_of_likeness(self.map) if self._chance is None else self._chance

    def present(self, position: FloatArray, landmarks: IntArray | slice = _ALL) -> BoolArray:
        """π_f: which features, or which of some ``landmarks`` (M,), may be seen from ``position`` (3,)."""
        return self.presence.take(landmarks).allows(self.landmarks[landmarks], position)

    def seen_from(self, views: IntArray) -> IntArray:
        """The features (P,) that some views (V,) saw, in their order."""
        first = self.map.view_offsets
        seen = np.zeros(len(self.map), dtype=bool)
        for view in views.tolist():
            seen[self.visibility.indices[first[view] : first[view + 1]]] = True
        return np.flatnonzero(seen)

    def seen_alike(self, landmarks: IntArray, views: int) -> BoolArray:
        """Which features (F,) were seen by those ``views`` that saw most of some landmarks (M,): as from there."""
        votes = self.seen_by_views(landmarks)
        seen = np.zeros(len(self.map), dtype=bool)
        seen[self.seen_from(np.argsort(-votes, kind="stable")[:views])] = True
        return seen

    def seen_by_views(self, landmarks: IntArray) -> FloatArray:
        """(K,) how many of some landmarks (M,) each view saw."""
        return np.asarray(self.visibility @ np.bincount(landmarks, minlength=len(self.map)).astype(np.float32))

    def nearest_everywhere(self, features: FeatureSet, some: IntArray | None = None) -> NearestLandmarks:
        """What in the whole map a query's features, or ``some`` of them (N,), are most like.

        Each landmark stands by its first descriptor.
        """
        return self._nearest(self._everywhere, self._medoids, features, some)

    def match_everywhere(self, features: FeatureSet) -> Matches:
        """Matches of a query's features with the whole map."""
        return self.nearest_everywhere(features).matches()

    def match_within(self, features: FeatureSet, landmarks: IntArray, some: IntArray | None = None) -> Matches:
        """Matches with some of the map's features only, each the other's nearest.

        By all descriptors of each; or, which is quicker, of ``some`` features (N,) alone by the first of each.
        """
        return self.nearest_within(features, landmarks, some).matches(mutual=True)

    def nearest_within(
        self, features: FeatureSet, landmarks: IntArray, some: IntArray | None = None
    ) -> NearestLandmarks:
        """What among some of the map's features a query's features are most like, as for :meth:`match_within`."""
        rows = self.descriptor_rows(landmarks) if some is None else self._medoids[landmarks]
        channels = self.map.landmarks.channels[self.map.descriptors.features[rows]]
        index = DescriptorIndex(self.map.descriptors.values[rows], channels, self.metric)
        return self._nearest(index, rows, features, some)

    def match_near(
        self,
        features: FeatureSet,
        camera: Camera,
        T_map_camera: FloatArray,
        radius_px: float,
        some: IntArray | None = None,
    ) -> tuple[Matches, FloatArray]:
        """Matches with the landmarks that a camera at ``T_map_camera`` (4, 4) would see close by.

        Each is the other's best match within ``radius_px``; of all features, or of ``some`` (S,). Also returns how
        probably each detection (N,) would find something alike there by chance alone: what the matches are to be held
        against.
        """
        present = np.flatnonzero(self.present(T_map_camera[:3, 3]))
        pixels = camera.project((self.landmarks[present] - T_map_camera[:3, 3]) @ T_map_camera[:3, :3])
        inside = camera.contains(pixels)
        present, pixels = present[inside], pixels[inside]
        if len(present) == 0 or len(features) == 0:
            return Matches.none(), np.zeros(len(features))
        ours = features.pixels if some is None else features.pixels[some]
        near = _tree(ours).sparse_distance_matrix(_tree(pixels), radius_px, output_type="ndarray")
        detections, landmarks = near["i"].astype(np.int64), present[near["j"]]
        if some is not None:
            detections = some[detections].astype(np.int64)
        by_chance = 1 - (1 - self.chance_of_likeness) ** np.bincount(detections, minlength=len(features))
        distances = self.distances_to(features, detections, landmarks)
        alike = np.flatnonzero(distances <= LIMITS[self.metric].loose)
        detections, landmarks, distances = detections[alike], landmarks[alike], distances[alike]
        mutual = is_least(distances, detections, len(features)) & is_least(distances, landmarks, len(self.map))
        chances = guided_chances(distances[mutual], self.metric)
        return Matches(detections[mutual], landmarks[mutual], chances), by_chance

    def descriptor_rows(self, landmarks: IntArray) -> IntArray:
        """The rows of all descriptors of the given landmarks."""
        return ranges(self._first_descriptor[landmarks], self._first_descriptor[landmarks + 1])

    def distances_to(self, features: FeatureSet, detections: IntArray, landmarks: IntArray) -> FloatArray:
        """The distance (M,) of each detection to its landmark's nearest descriptor; inf across channels."""
        best = np.full(len(detections), np.inf, dtype=np.float32)
        comparable = np.flatnonzero(features.channels[detections] == self.map.landmarks.channels[landmarks])
        if len(comparable) == 0:
            return best
        detections, landmarks = detections[comparable], landmarks[comparable]
        rows, counts = self.descriptor_rows(landmarks), self._descriptor_counts[landmarks]
        ours = np.take(features.descriptors, np.repeat(detections, counts), axis=0)  # quicker than by an index
        distances = descriptor_distances(ours, np.take(self.map.descriptors.values, rows, axis=0), self.metric)
        best[comparable] = np.minimum.reduceat(distances, np.cumsum(counts) - counts)
        return best

    def _nearest(
        self, index: DescriptorIndex, rows: IntArray, features: FeatureSet, some: IntArray | None = None
    ) -> NearestLandmarks:
        detections = np.arange(len(features)) if some is None else some
        distances, found = index.nearest(features if some is None else features.take(some), _CANDIDATES)
        owners = np.where(found >= 0, self.map.descriptors.features[rows[np.maximum(found, 0)]], -1)
        return NearestLandmarks(detections, owners.astype(np.int64), distances, self.metric)


def _tree(pixels: FloatArray) -> cKDTree:
    """A tree that is made faster than it is searched: it is searched once."""
    return cKDTree(pixels, compact_nodes=False, balanced_tree=False)


def chance_of_likeness(map_: Map) -> float:
    """How often two descriptors of different landmarks of a map are as alike as a match must be, by a sample."""
    metric = get_extractor(map_.info.features).metric
    rng = np.random.default_rng(0)
    a, b = rng.integers(0, len(map_.descriptors), (2, _CHANCE_SAMPLES))
    owners = map_.descriptors.features
    channels, values = map_.landmarks.channels[owners], map_.descriptors.values
    strangers = (owners[a] != owners[b]) & (channels[a] == channels[b])
    distances = descriptor_distances(values[a[strangers]], values[b[strangers]], metric)
    return float((distances <= LIMITS[metric].loose).mean()) if strangers.any() else 0.0
