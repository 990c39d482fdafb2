"""Index of a map for localization: search descriptors, project landmarks, vote for places."""

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
_MAX_VIEWS = 0.8
_ALL = slice(None)
_UPRIGHT_LEAN_RAD = np.deg2rad(4.0)  # a hand that holds a phone upright keeps within it


class MapIndex:
    """Everything that localization derives once from a map. Immutable.

    Args:
        map_: the map.
        chance: its :func:`chance_of_likeness`, if it is already known.
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
        """Covariance (6, 6) of the map at a ``position`` (3,) [m], from the ``views`` views that saw most of
        ``landmarks`` (M,).

        Returns None if the map has no covariances, or those views have none.
        """
        if self.map.views.covariances is None:
            return None
        votes = self.seen_by_views(landmarks)
        nearest = np.argsort(-votes, kind="stable")[:views]
        covariances = self.map.views.covariances[nearest].astype(np.float64)
        return map_covariance_at(covariances, self.view_positions[nearest], votes[nearest], position)

    @lazy
    def trust(self) -> Trust:
        """Verdict on the map from its own report's checks."""
        return trust_of(self.map.info)

    def shared_with(self, view: int) -> FloatArray:
        """(K,) number of features that each view shares with view ``view``."""
        first, last = self.map.view_offsets[view : view + 2]
        return self.seen_by_views(self.visibility.indices[first:last])

    @lazy
    def seen_upright(self) -> bool:
        """Whether a camera held upright took the map's views: 80 % lean by less than 4°. False if up is unknown."""
        if not self.map.info.upright or len(self.map.views.T_map_camera) == 0:
            return False
        lean_rad = np.arcsin(np.clip(np.abs(self.map.views.T_map_camera[:, 2, 0]), 0, 1))  # of the camera's x axis
        return bool(np.quantile(lean_rad, _MAX_VIEWS) < _UPRIGHT_LEAN_RAD)

    @lazy
    def chance_of_likeness(self) -> float:
        """Probability that descriptors of two different landmarks are similar enough for a match."""
        return chance_of_likeness(self.map) if self._chance is None else self._chance

    def present(self, position: FloatArray, landmarks: IntArray | slice = _ALL) -> BoolArray:
        """Presence π_f: whether each feature, or each of ``landmarks`` (M,), may be visible from ``position`` (3,)."""
        return self.presence.take(landmarks).allows(self.landmarks[landmarks], position)

    def seen_from(self, views: IntArray) -> IntArray:
        """Sorted rows (P,) of the features that at least one of the given views (V,) saw."""
        first = self.map.view_offsets
        seen = np.zeros(len(self.map), dtype=bool)
        for view in views.tolist():
            seen[self.visibility.indices[first[view] : first[view + 1]]] = True
        return np.flatnonzero(seen)

    def seen_alike(self, landmarks: IntArray, views: int) -> BoolArray:
        """Mask (F,) of features seen by the ``views`` views that saw most of ``landmarks`` (M,), hence from nearby."""
        votes = self.seen_by_views(landmarks)
        seen = np.zeros(len(self.map), dtype=bool)
        seen[self.seen_from(np.argsort(-votes, kind="stable")[:views])] = True
        return seen

    def seen_by_views(self, landmarks: IntArray) -> FloatArray:
        """(K,) number of the given landmarks (M,) that each view saw."""
        return np.asarray(self.visibility @ np.bincount(landmarks, minlength=len(self.map)).astype(np.float32))

    def nearest_everywhere(self, features: FeatureSet, some: IntArray | None = None) -> NearestLandmarks:
        """Nearest landmarks in the whole map for a query's features, or for the rows ``some`` (N,) of them.

        Compares with the first descriptor of each landmark only.
        """
        return self._nearest(self._everywhere, self._medoids, features, some)

    def match_everywhere(self, features: FeatureSet) -> Matches:
        """Match each of a query's features with the map's nearest landmark, within the loose limit. Not mutual."""
        return self.nearest_everywhere(features).matches()

    def match_within(self, features: FeatureSet, landmarks: IntArray, some: IntArray | None = None) -> Matches:
        """Mutual nearest-neighbour matches with the landmarks (P,), within the loose descriptor limit.

        With ``some`` (N,), only these rows of the features are matched, and only against each landmark's first
        descriptor, which is faster.
        """
        return self.nearest_within(features, landmarks, some).matches(mutual=True)

    def nearest_within(
        self, features: FeatureSet, landmarks: IntArray, some: IntArray | None = None
    ) -> NearestLandmarks:
        """The four nearest of the ``landmarks`` (P,), by number, for each feature; or for the rows ``some`` (N,), by
        the landmarks' first descriptors only. Padded with -1.
        """
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
        """Match features with the landmarks that project close to them and may be visible from the pose.

        Args:
            features: the query's N features.
            camera: the query's camera.
            T_map_camera: (4, 4) pose from which landmarks are projected.
            radius_px: maximum distance between a feature and a projected landmark.
            some: (S,) rows of the features to match; default: all.

        Returns:
            Mutual best matches within the loose descriptor limit, and the probability (N,) that each feature matches
            something within the radius by chance.
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
        """Rows of all descriptors of the landmarks (M,), grouped in their order."""
        return ranges(self._first_descriptor[landmarks], self._first_descriptor[landmarks + 1])

    def distances_to(self, features: FeatureSet, detections: IntArray, landmarks: IntArray) -> FloatArray:
        """Descriptor distance (M,) of each detection to its landmark's nearest descriptor; inf across channels."""
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
        """The four nearest entries of ``index`` for each feature, or for the rows ``some``. ``rows`` (E,) are the map's
        descriptors that the entries stand for; the result names their landmarks, -1 for none.
        """
        detections = np.arange(len(features)) if some is None else some
        distances, found = index.nearest(features if some is None else features.take(some), _CANDIDATES)
        owners = np.where(found >= 0, self.map.descriptors.features[rows[np.maximum(found, 0)]], -1)
        return NearestLandmarks(detections, owners.astype(np.int64), distances, self.metric)


def _tree(pixels: FloatArray) -> cKDTree:
    """k-d tree that favours fast construction, because it is searched once."""
    return cKDTree(pixels, compact_nodes=False, balanced_tree=False)


def chance_of_likeness(map_: Map) -> float:
    """Probability that descriptors of two different landmarks of one channel are closer than the loose limit, from
    20,000 random pairs; 0 if no pair qualifies.
    """
    metric = get_extractor(map_.info.features).metric
    rng = np.random.default_rng(0)
    a, b = rng.integers(0, len(map_.descriptors), (2, _CHANCE_SAMPLES))
    owners = map_.descriptors.features
    channels, values = map_.landmarks.channels[owners], map_.descriptors.values
    strangers = (owners[a] != owners[b]) & (channels[a] == channels[b])
    distances = descriptor_distances(values[a[strangers]], values[b[strangers]], metric)
    return float((distances <= LIMITS[metric].loose).mean()) if strangers.any() else 0.0
