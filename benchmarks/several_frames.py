"""Several frames, one answer: how often they are placed where a frame alone is not.

    python benchmarks/several_frames.py MAP.rho POSED_WALK --camera fx,fy,cx,cy --frames 100:400 --every 12

Asks a map in three ways, by frames of a walk whose poses are known: each by itself; five of them over a metre of the
way, their relative poses the true ones with the noise of odometry (5 mm and 0.2° a step); and pairs that look at least
30° apart from nearly the same place, as a rig's two cameras do. Prints the share whose first frame is within
5 cm and 5°.
"""

from __future__ import annotations

import argparse
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from rholoc.geometry import FloatArray, angles_between, pose_distances
from rholoc.localization import Localizer, Query, SeveralFrames, localize_together
from rholoc.maps import load_map
from rholoc.recordings import Recording, read_recording

FRAMES, WAY_M = 5, 1.0
SIGMA_M, SIGMA_RAD = 0.005, np.deg2rad(0.2)
NEAR_M, NEAR_RAD = 0.05, np.deg2rad(5.0)
APART_RAD, BESIDE_M = np.deg2rad(30.0), 0.5


def over_a_metre(T: FloatArray, first: int) -> list[int]:
    """Rows of frames from ``first`` on, at equal ways from each other, over a metre; fewer where the walk ends."""
    way_m = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(T[first:, :3, 3], axis=0), axis=1))])
    return [first + int(np.argmax(way_m >= at)) for at in np.linspace(0, WAY_M, FRAMES) if way_m[-1] >= at]


def beside(T: FloatArray, first: int) -> list[int]:
    """Rows of a frame and the nearest that looks far aside; the frame alone where there is none."""
    apart_m = np.linalg.norm(T[:, :3, 3] - T[first, :3, 3], axis=1)
    turned = angles_between(T[:, :3, 2], T[first, :3, 2])
    fit = np.flatnonzero((turned > APART_RAD) & (apart_m < BESIDE_M))
    return [first] if len(fit) == 0 else [first, int(fit[np.argmin(apart_m[fit])])]


def odometry(T: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Poses (N, 4, 4) as odometry has them: each step a little off."""
    found = [np.eye(4)]
    for before, now in pairwise(T):
        step = np.linalg.inv(before) @ now
        step[:3, 3] += rng.normal(0, SIGMA_M, 3)
        step[:3, :3] = step[:3, :3] @ Rotation.from_rotvec(rng.normal(0, SIGMA_RAD, 3)).as_matrix()
        found.append(found[-1] @ step)
    return np.array(found)


def measure(localizer: Localizer, walk: Recording, every: int) -> dict[str, tuple[int, float]]:
    """For each way to ask: of how many, and the share that is right."""
    assert walk.poses is not None
    assert walk.camera is not None
    T, camera, rng = walk.poses.T_map_camera, walk.camera, np.random.default_rng(0)
    queries: dict[int, Query] = {}

    def query(row: int) -> Query:
        if row not in queries:
            image = next(iter(walk.frames.images([row])))
            queries[row] = Query(localizer.extractor.extract(image), camera)
        return queries[row]

    def together(rows: list[int], T_rig: FloatArray) -> bool:
        asked = SeveralFrames(tuple(query(row) for row in rows), T_rig, SIGMA_M, float(SIGMA_RAD))
        return right(localize_together(localizer, asked).first.pose, rows[0])

    def right(pose: object, row: int) -> bool:
        if pose is None:
            return False
        apart_m, turned = pose_distances(pose.T_map_camera, T[row])  # type: ignore[attr-defined]
        return bool(apart_m <= NEAR_M and turned <= NEAR_RAD)

    alone, five, of_pairs, pairs = [], [], [], []
    for row in range(0, len(T), every):
        alone.append(right(localizer.localize(query(row)).pose, row))
        way = over_a_metre(T, row)
        if len(way) == FRAMES:
            five.append(together(way, odometry(T[way], rng)))
        rig = beside(T, row)
        if len(rig) == 2:
            pairs.append(together(rig, np.linalg.inv(T[rig[0]]) @ T[rig]))
            of_pairs.append(alone[-1])
    named = {"a frame alone": alone, "five over a metre": five, "first of a pair alone": of_pairs, "pairs": pairs}
    return {name: (len(found), float(np.mean(found)) if found else float("nan")) for name, found in named.items()}


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("map", type=Path)
    parser.add_argument("walk", type=Path)
    parser.add_argument("--camera")
    parser.add_argument("--frames")
    parser.add_argument("--every", type=int, default=12)
    args = parser.parse_args()
    walk = read_recording(args.walk, camera=args.camera, frames=args.frames)
    for name, (count, share) in measure(Localizer(load_map(args.map)), walk, args.every).items():
        print(f"{name:24} {count:4}  {100 * share:5.1f} % within 5 cm and 5°", flush=True)


if __name__ == "__main__":
    main()
