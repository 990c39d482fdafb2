"""The paper's experiment (section 6): a map made under one light and queried under another, for every extractor.

Frame poses are the true ones: this measures features, not how well a walk can be reconstructed.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, Protocol

import numpy as np

from rholoc.errors import MappingFailed
from rholoc.evaluation.errors import PoseErrors, quantile, trajectory_errors
from rholoc.features import Extractor, FeatureSet, extractor_names, get_extractor
from rholoc.geometry import Camera, FloatArray, IntArray, Pose, direction_angles
from rholoc.localization import Dof, Localizer, Query
from rholoc.mapping import BuildOptions, build_map
from rholoc.progress import ProgressListener, Stage, silent
from rholoc.recordings import Recording
from rholoc.trajectory import PoseMethod
from rholoc_lab.evaluation.redetection import Redetection, redetection

RECALL_LIMITS = (0.05, 5.0)
_HIDDEN = 0.02  # relative difference of depth above which a point is behind something
_RADIAN_M = 1.0


class PointsSeen(Protocol):
    """The room's true surface, which only a simulation knows."""

    def __call__(self, camera: Camera, pose: Pose) -> FloatArray:
        """The point (H, W, 3) of the map frame, metres, that each pixel's centre sees."""
        ...


@dataclass(frozen=True)
class LightPair:
    """One extractor's figures for a map under one light and queries under another.

    Attributes:
        features: the extractor's name.
        map_light, query_light: the lights' names.
        redetection: over all queries, each compared with the nearest frame of the map.
        queries: their number.
        recall: the share of them localized within 5 cm and 5°.
        median_cm: their median error, a failure counting as infinite; None where it is.
        landmarks: of the map.
    """

    features: str
    map_light: str
    query_light: str
    redetection: Redetection
    queries: int
    recall: float
    median_cm: float | None
    landmarks: int

    def figures(self) -> dict[str, Any]:
        """All figures, JSON-serialisable."""
        return {
            "features": self.features,
            "map_light": self.map_light,
            "query_light": self.query_light,
            **self.redetection.figures(),
            "queries": self.queries,
            "recall_5cm_5deg": self.recall,
            "median_cm": self.median_cm,
            "landmarks": self.landmarks,
        }


def compare_lights(
    map_walks: Mapping[str, Recording],
    query_walks: Mapping[str, Recording],
    points_seen: PointsSeen,
    extractors: Sequence[str] | None = None,
    progress: ProgressListener = silent,
) -> list[LightPair]:
    """Compare extractors under every pair of a map's light and the queries' light.

    Args:
        map_walks: by light, the same posed walk.
        query_walks: by light, another posed walk through the same room.
        points_seen: the room's surface.
        extractors: their names; None: all extractors.

    Raises:
        InvalidInput: an extractor does not exist.
        InvalidRecording: a frame cannot be read, or a recording has no poses.
    """
    names = list(extractors or extractor_names())
    lookup = _correspondences(next(iter(map_walks.values())), next(iter(query_walks.values())), points_seen)
    pairs: list[LightPair] = []
    total = len(names) * len(map_walks) * len(query_walks)
    for name in names:
        extractor = get_extractor(name)
        queries = {light: _features(walk, extractor) for light, walk in query_walks.items()}
        views = {light: _features(walk, extractor, lookup.map_rows) for light, walk in map_walks.items()}
        localizers = {light: _localizer(walk, name) for light, walk in map_walks.items()}
        for map_light, query_light in product(map_walks, query_walks):
            walk, features = query_walks[query_light], queries[query_light]
            errors = _localize(localizers[map_light], walk, features)
            pairs.append(
                LightPair(
                    name,
                    map_light,
                    query_light,
                    lookup.redetection(features, views[map_light], extractor),
                    len(features),
                    float(errors.within(*RECALL_LIMITS).mean()),
                    quantile(100 * errors.position_m, 0.5),
                    0 if (localizer := localizers[map_light]) is None else len(localizer.map),
                )
            )
            progress(Stage.REPORT, len(pairs) / total, f"{name}: map by {map_light}, queries by {query_light}")
    return pairs


@dataclass(frozen=True, eq=False)
class _Correspondences:
    """Pixel correspondences of each query frame with its nearest frame of the map.

    Attributes:
        map_rows: (K,) rows of the map's walk that are nearest to some query.
        nearest: for each query, the index of its nearest frame in ``map_rows``.
        where: for each query, (H, W, 2) float32: the pixel of that frame with the same point; NaN where hidden.
    """

    map_rows: IntArray
    nearest: IntArray
    where: tuple[FloatArray, ...]

    def redetection(
        self, queries: Sequence[FeatureSet], views: Sequence[FeatureSet], extractor: Extractor
    ) -> Redetection:
        parts = []
        for query, view, where in zip(queries, self.nearest, self.where, strict=True):
            u, v = np.rint(query.pixels).astype(np.int64).T
            height, width = where.shape[:2]
            u, v = u.clip(0, width - 1), v.clip(0, height - 1)
            # keep the fraction of a pixel lost in rounding
            shown = where[v, u] + (query.pixels - np.column_stack([u, v]))
            parts.append(redetection(query, views[view], shown, extractor.metric))
        return Redetection.total(parts)


def _correspondences(map_walk: Recording, query_walk: Recording, points_seen: PointsSeen) -> _Correspondences:
    T_map, T_query = _poses(map_walk), _poses(query_walk)
    map_camera, query_camera = _camera(map_walk), _camera(query_walk)
    nearest = [_nearest(T, T_map) for T in T_query]
    rows = np.unique(nearest)
    seen_by_map = {row: points_seen(map_camera, Pose(T_map[row])) for row in rows.tolist()}
    where = tuple(
        _shown_in(points_seen(query_camera, Pose(T)), seen_by_map[row], Pose(T_map[row]), map_camera)
        for T, row in zip(T_query, nearest, strict=True)
    )
    return _Correspondences(rows, np.searchsorted(rows, nearest), where)


def _shown_in(points: FloatArray, others: FloatArray, pose: Pose, camera: Camera) -> FloatArray:
    """Projections (H, W, 2) of points (H, W, 3) into a camera whose pixels see ``others`` (H, W, 3); NaN where hidden
    by these."""
    local = (points.reshape(-1, 3) - pose.position) @ pose.R_map_camera
    pixels = camera.project(local)
    inside = np.flatnonzero(camera.contains(pixels))
    u, v = np.rint(pixels[inside]).astype(np.int64).T
    u, v = u.clip(0, camera.width - 1), v.clip(0, camera.height - 1)
    depth = (others[v, u] - pose.position) @ pose.heading
    shown = inside[np.abs(local[inside, 2] - depth) <= _HIDDEN * depth]
    where = np.full((len(local), 2), np.nan, dtype=np.float32)
    where[shown] = pixels[shown]
    return where.reshape(*points.shape[:2], 2)


def _nearest(T: FloatArray, others: FloatArray) -> int:
    apart = np.linalg.norm(others[:, :3, 3] - T[:3, 3], axis=1)
    turned = direction_angles(others[:, :3, 2], T[:3, 2][None])[:, 0]
    return int(np.argmin(apart + _RADIAN_M * turned))


def _features(walk: Recording, extractor: Extractor, rows: IntArray | None = None) -> list[FeatureSet]:
    chosen = range(len(walk.frames.times)) if rows is None else rows.tolist()
    return [extractor.extract(image) for image in walk.frames.images(chosen)]


def _localizer(walk: Recording, features: str) -> Localizer | None:
    """The localizer of the map that the walk makes, or None where the light gives too few stable features."""
    try:
        return Localizer(build_map([walk], BuildOptions(features=features, poses=PoseMethod.GIVEN, report=False)))
    except MappingFailed:
        return None


def _localize(localizer: Localizer | None, walk: Recording, features: Sequence[FeatureSet]) -> PoseErrors:
    truth, camera = _poses(walk), _camera(walk)
    return trajectory_errors(np.array(list(_answers(localizer, camera, features))), truth)


def _answers(localizer: Localizer | None, camera: Camera, features: Sequence[FeatureSet]) -> Iterator[FloatArray]:
    for one in features:
        pose = None if localizer is None else localizer.localize(Query(one, camera, Dof.FREE)).pose
        yield np.full((4, 4), np.nan) if pose is None else pose.T_map_camera


def _poses(walk: Recording) -> FloatArray:
    assert walk.poses is not None
    return walk.poses.T_map_camera


def _camera(walk: Recording) -> Camera:
    assert walk.camera is not None
    return walk.camera
