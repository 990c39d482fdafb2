"""Link detections across views into tracks: detections of the same landmark."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rholoc.features import FeatureSet, Metric
from rholoc.features.matching import LIMITS, descriptor_distances, mutual_matches
from rholoc.geometry import BoolArray, Camera, FloatArray, IntArray, PosedCameras, cross, direction_angles
from rholoc.lazy import lazy
from rholoc.progress import ProgressListener, Stage, silent

_TEMPORAL_NEIGHBOURS = 8
_SPATIAL_NEIGHBOURS = 10
_METRES_PER_RADIAN = 2.0  # how much turning makes views as different as moving by a metre does
_EPIPOLAR_LIMIT_PX = 4.0


@dataclass(frozen=True, eq=False)
class Views(PosedCameras):
    """K posed keyframes and their features; the detections of all views are concatenated to N rows.

    Attributes:
        cameras: K intrinsics.
        T_map_camera: (K, 4, 4).
        times: (K,) [s].
        features: all N detections, view after view.
        offsets: (K + 1,) detections of view k are rows offsets[k] : offsets[k + 1].
        bearings: (N, 3) unit vectors in the map frame.
        ranges_m: (N,) measured distances along the bearings, NaN where unknown.
    """

    cameras: tuple[Camera, ...]
    T_map_camera: FloatArray
    times: FloatArray
    features: FeatureSet
    offsets: IntArray
    bearings: FloatArray
    ranges_m: FloatArray

    @classmethod
    def from_features(
        cls,
        cameras: Sequence[Camera],
        T_map_camera: FloatArray,
        times: FloatArray,
        features: Sequence[FeatureSet],
        ranges_m: FloatArray | None = None,
    ) -> Views:
        """Views from a camera, pose, time and feature set each; ``ranges_m`` (N,) of all features, None if unknown."""
        rays = [
            camera.rays(f.pixels) @ T[:3, :3].T for camera, f, T in zip(cameras, features, T_map_camera, strict=True)
        ]
        offsets = np.concatenate([[0], np.cumsum([len(f) for f in features])])
        every = FeatureSet.concatenate(list(features))
        if ranges_m is None:
            ranges_m = np.full(len(every), np.nan)
        return cls(tuple(cameras), T_map_camera, times, every, offsets, np.concatenate(rays), ranges_m)

    def __len__(self) -> int:
        return len(self.T_map_camera)

    @lazy
    def focal_px(self) -> FloatArray:
        """(K,) focal lengths, pixels."""
        return np.array([camera.focal for camera in self.cameras])

    @lazy
    def view_of(self) -> IntArray:
        """(N,) row of the view of each detection."""
        return np.repeat(np.arange(len(self)), np.diff(self.offsets))

    def of_view(self, k: int) -> FeatureSet:
        """The detections of view ``k``."""
        return self.features.take(np.arange(self.offsets[k], self.offsets[k + 1]))


def neighbour_pairs(views: Views) -> IntArray:
    """Sorted pairs (P, 2) of views worth matching: the next eight in time, and each view's ten closest others in
    position and heading.
    """
    k = len(views)
    order = np.argsort(views.times, kind="stable")
    pairs = {
        (min(order[i], order[j]), max(order[i], order[j]))
        for i in range(k)
        for j in range(i + 1, min(i + 1 + _TEMPORAL_NEIGHBOURS, k))
    }
    turned = direction_angles(views.headings, views.headings)
    apart = np.linalg.norm(views.positions[:, None] - views.positions[None], axis=2)
    difference = apart + _METRES_PER_RADIAN * turned
    for i in range(k):
        others = np.argsort(difference[i], kind="stable")
        others = others[others != i]
        far_in_time = np.array([j for j in others if (min(i, j), max(i, j)) not in pairs], dtype=np.int64)
        pairs.update((min(i, j), max(i, j)) for j in far_in_time[:_SPATIAL_NEIGHBOURS])
    return np.array(sorted(pairs), dtype=np.int64).reshape(-1, 2)


def link_observations(views: Views, metric: Metric, progress: ProgressListener = silent) -> IntArray:
    """Link detections into tracks. Returns labels (N,), -1 for a detection without a track.

    Links are mutual nearest neighbours within the strict descriptor limit that agree with the epipolar geometry of the
    views' poses. The most similar ones are linked first; a track never has two detections in one view.
    """
    pairs = neighbour_pairs(views)
    feature_sets = [views.of_view(k) for k in range(len(views))]
    links = []
    for count, (i, j) in enumerate(pairs):
        matches = mutual_matches(feature_sets[i], feature_sets[j], metric, LIMITS[metric].strict)
        rows = matches + views.offsets[[i, j]]
        links.append(rows[epipolar_agreement(views, rows, i, j)])
        progress(
            Stage.OBSERVATIONS, 0.3 + 0.7 * (count + 1) / len(pairs), f"{count + 1} of {len(pairs)} pairs of views"
        )
    linked = np.concatenate(links) if links else np.zeros((0, 2), dtype=np.int64)
    descriptors = views.features.descriptors
    unlike = descriptor_distances(descriptors[linked[:, 0]], descriptors[linked[:, 1]], metric)
    return _tracks(linked[np.argsort(unlike, kind="stable")], views.view_of)


def epipolar_agreement(views: Views, rows: IntArray, i: int, j: int) -> BoolArray:
    """Mask (M,) of links (M, 2), rows of detections in views ``i`` and ``j``, within 4 px of the epipolar plane in both
    pictures.

    Without a baseline, both bearings must agree within 4 px.
    """
    baseline = views.positions[j] - views.positions[i]
    b_i, b_j = views.bearings[rows[:, 0]], views.bearings[rows[:, 1]]
    length = np.linalg.norm(baseline)
    limit = _EPIPOLAR_LIMIT_PX / min(views.focal_px[i], views.focal_px[j])
    if length < 1e-6:
        return np.asarray(np.linalg.norm(cross(b_i, b_j), axis=1) < limit)
    normals = [cross(baseline / length, b) for b in (b_i, b_j)]
    triple = np.abs(np.einsum("mi,mi->m", b_i, normals[1]))  # |b_i · (t × b_j)| = |b_j · (t × b_i)|
    lengths = [np.maximum(np.linalg.norm(normal, axis=1), 1e-9) for normal in normals]
    return np.asarray(triple < limit * np.minimum(*lengths))


def _tracks(links: IntArray, view_of: IntArray) -> IntArray:
    """Labels (N,) of the union of the links (L, 2) in their order; -1 for a detection without a link. Links that would
    put two detections of a view into a track are skipped.
    """
    parent = np.arange(len(view_of)).tolist()
    seen_in: dict[int, set[int]] = {}

    def root(row: int) -> int:
        while parent[row] != row:
            parent[row] = parent[parent[row]]
            row = parent[row]
        return row

    for a, b in links.tolist():
        root_a, root_b = root(a), root(b)
        if root_a == root_b:
            continue
        views_a = seen_in.get(root_a) or {int(view_of[root_a])}
        views_b = seen_in.get(root_b) or {int(view_of[root_b])}
        if len(views_a) < len(views_b):
            root_a, root_b, views_a, views_b = root_b, root_a, views_b, views_a
        if views_a.isdisjoint(views_b):
            parent[root_b] = root_a
            views_a |= views_b
            seen_in[root_a] = views_a
    roots = np.array([root(row) for row in range(len(view_of))], dtype=np.int64)
    return _without_loners(roots)


def _without_loners(labels: IntArray) -> IntArray:
    """Labels (N,) renumbered from 0; those that occur once become -1."""
    _, inverse, counts = np.unique(labels, return_inverse=True, return_counts=True)
    number = np.where(counts >= 2, np.cumsum(counts >= 2) - 1, -1)
    return np.asarray(number[inverse])
