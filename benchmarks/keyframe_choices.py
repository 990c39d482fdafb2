"""Structure from motion of one walk from ten choices of its frames: does each come out right, or does it say that not?

    python benchmarks/keyframe_choices.py RECORDING --camera fx,fy,cx,cy --frames 400:1000 --only 3+0 6+5

The recording's own poses are used for nothing but the errors, after a similarity alignment of the camera centres. A
choice is every n-th frame from an offset on, written n+offset. Prints a table; one choice after another, minutes each.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from rholoc.recordings import read_recording
from rholoc.trajectory import PoseMethod, estimate_trajectory
from rholoc.trajectory.alignment import align_poses, rotation_angles_deg

CHOICES = ("3+0", "3+1", "4+0", "4+1", "4+3", "5+0", "5+2", "6+0", "6+3", "6+5")


def measure(path: Path, camera: str, start: int, stop: int, choice: str) -> str:
    """One row of the table."""
    step, offset = (int(part) for part in choice.split("+"))
    recording = read_recording(path, camera=camera, frames=f"{start + offset}:{stop}:{step}")
    assert recording.poses is not None
    began = time.monotonic()
    found = estimate_trajectory(replace(recording, poses=None, waypoints=()), PoseMethod.VISUAL)
    seconds = time.monotonic() - began
    truth = recording.poses.T_map_camera[found.rows]
    aligned = align_poses(found.T_map_camera, truth).poses(found.T_map_camera)
    error_cm = 100 * np.linalg.norm(aligned[:, :3, 3] - truth[:, :3, 3], axis=1)
    angle_deg = rotation_angles_deg(np.swapaxes(aligned[:, :3, :3], 1, 2) @ truth[:, :3, :3])
    return (
        f"{choice:>6} {found.report.frames:4}/{found.report.keyframes:<4} {np.median(error_cm):9.2f}"
        f" {error_cm.max():9.2f} {np.median(angle_deg):10.2f}  {found.report.trusted!s:7} {seconds:6.0f}"
        f"  {found.report.why}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--camera", required=True)
    parser.add_argument("--frames", required=True, help="start:stop")
    parser.add_argument("--only", nargs="+", default=CHOICES, help="some of the choices")
    arguments = parser.parse_args()
    start, stop = (int(part) for part in arguments.frames.split(":"))
    print("choice    placed median cm  worst cm median deg  trusted      s")
    for choice in arguments.only:
        print(measure(arguments.recording, arguments.camera, start, stop, choice), flush=True)


if __name__ == "__main__":
    main()
