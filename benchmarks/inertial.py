"""Poses by the IMU between waypoints, without pictures: leg by leg, and adjusted over the whole walk.

    python benchmarks/inertial.py [--cache DIR] [--seeds 0,1,2,3,4,5,6,7,8,9] [--queries 40]

Simulated walks of 30 s through the test site, five waypoints each, against their truth. The cache has a folder
`s{seed}w1` for each walk, and `s{seed}w2` for another one through the same room; those that are missing are simulated
into it. Prints the median and the 90th percentile of positions, and the median angle of rotations, of every walk, and
which share of the other walk's frames is localized within 5 cm and 5° in the map of the adjusted poses (`--queries 0`
builds no map); then the medians and the worst of all walks.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np

from rholoc.evaluation.errors import trajectory_errors
from rholoc.features import get_extractor
from rholoc.geometry import pose_distances
from rholoc.localization import Dof, Localizer, Query
from rholoc.mapping import BuildOptions, build_map
from rholoc.recordings import Recording, read_recording
from rholoc.simulation import simulate_recording
from rholoc.trajectory import PoseMethod
from rholoc.trajectory.dead_reckoning import integrate_between_waypoints
from rholoc.trajectory.inertial_adjustment import adjust_between_waypoints
from rholoc_lab.evaluation.splits import with_poses

METHODS = {"leg by leg": integrate_between_waypoints, "adjusted": adjust_between_waypoints}
EVERY = 6  # frames
LIMITS = (0.05, 5.0)  # m and degrees, within which a frame counts as localized


def walk_of(cache: Path, seed: int, number: int) -> Recording:
    """A walk of the cache, simulated where it is missing."""
    folder = cache / f"s{seed}w{number}"
    if not folder.is_dir():
        simulate_recording(folder, walk=number, seed=seed)
    return read_recording(folder)


def localized_share(walk: Recording, other: Recording, queries: int) -> float:
    """The share of another walk's frames that are localized within the limits in the map of the walk's IMU."""
    localizer = Localizer(build_map([walk], BuildOptions(poses=PoseMethod.INERTIAL, report=False)))
    extractor = get_extractor(localizer.map.info.features)
    asked = with_poses(other, use_truth=True)
    assert asked.camera is not None
    assert asked.poses is not None
    rows = np.linspace(0, len(asked.frames.times) - 1, queries).astype(np.int64)
    answers = np.full((queries, 4, 4), np.nan)
    for k, image in enumerate(asked.frames.images(rows.tolist())):
        pose = localizer.localize(Query(extractor.extract(image), asked.camera, Dof.FREE)).pose
        if pose is not None:
            answers[k] = pose.T_map_camera
    return float(trajectory_errors(answers, asked.poses.T_map_camera[rows]).within(*LIMITS).mean())


def main() -> None:
    parser = argparse.ArgumentParser(description="Poses by the IMU between waypoints, without pictures.")
    parser.add_argument("--cache", type=Path, default=Path(tempfile.gettempdir()) / "sim")
    parser.add_argument("--seeds", default="0,1,2,3,4,5,6,7,8,9")
    parser.add_argument("--queries", type=int, default=40, help="frames of the other walk; 0: no map is built")
    args = parser.parse_args()
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in METHODS}
    shares: list[float] = []
    for seed in map(int, args.seeds.split(",")):
        walk = walk_of(args.cache, seed, 1)
        assert walk.imu is not None
        stops = [waypoint.time for waypoint in walk.waypoints]
        times = walk.frames.times
        rows = np.flatnonzero((times >= min(stops)) & (times <= max(stops)))[::EVERY]
        posed = with_poses(walk, use_truth=True)
        assert posed.poses is not None
        line = f"seed {seed}"
        for name, method in METHODS.items():
            moved, turned = pose_distances(
                method(walk.imu, walk.waypoints, times[rows]), posed.poses.T_map_camera[rows]
            )
            median_cm, turned_deg = 100 * float(np.median(moved)), float(np.degrees(np.median(turned)))
            found[name].append((median_cm, turned_deg))
            line += f"   {name} {median_cm:5.2f} cm ({100 * np.percentile(moved, 90):5.1f}) {turned_deg:5.2f}°"
        if args.queries:
            shares.append(localized_share(walk, walk_of(args.cache, seed, 2), args.queries))
            line += f"   localized {shares[-1]:4.0%}"
        print(line, flush=True)
    for name, medians in found.items():
        median, worst = np.median(medians, axis=0), np.max(medians, axis=0)
        print(f"{name:10} median {median[0]:.2f} cm, {median[1]:.2f}°; worst {worst[0]:.2f} cm, {worst[1]:.2f}°")
    if shares:
        print(f"localized  mean {np.mean(shares):.0%}, median {np.median(shares):.0%}, worst {min(shares):.0%}")


if __name__ == "__main__":
    main()
