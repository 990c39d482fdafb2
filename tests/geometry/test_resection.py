"""Poses from rays: of narrow and of wide lenses, of one camera and of several."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rholoc.geometry import FloatArray, pose_distances, pose_matrix, resection
from rholoc.geometry.resection import is_narrow, resected, three_point_poses

SETTINGS = {"max_iterations": 1000, "min_iterations": 100, "max_reproj_error": 4.0, "seed": 1}
TRUE = pose_matrix(Rotation.from_euler("xyz", [10, -70, 25], degrees=True).as_matrix(), np.array([0.3, -0.4, 0.2]))


@pytest.fixture(autouse=True, params=["poselib", "without"])
def solver(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every test runs with poselib, and as where it is not installed."""
    if request.param == "without":
        monkeypatch.setattr(resection, "poselib", None)


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


def test_three_points_have_few_poses_and_the_true_one_is_among_them() -> None:
    rng = np.random.default_rng(2)
    points = 3 * rng.normal(size=(300, 3, 3))
    rays = _rays(points.reshape(-1, 3), TRUE, rng, noise=0.0).reshape(-1, 3, 3)
    in_front = rays[(rays[:, :, 2] > 0.5).all(axis=1)], points[(rays[:, :, 2] > 0.5).all(axis=1)]
    poses = three_point_poses(*in_front)
    assert len(poses) <= 4 * len(in_front[0])
    apart_m, _ = pose_distances(poses, np.broadcast_to(TRUE, poses.shape))
    assert (apart_m < 1e-3).sum() >= 0.95 * len(in_front[0])
    assert len(three_point_poses(rays[:0], points[:0])) == 0


def test_samples_of_a_wide_lens_that_surround_the_camera_are_left_out_or_right() -> None:
    rays = np.array([[[1.0, 0, 0], [-0.5, 0.866, 0], [-0.5, -0.866, 0]]])
    poses = three_point_poses(rays, 2 * rays)
    assert poses.shape[1:] == (4, 4)
    assert np.isfinite(poses).all()


def test_nothing_agrees_where_there_is_nothing_to_agree_on() -> None:
    rng = np.random.default_rng(3)
    rays, points = _rays(3 * rng.normal(size=(60, 3)), TRUE, rng), 3 * rng.normal(size=(60, 3))
    _, agreeing = resected([rays], [points], np.eye(4)[None], 400.0, SETTINGS)
    assert agreeing < 12
