"""Several frames, one answer: how often they are placed where a frame alone is not.

    python benchmarks/several_frames.py MAP.rho POSED_WALK --camera fx,fy,cx,cy --frames 100:400 --every 12

Asks a map in three ways, by frames of a walk whose poses are known: each by itself; five of them over a metre of the
way, their relative poses the true ones with the noise of odometry (5 mm and 0.2° a step); and pairs that look at least
30° apart from nearly the same place, as a rig's two cameras do. Prints of the first frames the share within 5 cm and
5°, and the median error.
"""

import argparse
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from rholoc.geometry import FloatArray, Pose, angles_between, pose_distances
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


def measure(localizer: Localizer, walk: Recording, every: int) -> dict[str, list[tuple[float, float]]]:
    """For each way to ask: how far off the first frames are [m, rad]; infinitely where they are not answered."""
    assert walk.poses is not None
    assert walk.camera is not None
    T, camera, rng = walk.poses.T_map_camera, walk.camera, np.random.default_rng(0)
    queries: dict[int, Query] = {}

    def query(row: int) -> Query:
        if row not in queries:
            image = next(iter(walk.frames.images([row])))
            queries[row] = Query(localizer.extractor.extract(image), camera)
        return queries[row]

    def together(rows: list[int], T_rig: FloatArray) -> tuple[float, float]:
        asked = SeveralFrames(tuple(query(row) for row in rows), T_rig, SIGMA_M, float(SIGMA_RAD))
        return off(localize_together(localizer, asked).first.pose, rows[0])

    def off(pose: Pose | None, row: int) -> tuple[float, float]:
        if pose is None:
            return np.inf, np.inf
        apart_m, turned_rad = pose_distances(pose.T_map_camera, T[row])
        return float(apart_m), float(turned_rad)

    alone, five, of_pairs, pairs = [], [], [], []
    for row in range(0, len(T), every):
        alone.append(off(localizer.localize(query(row)).pose, row))
        way = over_a_metre(T, row)
        if len(way) == FRAMES:
            five.append(together(way, odometry(T[way], rng)))
        rig = beside(T, row)
        if len(rig) == 2:
            pairs.append(together(rig, np.linalg.inv(T[rig[0]]) @ T[rig]))
            of_pairs.append(alone[-1])
    return {"a frame alone": alone, "five over a metre": five, "first of a pair alone": of_pairs, "pairs": pairs}


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
    for name, errors in measure(Localizer(load_map(args.map)), walk, args.every).items():
        off_m, off_rad = np.array(errors).reshape(-1, 2).T
        near = (off_m <= NEAR_M) & (off_rad <= NEAR_RAD)
        share, median_cm = (100 * near.mean(), 100 * np.median(off_m)) if errors else (np.nan, np.nan)
        print(f"{name:24} {len(errors):4}  {share:5.1f} % within 5 cm and 5°, median {median_cm:.2f} cm", flush=True)


if __name__ == "__main__":
    main()
