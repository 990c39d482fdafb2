"""Frame poses of a real hand-held walk from its images and four measured waypoints, against its true poses."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rholoc.geometry import pose_matrix
from rholoc.recordings import Waypoint, read_recording
from rholoc.trajectory import PoseMethod, Scale, estimate_trajectory

_WAYPOINT_FRAMES = (424, 700, 772, 976)  # the far ends of the walk, along it and across: they fix its rotation
_CAMERA = "525.505,525.505,320,240"


@pytest.mark.real
@pytest.mark.slow
@pytest.mark.timeout(300)
def test_redkitchen_is_placed_from_images_and_four_waypoints(real_data: Path) -> None:
    table = np.loadtxt(real_data / "redkitchen" / "poses.txt")
    truth = {int(row[0]): row[1:] for row in table}
    recording = read_recording(real_data / "redkitchen", camera=_CAMERA, frames="400:1000:6")
    numbers = recording.frames.numbers
    rows = [int(np.flatnonzero(numbers == number)[0]) for number in _WAYPOINT_FRAMES]
    waypoints = tuple(
        Waypoint(f"W{n}", float(recording.frames.times[row]), tuple(truth[n][:3]))
        for n, row in zip(_WAYPOINT_FRAMES, rows, strict=True)
    )
    recording = replace(recording, poses=None, waypoints=waypoints)

    trajectory = estimate_trajectory(recording, PoseMethod.VISUAL)

    true = np.array([truth[int(numbers[row])] for row in trajectory.rows])
    T = pose_matrix(Rotation.from_quat(true[:, 3:]).as_matrix(), true[:, :3])
    position_cm = 100 * np.linalg.norm(trajectory.T_map_camera[:, :3, 3] - T[:, :3, 3], axis=1)
    turned = Rotation.from_matrix(np.swapaxes(trajectory.T_map_camera[:, :3, :3], 1, 2) @ T[:, :3, :3])
    angle_deg = np.degrees(turned.magnitude())
    assert trajectory.report["trusted"], trajectory.report["why"]
    assert trajectory.scale is Scale.METRIC
    assert not trajectory.upright  # this camera rolls, and nothing measured gravity
    assert trajectory.report["frames"] >= 0.95 * trajectory.report["keyframes"] >= 60
    assert max(trajectory.report["waypoint_residuals_m"].values()) < 0.05
    assert np.median(position_cm) < 2.0
    assert np.percentile(position_cm, 90) < 4.0
    assert np.median(angle_deg) < 2.0
