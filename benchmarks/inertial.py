"""Poses by the IMU between waypoints, without pictures: leg by leg, and adjusted over the whole walk.

    python benchmarks/inertial.py [--cache DIR] [--seeds 0,1,2,3,4,5,6,7,8,9]

Simulated walks of 30 s through the test site, five waypoints each, against their truth. The cache has a folder
`s{seed}w1` for each walk; walks that are missing are simulated into it. Prints the median and the 90th percentile
of positions, and the median angle of rotations, of every walk, then the medians and the worst of all walks' medians.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np

from rholoc.evaluation.splits import with_poses
from rholoc.geometry import pose_distances
from rholoc.recordings import read_recording
from rholoc.simulation import simulate_recording
from rholoc.trajectory.dead_reckoning import integrate_between_waypoints
from rholoc.trajectory.inertial_adjustment import adjust_between_waypoints

METHODS = {"leg by leg": integrate_between_waypoints, "adjusted": adjust_between_waypoints}
EVERY = 6  # frames


def main() -> None:
    parser = argparse.ArgumentParser(description="Poses by the IMU between waypoints, without pictures.")
    parser.add_argument("--cache", type=Path, default=Path(tempfile.gettempdir()) / "sim")
    parser.add_argument("--seeds", default="0,1,2,3,4,5,6,7,8,9")
    args = parser.parse_args()
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in METHODS}
    for seed in map(int, args.seeds.split(",")):
        folder = args.cache / f"s{seed}w1"
        if not folder.is_dir():
            simulate_recording(folder, seed=seed)
        walk = read_recording(folder)
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
        print(line, flush=True)
    for name, medians in found.items():
        median, worst = np.median(medians, axis=0), np.max(medians, axis=0)
        print(f"{name:10} median {median[0]:.2f} cm, {median[1]:.2f}°; worst {worst[0]:.2f} cm, {worst[1]:.2f}°")


if __name__ == "__main__":
    main()
