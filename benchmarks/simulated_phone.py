"""A simulated phone's recording → poses in the map frame: how far they are from the truth.

    python benchmarks/simulated_phone.py [--seed 0] [--readout-ms 15] [--delay-ms 30] [--json]

A hand's motion, an IMU with biases and noise whose clock is off, a rolling shutter. Once with the measured waypoints,
once with the IMU alone, whose map begins at the first camera: errors of its scale and of the vertical, and of positions
after a rigid alignment, which does not mend a wrong scale. Then with a read-out time that was not logged.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from rholoc.evaluation import rigid_alignment, trajectory_errors
from rholoc.geometry import FloatArray, umeyama
from rholoc.recordings import Recording, read_recording
from rholoc.simulation import simulate_recording
from rholoc.trajectory import PoseMethod, estimate_trajectory


def in_map_frame(recording: Recording, truth: FloatArray) -> dict[str, float | int | bool]:
    """Errors of the keyframes as they stand."""
    found = estimate_trajectory(recording, PoseMethod.VISUAL_INERTIAL)
    T, true = found.T_map_camera, truth[found.rows]
    return {"keyframes": len(T), "trusted": found.report.trusted, **errors(T, true)}


def by_imu_alone(recording: Recording, truth: FloatArray) -> dict[str, float | int | bool]:
    """Errors of scale and vertical, and of the keyframes after a rigid alignment."""
    found = estimate_trajectory(replace(recording, waypoints=()), PoseMethod.VISUAL_INERTIAL)
    T, true = found.T_map_camera, truth[found.rows]
    free = umeyama(T[:, :3, 3], true[:, :3, 3])
    turned = Rotation.from_matrix(true[:, :3, :3] @ np.swapaxes(T[:, :3, :3], 1, 2)).mean()
    return {
        "keyframes": len(T),
        "trusted": found.report.trusted,
        "scale_error_percent": 100 * (1 / free.scale - 1),
        "vertical_error_deg": float(np.degrees(np.arccos(np.clip(turned.as_matrix()[2, 2], -1, 1)))),
        **errors(rigid_alignment(T, true) @ T, true),
    }


def errors(T_map_camera: FloatArray, truth: FloatArray) -> dict[str, float]:
    found = trajectory_errors(T_map_camera, truth)
    distance_cm, angle_deg = 100 * found.position_m, np.degrees(found.rotation_rad)
    return {
        "median_cm": float(np.median(distance_cm)),
        "worst_cm": float(distance_cm.max()),
        "median_deg": float(np.median(angle_deg)),
        "worst_deg": float(angle_deg.max()),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--readout-ms", type=float, default=15.0)
    parser.add_argument("--delay-ms", type=float, default=30.0)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        simulated = simulate_recording(
            Path(folder) / "walk",
            seed=arguments.seed,
            imu_time_offset_s=arguments.delay_ms / 1e3,
            readout_s=arguments.readout_ms / 1e3,
        )
        recording, truth = read_recording(simulated.path), simulated.T_map_camera
        figures = {
            "waypoints": in_map_frame(recording, truth),
            "IMU alone": by_imu_alone(recording, truth),
            "waypoints, read-out not logged": in_map_frame(replace(recording, readout_s=None), truth),
        }
    if arguments.json:
        print(json.dumps(figures, indent=2))
        return
    for name, values in figures.items():
        print(name)
        for key, value in values.items():
            print(f"  {key:22}", f"{value:.2f}" if isinstance(value, float) else value)


if __name__ == "__main__":
    main()
