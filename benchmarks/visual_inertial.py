"""What the IMU adds to the cameras: scale, gravity and delay found again on a walk whose poses are known.

    python benchmarks/visual_inertial.py IPHONE_FOLDER

An iOS logger's folder with poses. Its rotations are turned by an unknown one, its clock is shifted by 0–80 ms, and of
its path only directions between pairs of keyframes are kept, disturbed by half a degree; prints how well scale, gravity
and shift come back.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from rholoc.geometry import FloatArray, umeyama
from rholoc.recordings import read_recording
from rholoc.trajectory.inertial.gyroscope import calibrate_gyro
from rholoc.trajectory.initialization.inertial_start import inertial_start
from rholoc.trajectory.visual.directions import PairDirection

SHIFTS_S = (0.0, 0.02, 0.04, 0.06, 0.08)
EVERY = 6  # poses taken for keyframes: 10 a second of 60
FURTHER = (1, 2, 4, 8)  # keyframes, between which directions are known
NOISE_RAD = np.radians(0.5)
LEAST_WAY_M = 0.01
SEED = 5


def directions_between(positions: FloatArray, rng: np.random.Generator) -> list[PairDirection]:
    """Noisy directions between positions (K, 3)."""
    found = []
    for step in FURTHER:
        for first in range(len(positions) - step):
            way = positions[first + step] - positions[first]
            length = float(np.linalg.norm(way))
            if length < LEAST_WAY_M:
                continue
            unit = way / length + rng.normal(0, NOISE_RAD, 3)
            found.append(PairDirection(first, first + step, unit / np.linalg.norm(unit), float(NOISE_RAD)))
    return found


def phone(path: Path) -> None:
    recording = read_recording(path)
    assert recording.imu is not None
    assert recording.poses is not None
    rows = np.flatnonzero(recording.poses.known)[::EVERY]
    times, T = recording.frames.times[rows], recording.poses.T_map_camera[rows]
    rng = np.random.default_rng(SEED)
    print("shift ms  found ms   scale  gravity off °  path off cm (rms, similarity taken out)")
    base_s = 0.0
    for shift_s in SHIFTS_S:
        frame = Rotation.random(rng=rng).as_matrix()
        R, positions = frame @ T[:, :3, :3], T[:, :3, 3] @ frame.T
        gyro = calibrate_gyro(times + shift_s, R, recording.imu)
        assert gyro is not None
        found = inertial_start(times + shift_s, R, directions_between(positions, rng), recording.imu, gyro)
        assert found is not None
        base_s = -gyro.time_offset_s if shift_s == 0 else base_s
        off_deg = np.degrees(np.arccos(np.clip(found.up @ frame[:, 2], -1, 1)))
        to_truth = umeyama(found.positions, positions)
        off_m = np.linalg.norm(to_truth.points(found.positions) - positions, axis=1)
        print(
            f"{1000 * shift_s:8.0f} {1000 * (-gyro.time_offset_s - base_s):9.1f} {1 / to_truth.scale:7.4f}"
            f" {off_deg:14.2f} {100 * np.sqrt(np.mean(off_m**2)):12.1f}"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    phone(parser.parse_args().folder)


if __name__ == "__main__":
    main()
