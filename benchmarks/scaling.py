"""How cost and recall grow with the map: landmarks from a thousand to a million.

    OMP_NUM_THREADS=1 python benchmarks/scaling.py [--landmarks 1000,10000,100000,1000000] [--everywhere]
    OMP_NUM_THREADS=1 python benchmarks/scaling.py --maps ASKED.rho OTHER.rho ... --queries WALK [--camera fx,fy,cx,cy]
        [--frames 100:400] [--every 6] [--landmarks ...] [--everywhere]

Without ``--maps`` the maps are synthetic: rooms of points side by side, each seen from views of its own, as a
building's rooms are; their descriptors are random, and so harder to look up by likeness than real ones. With ``--maps``
they are real or simulated ones, side by side: the first one, which the queries are of, then the others, then copies of
all of them until there are enough landmarks. A copy lies elsewhere and has the numbers of its descriptors in another
order: a place with as many features, spread alike, that does not look the same. Walks with poses are asked.

For each size, in a process of its own that reads the map from its file: the file's bytes, the memory at its peak,
seconds until the first answer, milliseconds of processor time for an answer by stage, on one thread, without the
extraction of features; the share of poses within 10 cm; and the slope, by which power of the size an answer takes
longer than in the map before. ``--everywhere`` matches with the whole map as small maps do, for comparison.
"""

from __future__ import annotations

import argparse
import math
import multiprocessing
import resource
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from itertools import count, islice
from pathlib import Path

import numpy as np

from rholoc.features import FeatureSet, get_extractor
from rholoc.geometry import Camera, FloatArray, Pose
from rholoc.localization import Dof, Localizer, Query, localizer_of
from rholoc.maps import (
    DensityKind,
    Map,
    MapDescriptors,
    MapInfo,
    MapLandmarks,
    MapObservations,
    MapViews,
    load_map,
    save_map,
    without_memory,
)
from rholoc.recordings import read_recording

CAMERA = Camera(640, 480, 520.0, 520.0, 319.5, 239.5)
FEATURES_PER_ROOM = 1000
VIEWS_PER_ROOM = 24
ROOM_PITCH_M = 10.0
COPY_PITCH_M = 200.0
FLIPPED_BITS = 14
QUERIES = 40
RIGHT_M = 0.1
STAGES = ("place", "match", "seed", "ascend", "verify")


@dataclass(frozen=True, eq=False)
class Asked:
    """A frame, and where it was taken (4, 4)."""

    query: Query
    truth: FloatArray


@dataclass(frozen=True)
class Figures:
    """What one size of map came to."""

    landmarks: int
    views: int
    file_mb: float
    peak_mb: float
    first_s: float
    stages_ms: dict[str, float]
    cpu_ms: float
    right: float
    wrong: float


# -- maps ------------------------------------------------------------------------------------------------------------


def room_points(rng: np.random.Generator, centre: np.ndarray) -> np.ndarray:
    """Points on the walls of a room of 6 × 5 × 3 m, (FEATURES_PER_ROOM, 3)."""
    n = FEATURES_PER_ROOM
    along, height, wall = rng.uniform(-1, 1, n), rng.uniform(0.2, 2.8, n), rng.integers(0, 4, n)
    x = np.choose(wall, [3.0 * along, np.full(n, 3.0), 3.0 * along, np.full(n, -3.0)])
    y = np.choose(wall, [np.full(n, 2.5), 2.5 * along, np.full(n, -2.5), 2.5 * along])
    return np.asarray(np.column_stack([x, y, height]) + centre)


def room_views(centre: np.ndarray) -> list[Pose]:
    """Views from a circle in the room, looking outwards."""
    turns = np.linspace(0, 2 * np.pi, VIEWS_PER_ROOM, endpoint=False)
    return [
        Pose.from_heading(centre + np.array([np.cos(t), np.sin(t), 1.4]), np.array([np.cos(t), np.sin(t), 0.0]))
        for t in turns
    ]


def building(rooms: int) -> Map:
    """A map of rooms in a row."""
    rng = np.random.default_rng(3)
    centres = [np.array([ROOM_PITCH_M * room, 0.0, 0.0]) for room in range(rooms)]
    points = np.concatenate([room_points(rng, centre) for centre in centres])
    poses = [pose for centre in centres for pose in room_views(centre)]
    seen = []
    for number, pose in enumerate(poses):
        first = number // VIEWS_PER_ROOM * FEATURES_PER_ROOM
        mine = points[first : first + FEATURES_PER_ROOM]
        pixels = CAMERA.project((mine - pose.position) @ pose.R_map_camera)
        seen.append(first + np.flatnonzero(CAMERA.contains(pixels)))
    n = len(points)
    covariances = np.tile(np.float32(0.005**2) * np.eye(3, dtype=np.float32), (n, 1, 1))
    info = MapInfo("0" * 32, 1, DensityKind.RAY, "gray", True, True, "2026-01-01T00:00:00+00:00", CAMERA)
    return Map(
        info=info,
        landmarks=MapLandmarks(
            channels=np.zeros(n, np.uint8), positions=points.astype(np.float32), covariances=covariances
        ),
        descriptors=MapDescriptors(
            values=rng.integers(0, 256, (n, 32), dtype=np.uint8), features=np.arange(n, dtype=np.int32)
        ),
        views=MapViews(
            times=np.arange(len(poses), dtype=np.float64), T_map_camera=np.array([pose.T_map_camera for pose in poses])
        ),
        observations=MapObservations(
            views=np.repeat(np.arange(len(poses)), [*map(len, seen)]).astype(np.int32),
            features=np.concatenate(seen).astype(np.int32),
        ),
    )


def side_by_side(maps: Sequence[Map], landmarks: int) -> Map:
    """Maps, then copies of them, until there are so many landmarks, in one."""
    rng = np.random.default_rng(0)
    parts: list[Map] = []
    for number in count():
        parts.append(shifted(maps[number % len(maps)], number, rng if number >= len(maps) else None))
        if sum(map(len, parts)) >= landmarks:
            break
    first_feature = np.cumsum([0, *map(len, parts)])
    first_view = np.cumsum([0, *(len(part.views) for part in parts)])
    return replace(
        parts[0],
        landmarks=replace(
            parts[0].landmarks,
            channels=np.concatenate([part.landmarks.channels for part in parts]),
            positions=np.concatenate([part.landmarks.positions for part in parts]),
            covariances=np.concatenate([part.landmarks.covariances for part in parts]),
        ),
        descriptors=replace(
            parts[0].descriptors,
            values=np.concatenate([part.descriptors.values for part in parts]),
            features=numbered([part.descriptors.features for part in parts], first_feature),
        ),
        views=replace(
            parts[0].views,
            times=np.arange(first_view[-1], dtype=np.float64),
            T_map_camera=np.concatenate([part.views.T_map_camera for part in parts]),
            covariances=np.concatenate([part.views.known_covariances for part in parts]),
        ),
        observations=replace(
            parts[0].observations,
            views=numbered([part.observations.views for part in parts], first_view),
            features=numbered([part.observations.features for part in parts], first_feature),
        ),
    )


def numbered(parts: Sequence[np.ndarray], first: np.ndarray) -> np.ndarray:
    """Rows of the parts as rows of the whole."""
    return np.concatenate([rows + start for rows, start in zip(parts, first, strict=False)]).astype(np.int32)


def shifted(map_: Map, number: int, rng: np.random.Generator | None) -> Map:
    """A map some way along x; with ``rng``, of a place that looks otherwise."""
    shift = np.array([COPY_PITCH_M * number, 0.0, 0.0])
    T_map_camera = map_.views.T_map_camera.copy()
    T_map_camera[:, :3, 3] += shift
    size = map_.descriptors.values.shape[1]
    order = np.arange(size) if rng is None else rng.permutation(size)
    return without_memory(
        replace(
            map_,
            landmarks=replace(
                map_.landmarks, positions=(map_.landmarks.positions + shift).astype(np.float32), colours=None
            ),
            views=replace(map_.views, T_map_camera=T_map_camera),
            descriptors=replace(map_.descriptors, values=map_.descriptors.values[:, order]),
        )
    )


# -- queries ---------------------------------------------------------------------------------------------------------


def query(map_: Map, truth: Pose, rng: np.random.Generator) -> FeatureSet:
    """What a camera at ``truth`` detects: landmarks in view, disturbed, and as many detections that match nothing."""
    near = np.flatnonzero(np.linalg.norm(map_.landmarks.positions - truth.position, axis=1) < ROOM_PITCH_M / 2)
    pixels = CAMERA.project((map_.landmarks.positions[near] - truth.position) @ truth.R_map_camera)
    inside = CAMERA.contains(pixels)
    bits = np.unpackbits(map_.descriptors.values[near[inside]], axis=1)
    descriptors = np.packbits(bits ^ (rng.random(bits.shape) < FLIPPED_BITS / 256), axis=1)
    stray = 1000 - int(inside.sum())
    every = np.concatenate([pixels[inside] + rng.normal(size=(int(inside.sum()), 2)), rng.uniform(0, 480, (stray, 2))])
    descriptors = np.concatenate([descriptors, rng.integers(0, 256, (stray, 32), dtype=np.uint8)])
    zeros = np.zeros(len(every), np.float32)
    return FeatureSet(every.astype(np.float32), zeros.astype(np.uint8), descriptors, zeros, zeros)


def beside(view: np.ndarray) -> Pose:
    """A pose a little to the side of a view (4, 4)."""
    return Pose.from_heading(view[:3, 3] + np.array([0.15, 0.1, 0.05]), view[:3, 2])


def synthetic_queries(map_: Map) -> list[Asked]:
    """Beside some of the views of a synthetic map."""
    rng = np.random.default_rng(5)
    chosen = map_.views.T_map_camera[:: max(1, len(map_.views) // QUERIES)][:QUERIES]
    truths = [beside(pose) for pose in chosen]
    return [Asked(Query(query(map_, truth, rng), CAMERA, Dof.FREE), truth.T_map_camera) for truth in truths]


def walk_queries(walk: Path, camera: str | None, frames: str | None, every: int, features: str) -> list[Asked]:
    """The frames of a walk with poses."""
    recording = read_recording(walk, camera=camera, frames=frames)
    assert recording.poses is not None
    assert recording.camera is not None
    extractor = get_extractor(features)
    rows = [int(row) for row in islice(np.flatnonzero(recording.poses.known), 0, None, every)]
    images = recording.frames.images(rows)
    return [
        Asked(Query(extractor.extract(image), recording.camera), recording.poses.T_map_camera[row])
        for row, image in zip(rows, images, strict=True)
    ]


# -- figures ---------------------------------------------------------------------------------------------------------


def measured(path: Path, asked: list[Asked], everywhere: bool) -> Figures:
    """Read a map and ask it."""
    begun = time.perf_counter()
    map_ = load_map(path)
    localizer = Localizer(map_) if everywhere else localizer_of(map_)
    localizer.localize(asked[0].query)
    first_s = time.perf_counter() - begun
    spent: list[dict[str, float]] = []
    cpu_ms, right, given = [], 0, 0
    for one in asked:
        begun = time.thread_time()
        answer = localizer.localize(one.query)
        cpu_ms.append(1e3 * (time.thread_time() - begun))
        spent.append(answer.timings_ms)
        given += answer.localized
        right += answer.pose is not None and bool(np.linalg.norm(answer.pose.position - one.truth[:3, 3]) < RIGHT_M)
    return Figures(
        len(map_),
        len(map_.views),
        path.stat().st_size / 1e6,
        resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        first_s,
        {stage: float(np.median([times.get(stage, 0.0) for times in spent])) for stage in STAGES},
        float(np.median(cpu_ms)),
        right / len(asked),
        (given - right) / len(asked),
    )


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--landmarks", default="1000,10000,100000,1000000")
    parser.add_argument("--maps", type=Path, nargs="+", default=[])
    parser.add_argument("--queries", type=Path)
    parser.add_argument("--camera")
    parser.add_argument("--frames")
    parser.add_argument("--every", type=int, default=6)
    parser.add_argument("--everywhere", action="store_true")
    args = parser.parse_args()
    maps = [load_map(path) for path in args.maps]
    asked: list[Asked] = []
    if maps:
        asked = walk_queries(args.queries, args.camera, args.frames, args.every, maps[0].info.features)
    columns = ("landmarks", "views", "file MB", "peak MB", "first s", *STAGES, "cpu ms", "slope", "right %", "wrong %")
    print("".join(f"{name:>10}" for name in columns), flush=True)
    before: Figures | None = None
    for landmarks in map(int, args.landmarks.split(",")):
        map_ = side_by_side(maps, landmarks) if maps else building(max(1, landmarks // FEATURES_PER_ROOM))
        asked = asked if maps else synthetic_queries(map_)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "map.rho"
            save_map(map_, path)
            del map_
            alone = multiprocessing.get_context("spawn")
            with ProcessPoolExecutor(1, mp_context=alone) as process:
                found = process.submit(measured, path, asked, args.everywhere).result()
        slope = "–"
        if before is not None and found.landmarks > before.landmarks:
            longer = math.log(found.cpu_ms / before.cpu_ms) / math.log(found.landmarks / before.landmarks)
            slope = f"{longer:.2f}"
        stages = "".join(f"{found.stages_ms[stage]:10.1f}" for stage in STAGES)
        print(
            f"{found.landmarks:10}{found.views:10}{found.file_mb:10.1f}{found.peak_mb:10.0f}{found.first_s:10.2f}"
            f"{stages}{found.cpu_ms:10.1f}{slope:>10}{100 * found.right:10.1f}{100 * found.wrong:10.1f}",
            flush=True,
        )
        before = found


if __name__ == "__main__":
    main()
