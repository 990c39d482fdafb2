"""How cost grows with the map: features from a thousand to a hundred thousand.

    OMP_NUM_THREADS=1 python benchmarks/scaling.py [--features 1000,10000,100000]

Maps are synthetic: rooms of points side by side, each seen from views of its own, as a building's rooms are. For each
size it prints the file's bytes, the memory at its peak, and milliseconds of localization by stage, on one thread.
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from pathlib import Path

import numpy as np

from rholoc.features import FeatureSet
from rholoc.geometry import Camera, Pose
from rholoc.localization import Dof, Localizer, Query
from rholoc.maps import DensityKind, Map, MapInfo, load_map, save_map

CAMERA = Camera(640, 480, 520.0, 520.0, 319.5, 239.5)
FEATURES_PER_ROOM = 1000
VIEWS_PER_ROOM = 24
ROOM_PITCH_M = 10.0
FLIPPED_BITS = 14
QUERIES = 12


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
        channels=np.zeros(n, np.uint8),
        landmarks=points.astype(np.float32),
        covariances=covariances,
        descriptors=rng.integers(0, 256, (n, 32), dtype=np.uint8),
        descriptor_features=np.arange(n, dtype=np.int32),
        view_times=np.arange(len(poses), dtype=np.float64),
        T_map_camera=np.array([pose.T_map_camera for pose in poses]),
        observation_views=np.repeat(np.arange(len(poses)), [*map(len, seen)]).astype(np.int32),
        observation_features=np.concatenate(seen).astype(np.int32),
    )


def query(map_: Map, truth: Pose, rng: np.random.Generator) -> FeatureSet:
    """What a camera at ``truth`` detects: landmarks in view, disturbed, and as many detections that match nothing."""
    near = np.flatnonzero(np.linalg.norm(map_.landmarks - truth.position, axis=1) < ROOM_PITCH_M / 2)
    pixels = CAMERA.project((map_.landmarks[near] - truth.position) @ truth.R_map_camera)
    inside = CAMERA.contains(pixels)
    bits = np.unpackbits(map_.descriptors[near[inside]], axis=1)
    descriptors = np.packbits(bits ^ (rng.random(bits.shape) < FLIPPED_BITS / 256), axis=1)
    stray = 1000 - int(inside.sum())
    every = np.concatenate([pixels[inside] + rng.normal(size=(int(inside.sum()), 2)), rng.uniform(0, 480, (stray, 2))])
    descriptors = np.concatenate([descriptors, rng.integers(0, 256, (stray, 32), dtype=np.uint8)])
    zeros = np.zeros(len(every), np.float32)
    return FeatureSet(every.astype(np.float32), zeros.astype(np.uint8), descriptors, zeros, zeros)


def beside(view: np.ndarray) -> Pose:
    """A pose a little to the side of a view (4, 4)."""
    return Pose.from_heading(view[:3, 3] + np.array([0.15, 0.1, 0.05]), view[:3, 2])


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--features", default="1000,10000,100000")
    args = parser.parse_args()
    print(f"{'features':>9}{'file MB':>9}{'peak MB':>9}{'index s':>9}{'match':>8}{'seed':>8}{'ascend':>8}{'verify':>8}{'total ms':>10}{'right':>8}")  # fmt: skip  # noqa: E501
    for count in map(int, args.features.split(",")):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "building.rho"
            save_map(building(max(1, count // FEATURES_PER_ROOM)), path)
            size = path.stat().st_size
            map_ = load_map(path)
        begun = time.perf_counter()
        localizer = Localizer(map_)
        rng = np.random.default_rng(5)
        chosen = map_.T_map_camera[:: max(1, len(map_.view_times) // QUERIES)][:QUERIES]
        truths = [beside(pose) for pose in chosen]
        localizer.localize(Query(query(map_, truths[0], rng), CAMERA, Dof.FREE))
        index_s = time.perf_counter() - begun
        spent: list[dict[str, float]] = []
        right = 0
        for truth in truths:
            answer = localizer.localize(Query(query(map_, truth, rng), CAMERA, Dof.FREE))
            spent.append(answer.timings_ms)
            right += answer.pose is not None and np.linalg.norm(answer.pose.position - truth.position) < 0.05
        stages = [float(np.median([s.get(name, 0.0) for s in spent])) for name in ("match", "seed", "ascend", "verify")]
        peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(f"{len(map_):9}{size / 1e6:9.2f}{peak_mb:9.0f}{index_s:9.2f}" + "".join(f"{s:8.1f}" for s in stages)
              + f"{np.median([sum(s.values()) for s in spent]):10.1f}{right:5}/{len(truths)}")  # fmt: skip


if __name__ == "__main__":
    main()
