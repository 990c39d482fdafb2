"""What the IMU adds to the cameras: scale, gravity and delay found again on a walk whose poses are known.

    python benchmarks/visual_inertial.py IPHONE_FOLDER

An iOS logger's folder with poses. Its path is turned by an unknown rotation, scaled by an unknown factor and shifted in
time by 0–80 ms; prints how well scale, gravity and shift come back, with gravity in the acceleration and without.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from rholoc.geometry import pose_matrix
from rholoc.recordings import Imu, read_recording
from rholoc.trajectory.gyroscope import calibrate_gyro
from rholoc.trajectory.inertial_alignment import align_inertially

SHIFTS_S = (0.0, 0.02, 0.04, 0.06, 0.08)
G = 9.80665
EVERY = 6  # poses taken for keyframes: 10 a second of 60


def without_gravity(path: Path, imu: Imu) -> Imu:
    """The acceleration that the phone itself rid of gravity, by the same motion table's columns 8 to 10."""
    table = np.loadtxt(path / "MotARH.txt", delimiter=",")
    first_s = imu.times[0] - table[0, 0]
    rows = np.abs(table[:, 0] + first_s - imu.times[:, None]).argmin(axis=1)
    return replace(imu, acceleration=-G * table[rows, 7:10], includes_gravity=False)


def phone(path: Path) -> None:
    recording = read_recording(path)
    assert recording.imu is not None
    assert recording.poses is not None
    rows = np.flatnonzero(recording.poses.known)[::EVERY]
    times, T = recording.frames.times[rows], recording.poses.T_map_camera[rows]
    rng = np.random.default_rng(5)
    print("acceleration     shift ms  found ms   scale     ± %  gravity off °     ± °")
    for imu in (recording.imu, without_gravity(path, recording.imu)):
        base_s = 0.0
        for shift_s in SHIFTS_S:
            frame, factor = Rotation.random(rng=rng).as_matrix(), float(np.exp(rng.uniform(-2, 2)))
            own = pose_matrix(frame @ T[:, :3, :3], factor * T[:, :3, 3] @ frame.T)
            gyro = calibrate_gyro(times + shift_s, own[:, :3, :3], imu)
            assert gyro is not None
            found = align_inertially(times + shift_s, own, imu, gyro)
            assert found is not None
            found_s = -gyro.time_offset_s
            base_s = found_s if shift_s == 0 else base_s
            off_deg, sigma_deg = "", ""
            if found.up is not None:
                off_deg = f"{np.degrees(np.arccos(np.clip(found.up @ frame[:, 2], -1, 1))):.2f}"
                sigma_deg = f"{found.up_sigma_deg:.2f}"
            kind = "with gravity" if imu.includes_gravity else "without gravity"
            print(
                f"{kind:16} {1000 * shift_s:8.0f} {1000 * (found_s - base_s):9.1f} {found.scale * factor:7.4f}"
                f" {100 * found.scale_sigma:7.1f} {off_deg:>14} {sigma_deg:>7}"
            )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    phone(parser.parse_args().folder)


if __name__ == "__main__":
    main()
