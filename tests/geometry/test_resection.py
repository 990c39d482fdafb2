"""Poses from rays: of narrow and of wide lenses, of one camera and of several."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rholoc.geometry import FloatArray, pose_distances, pose_matrix
from rholoc.geometry.resection import is_narrow, resected

SETTINGS = {"max_iterations": 1000, "min_iterations": 100, "max_reproj_error": 4.0, "seed": 1}
TRUE = pose_matrix(Rotation.from_euler("xyz", [10, -70, 25], degrees=True).as_matrix(), np.array([0.3, -0.4, 0.2]))


def _rays(points: FloatArray, T: FloatArray, rng: np.random.Generator, noise: float = 5e-4) -> FloatArray:
    seen = (points - T[:3, 3]) @ T[:3, :3]
    rays = seen / np.linalg.norm(seen, axis=1, keepdims=True) + noise * rng.normal(size=seen.shape)
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


@pytest.mark.parametrize("widest_deg", [50.0, 100.0, 180.0])
@pytest.mark.parametrize("wrong", [0.0, 0.6])
def test_the_pose_comes_back_whatever_the_lens(widest_deg: float, wrong: float) -> None:
    rng = np.random.default_rng(0)
    points = 3 * rng.normal(size=(3000, 3))
    rays = _rays(points, TRUE, rng)
    shown = np.flatnonzero(rays[:, 2] > np.cos(np.radians(widest_deg)))[:300]
    points, rays = points[shown], rays[shown]
    mismatched = rng.random(300) < wrong
    rays[mismatched] = rng.permutation(rays[mismatched])
    assert is_narrow(rays) is (widest_deg < 60)
    T, agreeing = resected([rays], [points], np.eye(4)[None], 400.0, SETTINGS)
    apart_m, turned_rad = pose_distances(T, TRUE)
    assert apart_m < 0.02
    assert turned_rad < 0.005
    assert abs(agreeing - (~mismatched).sum()) < 10


def test_cameras_that_look_all_ways_make_one_rig() -> None:
    rng = np.random.default_rng(1)
    R = Rotation.from_euler("y", [[0], [120], [240]], degrees=True).as_matrix()
    T_rig_camera = pose_matrix(R, 0.1 * R[:, :, 2])
    points = [3 * rng.normal(size=(60, 3)) for _ in range(3)]
    rays = [_rays(some, TRUE @ T, rng) for some, T in zip(points, T_rig_camera, strict=True)]
    T, agreeing = resected(rays, points, T_rig_camera, 400.0, SETTINGS)
    assert pose_distances(T, TRUE)[0] < 0.02
    assert agreeing > 150
