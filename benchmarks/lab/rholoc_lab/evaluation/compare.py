"""Compare the density with the baselines in one run, on the same features and matches of each query."""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import product
from typing import Any

import cv2
import numpy as np

from rholoc.density import DensityKind
from rholoc.evaluation.errors import PoseErrors, quantile, trajectory_errors
from rholoc.features import DEFAULT_FEATURES, FeatureSet, get_extractor
from rholoc.geometry import ByteArray, FloatArray, direction_angles
from rholoc.localization import Dof, Localizer, Query
from rholoc.localization.index.matches import Matches
from rholoc.localization.pose.seeds import vote_for_places
from rholoc.mapping import BuildOptions, build_map
from rholoc.mapping.build.density_fitting import fit_densities
from rholoc.maps import Map, map_to_bytes
from rholoc.progress import ProgressListener, Stage, silent
from rholoc.recordings import Recording
from rholoc.trajectory import PoseMethod
from rholoc_lab.evaluation.pnp_baselines import (
    MatchSet,
    RansacOptions,
    Solver,
    distinct,
    refine_by_density,
    solve,
)
from rholoc_lab.evaluation.splits import QuerySet
from rholoc_lab.evaluation.vlad_baseline import VladPipeline

THRESHOLDS = ((0.02, 2.0), (0.05, 5.0), (0.10, 5.0), (0.25, 10.0))
"""Metres and degrees that recall is reported at."""

RETRIEVAL = "sift retrieval + poselib"
_RETRIEVAL_FEATURES = "sift"
_VIEWS_EACH = 10
_RADIAN_M = 1.0  # distance from a map's view equivalent to a rotation by a radian, as in choosing views

Answer = tuple[FloatArray | None, dict[str, float]]


@dataclass(frozen=True)
class CompareOptions:
    """Options of a comparison.

    Attributes:
        features: extractor shared by all methods but the retrieval pipeline.
        dof: what the densities estimate; the baselines always estimate six.
        tensor: whether to fit and run the ``tensor`` density too.
        retrieval: whether to build and run the SIFT retrieval pipeline too.
        ransac: the RANSACs' settings.
    """

    features: str = DEFAULT_FEATURES
    dof: Dof = Dof.FREE
    tensor: bool = True
    retrieval: bool = True
    ransac: RansacOptions = field(default_factory=RansacOptions)


@dataclass(frozen=True, eq=False)
class MethodResult:
    """One method's answers to N queries.

    Attributes:
        name: of the method.
        T_map_camera: (N, 4, 4), NaN without a pose.
        errors: against the truth.
        timings_ms: for each query, milliseconds by stage.
        map_bytes: size of the method's stored data.
    """

    name: str
    T_map_camera: FloatArray
    errors: PoseErrors
    timings_ms: tuple[dict[str, float], ...]
    map_bytes: int

    def stage_ms(self) -> dict[str, float]:
        """Median time of each stage [ms]; a stage that a query did not reach counts as 0."""
        stages = dict.fromkeys(stage for timings in self.timings_ms for stage in timings)
        return {stage: float(np.median([t.get(stage, 0.0) for t in self.timings_ms])) for stage in stages}

    def figures(self) -> dict[str, Any]:
        """The figures over all queries, JSON-serialisable; a failure counts as infinitely wrong."""
        rough_m, rough_deg = THRESHOLDS[-1]
        localized = self.errors.localized
        return {
            "method": self.name,
            "recall": {threshold_name(*limits): float(self.errors.within(*limits).mean()) for limits in THRESHOLDS},
            "median_cm": quantile(100 * self.errors.position_m, 0.5),
            "median_deg": quantile(np.degrees(self.errors.rotation_rad), 0.5),
            "no_pose": int((~localized).sum()),
            "wrong_pose": int((localized & ~self.errors.within(rough_m, rough_deg)).sum()),
            "median_ms": self.stage_ms() | {"total": float(np.median([sum(t.values()) for t in self.timings_ms]))},
            "map_bytes": self.map_bytes,
        }


@dataclass(frozen=True, eq=False)
class SplitResult:
    """All methods on one set of queries.

    Attributes:
        label: the set's name.
        truth: (N, 4, 4).
        view_distance: (N,) from each query to the map's nearest view, in metres plus radians.
        methods: in the order of the table.
    """

    label: str
    truth: FloatArray
    view_distance: FloatArray
    methods: tuple[MethodResult, ...]


@dataclass(frozen=True, eq=False)
class Comparison:
    """The result of a run.

    Attributes:
        options: of the run.
        map_: the map of ``ray`` densities.
        build_s: seconds that building each map took, by its name.
        splits: one for each set of queries.
    """

    options: CompareOptions
    map_: Map
    build_s: dict[str, float]
    splits: tuple[SplitResult, ...]

    def as_dict(self) -> dict[str, Any]:
        """All figures, JSON-serialisable."""
        return {
            "features": self.options.features,
            "dof": self.options.dof.value,
            "ransac": {"iterations": self.options.ransac.iterations, "threshold_px": self.options.ransac.threshold_px},
            "map": {"landmarks": len(self.map_), "views": len(self.map_.views), "build_s": self.build_s},
            "queries": [
                {
                    "label": split.label,
                    "frames": len(split.truth),
                    "view_distance_median": float(np.median(split.view_distance)),
                    "methods": [method.figures() for method in split.methods],
                }
                for split in self.splits
            ],
        }


def threshold_name(position_m: float, rotation_deg: float) -> str:
    """The name of a threshold in tables: ``5cm_5deg``."""
    return f"{100 * position_m:g}cm_{rotation_deg:g}deg"


def compare(
    map_recordings: Sequence[Recording],
    queries: Sequence[QuerySet],
    options: CompareOptions | None = None,
    progress: ProgressListener = silent,
) -> Comparison:
    """Build the maps from posed recordings, and localize the queries by every method.

    Times are wall-clock on one thread; the matches with the whole map are computed once and timed for every method.

    Raises:
        InvalidInput: the features do not exist.
        InvalidRecording: a frame cannot be read, or the recordings have no poses.
        MappingFailed: too few features are stable.
    """
    options = options or CompareOptions()
    with _one_thread():
        bench, build_s = _build(map_recordings, options, progress)
        splits = tuple(_run_split(bench, one, queries, progress) for one in queries)
    return Comparison(options, bench.ray.map, build_s, splits)


@dataclass(frozen=True, eq=False)
class _Bench:
    """The localizers that are compared."""

    options: CompareOptions
    ray: Localizer
    tensor: Localizer | None
    retrieval: VladPipeline | None
    map_bytes: dict[str, int]

    def answers(self, features: FeatureSet, sift: FeatureSet | None, query: Query) -> Iterator[tuple[str, Answer]]:
        """Every method's answer to one query."""
        yield "ray", _localized(self.ray, query)
        if self.tensor is not None:
            yield "tensor", _localized(self.tensor, query)
        rays = query.camera.rays(features.pixels)
        for name, (matches, match_ms) in self._match_sets(features).items():
            for solver, density in product(Solver, (False, True)):
                method = f"{solver}, {name}{' + density' if density else ''}"
                yield method, self._baseline(solver, density, matches, match_ms, query, rays)
        if self.retrieval is not None and sift is not None:
            yield RETRIEVAL, self.retrieval.localize(sift, query.camera)

    def bytes_of(self, method: str) -> int:
        """Size of a method's stored data; the PnP baselines need the ``ray`` map."""
        return self.map_bytes.get(method, self.map_bytes["ray"])

    def _match_sets(self, features: FeatureSet) -> dict[MatchSet, tuple[Matches, float]]:
        """Input matches of the solvers, and the time to find them [ms]."""
        index = self.ray.index
        start = time.perf_counter()
        everywhere = index.match_everywhere(features).likeliest_first()
        everywhere_ms = 1e3 * (time.perf_counter() - start)
        places = vote_for_places(index, everywhere, 1, _VIEWS_EACH, None) if len(everywhere) else []
        within = index.match_within(features, places[0].landmarks).likeliest_first() if places else Matches.none()
        place_ms = 1e3 * (time.perf_counter() - start)
        return {
            MatchSet.EVERYWHERE: (everywhere, everywhere_ms),
            MatchSet.DISTINCT: (distinct(everywhere), everywhere_ms),
            MatchSet.PLACE: (within, place_ms),
        }

    def _baseline(
        self, solver: Solver, density: bool, matches: Matches, match_ms: float, query: Query, rays: FloatArray
    ) -> Answer:
        pixels, points = query.features.pixels[matches.detections], self.ray.index.landmarks[matches.landmarks]
        start = time.perf_counter()
        T = solve(solver, pixels, points, query.camera, self.options.ransac)
        timings = {"match": match_ms, "solve": 1e3 * (time.perf_counter() - start)}
        if T is not None and density:
            start = time.perf_counter()
            T = refine_by_density(self.ray.index, query, rays, matches, T)
            timings["ascend"] = 1e3 * (time.perf_counter() - start)
        return T, timings


def _localized(localizer: Localizer, query: Query) -> Answer:
    answer = localizer.localize(query)
    return None if answer.pose is None else answer.pose.T_map_camera, answer.timings_ms


def _build(
    recordings: Sequence[Recording], options: CompareOptions, progress: ProgressListener
) -> tuple[_Bench, dict[str, float]]:
    build_s: dict[str, float] = {}

    def timed(name: str, make: Callable[[], Map]) -> Map:
        start = time.perf_counter()
        made = make()
        build_s[name] = time.perf_counter() - start
        return made

    def built(features: str) -> Map:
        return build_map(recordings, BuildOptions(features=features, poses=PoseMethod.GIVEN, report=False), progress)

    ray_map = timed("ray", lambda: built(options.features))
    map_bytes = {"ray": len(map_to_bytes(ray_map))}
    tensor = retrieval = None
    if options.tensor:
        tensor_map = timed("tensor", lambda: fit_densities(ray_map, DensityKind.TENSOR, progress=progress))
        map_bytes["tensor"] = len(map_to_bytes(tensor_map))
        tensor = Localizer(tensor_map)
    ray = Localizer(ray_map)
    if options.retrieval:
        same = options.features == _RETRIEVAL_FEATURES
        sift = ray if same else Localizer(timed(_RETRIEVAL_FEATURES, lambda: built(_RETRIEVAL_FEATURES)))
        views = [sift.extractor.extract(image) for image in _view_images(recordings, sift.map)]
        retrieval = VladPipeline(sift.index, views)
        map_bytes[RETRIEVAL] = retrieval.bytes
    return _Bench(options, ray, tensor, retrieval, map_bytes), build_s


def _view_images(recordings: Sequence[Recording], map_: Map) -> Iterator[ByteArray]:
    """The images of a map's views, recording after recording as they were built from."""
    counts = [source.views or 0 for source in map_.info.sources]
    ends = np.cumsum(counts)
    for recording, start, end in zip(recordings, ends - counts, ends, strict=True):
        rows = np.searchsorted(recording.frames.times, map_.views.times[start:end])
        yield from recording.frames.images(rows.tolist())


def _run_split(
    bench: _Bench, queries: QuerySet, everything: Sequence[QuerySet], progress: ProgressListener
) -> SplitResult:
    total = sum(len(one.rows) for one in everything)
    before = sum(len(one.rows) for one in everything[: everything.index(queries)])
    camera = queries.recording.camera or bench.ray.map.info.camera
    sift = get_extractor(_RETRIEVAL_FEATURES)
    answers: dict[str, list[Answer]] = {}
    for done, image in enumerate(queries.recording.frames.images(queries.rows.tolist()), start=before + 1):
        features = bench.ray.extractor.extract(image)
        query = Query(features, camera, bench.options.dof)
        with_sift = None
        if bench.retrieval is not None:
            with_sift = features if bench.ray.extractor.name == sift.name else sift.extract(image)
        for method, answer in bench.answers(features, with_sift, query):
            answers.setdefault(method, []).append(answer)
        progress(Stage.REPORT, done / total, f"{done} of {total} queries")
    truth = queries.truth
    methods = [_result(method, given, truth, bench.bytes_of(method)) for method, given in answers.items()]
    return SplitResult(queries.label, truth, _distance_to_views(truth, bench.ray.map), tuple(methods))


def _result(method: str, answers: Sequence[Answer], truth: FloatArray, map_bytes: int) -> MethodResult:
    T = np.array([np.full((4, 4), np.nan) if pose is None else pose for pose, _ in answers])
    return MethodResult(method, T, trajectory_errors(T, truth), tuple(timings for _, timings in answers), map_bytes)


def _distance_to_views(truth: FloatArray, map_: Map) -> FloatArray:
    """(N,) metres plus radians of heading from each pose (N, 4, 4) to the nearest of the map's views."""
    apart = np.linalg.norm(truth[:, None, :3, 3] - map_.views.positions[None], axis=2)
    turned = direction_angles(truth[:, :3, 2], map_.views.headings)
    return np.asarray((apart + _RADIAN_M * turned).min(axis=1))


@contextmanager
def _one_thread() -> Iterator[None]:
    """OpenCV on one thread, so that times are comparable."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)
