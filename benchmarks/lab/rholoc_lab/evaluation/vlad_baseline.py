"""Hierarchical localization without a GPU: SIFT, image retrieval by VLAD, LO-RANSAC.

It stands for hloc (Sarlin et al., CVPR 2019) with classical parts: the most similar views are retrieved by a global
descriptor, the query is matched with each of them alone, and the 2D–3D matches of all give one pose by poselib. The
points are those of a SIFT map: landmarks triangulated from the views' given poses.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rholoc.features import FeatureSet
from rholoc.features.matching import DescriptorIndex
from rholoc.features.picture_vectors import Vlad
from rholoc.geometry import Camera, FloatArray, IntArray
from rholoc.localization.index.map_index import MapIndex
from rholoc_lab.evaluation.pnp_baselines import RansacOptions, Solver, solve

_OBSERVED_PX = 3.0
_RATIO = 0.85
OPTIONS = RansacOptions(threshold_px=12.0)
_RETRIEVED = 20  # views to match a query with


@dataclass(frozen=True, eq=False)
class _View:
    """The features of one view that observe landmarks."""

    features: FeatureSet
    landmarks: IntArray
    index: DescriptorIndex


class VladPipeline:
    """The baseline's map: VLAD vectors of the views, and each view's own descriptors with their landmarks.

    Args:
        index: a map of SIFT features.
        view_features: the features of the map's views, in their order, by the map's extractor.
    """

    def __init__(self, index: MapIndex, view_features: Sequence[FeatureSet]) -> None:
        self._landmarks = index.landmarks
        self._views = [_view(index, k, features) for k, features in enumerate(view_features)]
        descriptors = [features.descriptors for features in view_features]
        self._vlad = Vlad(descriptors)
        self._vectors = self._vlad.vectors(descriptors)

    @property
    def bytes(self) -> int:
        """Stored bytes: descriptors with their landmarks, landmarks, VLAD vectors as float32, words."""
        views = sum(view.features.descriptors.nbytes + 4 * len(view.landmarks) for view in self._views)
        return views + 4 * (self._landmarks.size + self._vectors.size + self._vlad.words.size)

    def localize(self, features: FeatureSet, camera: Camera) -> tuple[FloatArray | None, dict[str, float]]:
        """T_map_camera (4, 4) or None, and the milliseconds of ``retrieve``, ``match`` and ``solve``."""
        laps = [time.perf_counter()]
        likeness = self._vectors @ self._vlad.vector(features.descriptors)
        views = np.argsort(-likeness, kind="stable")[:_RETRIEVED]
        laps.append(time.perf_counter())
        detections, landmarks = self._match(features, views)
        laps.append(time.perf_counter())
        T = solve(Solver.POSELIB, features.pixels[detections], self._landmarks[landmarks], camera, OPTIONS)
        laps.append(time.perf_counter())
        return T, dict(zip(("retrieve", "match", "solve"), (1e3 * np.diff(laps)).tolist(), strict=True))

    def _match(self, features: FeatureSet, views: IntArray) -> tuple[IntArray, IntArray]:
        """Different (detection, landmark) matches of all views, those found in most views first."""
        found = [_match_view(features, self._views[k]) for k in views]
        pairs = np.concatenate(found) if found else np.zeros((0, 2), dtype=np.int64)
        different, counts = np.unique(pairs, axis=0, return_counts=True)
        different = different[np.argsort(-counts, kind="stable")]
        return different[:, 0], different[:, 1]


def _view(index: MapIndex, k: int, features: FeatureSet) -> _View:
    """The features that view ``k`` observes landmarks with: those within a few pixels of their projections."""
    map_ = index.map
    landmarks = map_.observations.features[map_.view_offsets[k] : map_.view_offsets[k + 1]].astype(np.int64)
    camera = map_.info.camera
    pixels = camera.project(_in_camera(index.landmarks[landmarks], map_.views.T_map_camera[k]))
    apart = np.linalg.norm(pixels[:, None] - features.pixels[None], axis=2) if len(features) else np.zeros((0, 0))
    landmarks_, detections = np.nonzero(np.nan_to_num(apart, nan=np.inf) <= _OBSERVED_PX)
    like = index.distances_to(features, detections, landmarks[landmarks_])
    order = np.argsort(like, kind="stable")
    first = np.sort(order[np.unique(landmarks_[order], return_index=True)[1]])
    observing = features.take(detections[first])
    return _View(
        observing,
        landmarks[landmarks_[first]],
        DescriptorIndex(observing.descriptors, observing.channels, index.metric),
    )


def _in_camera(points: FloatArray, T_map_camera: FloatArray) -> FloatArray:
    return np.asarray((points - T_map_camera[:3, 3]) @ T_map_camera[:3, :3])


def _match_view(features: FeatureSet, view: _View) -> IntArray:
    """(detection, landmark) rows (M, 2) of mutual matches that pass the ratio test."""
    if len(view.features) < 2 or len(features) == 0:
        return np.zeros((0, 2), dtype=np.int64)
    distances, rows = view.index.nearest(features, 2)
    good = np.flatnonzero(distances[:, 0] < _RATIO * distances[:, 1])
    best = np.full(len(view.features), np.inf)
    np.minimum.at(best, rows[good, 0], distances[good, 0])
    mutual = good[distances[good, 0] <= best[rows[good, 0]]]
    return np.column_stack([mutual, view.landmarks[rows[mutual, 0]]])
