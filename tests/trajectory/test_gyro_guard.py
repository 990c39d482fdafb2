"""A room whose four walls look the same: what the cameras alone make of it, and what with the gyroscope's help."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rholoc.features import Channel, FeatureSet
from rholoc.geometry import Camera, FloatArray, pose_matrix
from rholoc.recordings import Imu
from rholoc.trajectory.alignment import align_poses
from rholoc.trajectory.gyro_guard import GyroGuard
from rholoc.trajectory.imu_evidence import weigh_imu
from rholoc.trajectory.two_view import VerifiedPair
from rholoc.trajectory.visual import structure_from_motion

_CAMERA = Camera(640, 480, 400.0, 400.0, 319.5, 239.5)
_KEYFRAMES = 44
_SECONDS = 32.0


def _turning(times: FloatArray) -> FloatArray:
    """Once about the room, T_map_camera (N, 4, 4): looking outwards from a circle of 0.8 m."""
    angle = 2 * np.pi * times / _SECONDS
    centres = np.column_stack([0.8 * np.cos(angle), 0.8 * np.sin(angle), 0.15 * np.sin(5 * angle)])
    level = Rotation.from_euler("y", 90, degrees=True) * Rotation.from_euler("z", -90, degrees=True)
    return pose_matrix((Rotation.from_rotvec(np.outer(angle, [0, 0, 1])) * level).as_matrix(), centres)


def _room() -> tuple[FloatArray, np.ndarray[tuple[int, int], np.dtype[np.uint8]]]:
    """Points in four niches, one to a wall, and descriptors: the niches look the same, what is between does not."""
    rng = np.random.default_rng(3)
    niche = np.column_stack([rng.uniform(2.2, 3.4, 260), rng.uniform(-1.2, 1.2, 260), rng.uniform(-1.5, 1.5, 260)])
    between = np.column_stack([rng.uniform(2.4, 3.0, 60), rng.uniform(1.4, 2.6, 60), rng.uniform(-1.5, 1.5, 60)])
    look_alike = rng.integers(0, 100, (260, 128), dtype=np.uint8)
    points, descriptors = [], []
    for quarter in range(4):
        R = Rotation.from_euler("z", 90 * quarter, degrees=True)
        points += [R.apply(niche), R.apply(between)]
        descriptors += [look_alike, rng.integers(0, 100, (60, 128), dtype=np.uint8)]
    return np.concatenate(points), np.concatenate(descriptors)


def _see(T_map_camera: FloatArray) -> list[FeatureSet]:
    points, descriptors = _room()
    rng = np.random.default_rng(0)
    seen = []
    for T in T_map_camera:
        inside = (points - T[:3, 3]) @ T[:3, :3]
        pixels = _CAMERA.project(inside) + rng.normal(0, 0.4, (len(points), 2))
        rows = np.flatnonzero((inside[:, 2] > 0.2) & _CAMERA.contains(pixels))
        zeros = np.zeros(len(rows), np.float32)
        channels = np.full(len(rows), Channel.SIFT, np.uint8)
        seen.append(FeatureSet(pixels[rows].astype(np.float32), channels, descriptors[rows], zeros, zeros))
    return seen


def _imu() -> Imu:
    t = np.arange(-1.0, _SECONDS + 1.0, 0.01)
    T = _turning(t)
    R = Rotation.from_matrix(T[:, :3, :3])
    rate = 2 * np.pi / _SECONDS * R.inv().apply([0.0, 0.0, 1.0])
    force = np.add(np.gradient(np.gradient(T[:, :3, 3], t, axis=0), t, axis=0), [0.0, 0.0, 9.81])
    return Imu(t, R.inv().apply(force), np.add(rate, [0.01, -0.005, 0.004]), True, np.eye(3))


def _worst_m(T_world_camera: FloatArray, truth: FloatArray) -> float:
    aligned = align_poses(T_world_camera, truth).poses(T_world_camera)
    return float(np.linalg.norm(aligned[:, :3, 3] - truth[:, :3, 3], axis=1).max())


@pytest.mark.slow
def test_the_gyroscope_keeps_walls_that_look_alike_apart() -> None:
    times = np.linspace(0, _SECONDS * 0.97, _KEYFRAMES)
    truth = _turning(times)
    features = _see(truth)

    alone = structure_from_motion(features, _CAMERA, (640, 480))
    model = alone.reconstruction
    assert model.reprojection_error_px < 0.6  # it looks perfect …
    assert alone.trusted  # … from any choice of keyframes …
    assert _worst_m(model.T_world_camera, truth[model.placed]) > 0.5  # … and is wrong,
    evidence = weigh_imu(times[model.placed], model.T_world_camera, _imu())
    assert any("gyroscope contradicts" in doubt for doubt in evidence.doubts)  # which the gyroscope tells

    guarded = structure_from_motion(features, _CAMERA, (640, 480), GyroGuard(times, _imu()))
    model = guarded.reconstruction
    assert guarded.contradicted > 30
    assert len(model.placed) == _KEYFRAMES
    assert _worst_m(model.T_world_camera, truth) < 0.02
    evidence = weigh_imu(times, model.T_world_camera, _imu())
    assert evidence.kept.all()
    assert not evidence.doubts


def _pair(first: int, second: int, times: FloatArray, turned: float, quarters: int = 0) -> VerifiedPair:
    """Matches of a poster that both saw, or of that which hangs ``quarters`` further; its rotation ``turned`` off."""
    rng = np.random.default_rng(first)
    poster = np.column_stack([np.full(60, 3.0), rng.uniform(-1, 1, (60, 2))])  # metres before who looks along x
    T_map_camera = _turning(times[[first, second]])
    facing = Rotation.from_euler("z", 2 * np.pi * times[first] / _SECONDS)
    copies = Rotation.from_euler("z", 90 * quarters, degrees=True)
    inside = [
        (points - T[:3, 3]) @ T[:3, :3]
        for points, T in zip((facing.apply(poster), (copies * facing).apply(poster)), T_map_camera, strict=True)
    ]
    seen = np.array([p[:, :2] / p[:, 2:] for p in inside]) + rng.normal(0, 0.001, (2, 60, 2))
    R_second_first = T_map_camera[1, :3, :3].T @ T_map_camera[0, :3, :3]
    wrong = Rotation.from_rotvec([0, turned, 0]).as_matrix() @ R_second_first
    return VerifiedPair(first, second, np.zeros((60, 2), np.int64), 60, wrong, seen, None)


def test_a_pair_is_judged_by_its_matches_and_not_by_a_rotation_that_a_plane_leaves_open() -> None:
    times = np.linspace(0, _SECONDS * 0.97, _KEYFRAMES)
    sequential = [_pair(k, k + 1, times, 0.0) for k in range(_KEYFRAMES - 1)]
    right = _pair(3, 7, times, np.radians(25))
    look_alike = _pair(3, 14, times, np.radians(-80), quarters=1)

    kept, loops = GyroGuard(times, _imu()).keep(sequential, [right, look_alike])

    assert kept == sequential
    assert loops == [right]
