"""Recordings with depth pictures become metric without poses, IMU or waypoints."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from rholoc.geometry import align_poses
from rholoc.recordings import read_recording
from rholoc.simulation import PHONE_CAMERA, Renderer, make_test_site, make_walk
from rholoc.trajectory import PoseMethod, Scale
from rholoc.trajectory.estimate import estimate_trajectory


@pytest.mark.slow
def test_depth_pictures_make_a_walk_metric(tmp_path: Path) -> None:
    """Files as 7-Scenes has them, of a simulated room."""
    scene = make_test_site(0)
    renderer = Renderer(scene, [face.paint.albedo for face in scene.faces])
    camera, depth_camera = PHONE_CAMERA, PHONE_CAMERA.resized(160, 120)
    poses = make_walk(1).poses(np.arange(0, 6, 0.4))
    for i, pose in enumerate(poses):
        name = tmp_path / f"frame-{i:06d}"
        depth = np.round(1000 * renderer.surface(depth_camera, pose).depth).astype(np.uint16)
        assert cv2.imwrite(f"{name}.color.png", renderer.radiance(camera, [pose] * 4))
        assert cv2.imwrite(f"{name}.depth.png", depth)
        np.savetxt(f"{name}.pose.txt", pose.T_map_camera)
    recording = read_recording(tmp_path)
    assert recording.depth is not None
    depth_images = replace(recording.depth, camera=depth_camera)
    found = estimate_trajectory(replace(recording, camera=camera, poses=None, depth=depth_images), PoseMethod.AUTO)
    assert found.scale is Scale.METRIC
    assert found.report.scale is not None
    assert found.report.scale.startswith("Depth pictures fix the scale to 1.")
    T = np.array([poses[row].T_map_camera for row in found.rows])
    assert align_poses(found.T_map_camera, T).scale == pytest.approx(1.0, abs=0.02)
