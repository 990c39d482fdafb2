"""What the IMU adds to the cameras, on recordings whose true poses are known.

    python benchmarks/visual_inertial.py --phone IPHONE_FOLDER
    python benchmarks/visual_inertial.py --video EUROC_FOLDER --truth groundtruth_cam0.txt

``--phone``: an iOS logger's folder with poses. Its path is turned by an unknown rotation, scaled by an unknown factor
and shifted in time by 0–80 ms; prints how well scale, gravity and shift come back, with gravity in the acceleration and
without. ``--video``: frame poses by structure from motion and IMU, from nothing but the recording; prints their errors
after a rigid alignment to the truth (time in ns, x y z qx qy qz qw a row), which does not mend a wrong scale.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from rholoc.geometry import pose_matrix
from rholoc.recordings import Imu, read_recording
from rholoc.trajectory import PoseMethod, estimate_trajectory
from rholoc.trajectory.alignment import umeyama
from rholoc.trajectory.imu_evidence import weigh_imu

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
            evidence = weigh_imu(times + shift_s, own, imu)
            assert evidence.gyro is not None
            assert evidence.alignment is not None
            found = evidence.alignment
            found_s = -evidence.gyro.time_offset_s
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


def video(path: Path, truth: Path) -> None:
    recording = replace(read_recording(path), poses=None)
    found = estimate_trajectory(recording, PoseMethod.VISUAL_INERTIAL)
    table = np.loadtxt(truth)
    times = table[:, 0] * 1e-9
    true = np.column_stack([np.interp(found.times, times, column) for column in table[:, 1:4].T])
    own = found.T_map_camera[:, :3, 3]
    similarity = umeyama(own, true)
    turned = own @ similarity.rotation.T
    rigid = turned - turned.mean(axis=0) + true.mean(axis=0)
    error_cm = 100 * np.linalg.norm(rigid - true, axis=1)
    print(f"frames placed            {found.report.frames} of {found.report.keyframes} keyframes")
    print(f"rigid alignment, rms     {np.sqrt(np.mean(error_cm**2)):.2f} cm, worst {error_cm.max():.2f} cm")
    sigma = found.report.imu.scale_sigma
    print(f"scale                    {1 / similarity.scale:.4f}, said to be good to {sigma:.1%}")
    print(f"trusted                  {found.report.trusted}: {found.report.why}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--phone", type=Path)
    parser.add_argument("--video", type=Path)
    parser.add_argument("--truth", type=Path, help="a file in the video's folder, or its path")
    arguments = parser.parse_args()
    if arguments.phone:
        phone(arguments.phone)
    if arguments.video:
        truth = arguments.truth
        video(arguments.video, truth if truth.exists() else arguments.video / truth)


if __name__ == "__main__":
    main()
