"""Given poses held against pictures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rholoc.geometry import FloatArray, pose_matrix
from rholoc.recordings import GivenPoses, Recording, read_recording
from rholoc.trajectory import PoseMethod
from rholoc.trajectory.checks.given_poses import PoseAxes, check_given_poses, epipolar_errors
from rholoc.trajectory.estimate import estimate_trajectory

_FLIP = np.diag([1.0, -1, -1, 1])


def test_epipolar_errors_grow_with_the_shift_across_the_epipolar_line() -> None:
    """Sampson's distance of a match shifted across its line in one of two like images is the shift over √2."""
    rng = np.random.default_rng(0)
    points = rng.uniform([-1, -1, 3], [1, 1, 6], (200, 3))
    T = pose_matrix(Rotation.from_euler("y", 5, degrees=True).as_matrix(), np.array([0.5, 0.0, 0.0]))
    moved = points @ T[:3, :3].T + T[:3, 3]
    a, b = points / points[:, 2:], moved / moved[:, 2:]
    assert epipolar_errors(T, a, b).max() < 1e-12
    off = epipolar_errors(T, a, b + np.array([0.0, 1e-3, 0.0]))
    np.testing.assert_allclose(off, 1e-3 / np.sqrt(2), rtol=0.15)


def test_cameras_at_one_place_are_compared_by_their_rotation() -> None:
    T = pose_matrix(Rotation.from_euler("y", 5, degrees=True).as_matrix(), np.zeros(3))
    a = np.array([[0.1, 0.2, 1.0], [-0.3, 0.1, 1.0]])
    a /= np.linalg.norm(a, axis=1, keepdims=True)
    assert epipolar_errors(T, a, a @ T[:3, :3].T).max() < 1e-12


@pytest.fixture(scope="module")
def kitchen(real_data: Path) -> Recording:
    return read_recording(real_data / "redkitchen", "525.505,525.505,320,240", "400:520:8")


def _written(recording: Recording, write: Callable[[FloatArray], FloatArray]) -> Recording:
    assert recording.poses is not None
    T = write(recording.poses.T_map_camera)
    return replace(recording, poses=GivenPoses(np.ones(len(T), dtype=np.bool_), T))


def _turned_at_random(T: FloatArray) -> FloatArray:
    return pose_matrix(Rotation.random(len(T), rng=np.random.default_rng(0)).as_matrix(), T[:, :3, 3])


@pytest.mark.real
@pytest.mark.parametrize(
    ("axes", "write"),
    [
        (PoseAxes.AS_DOCUMENTED, lambda T: T),
        (PoseAxes.LOOKING_BACK, lambda T: T @ _FLIP),
        (PoseAxes.INVERTED, np.linalg.inv),
        (PoseAxes.INVERTED_LOOKING_BACK, lambda T: np.linalg.inv(T @ _FLIP)),
    ],
)
def test_axes_are_recognised_by_the_pictures(
    kitchen: Recording, axes: PoseAxes, write: Callable[[FloatArray], FloatArray]
) -> None:
    recording = _written(kitchen, write)
    assert recording.camera is not None
    assert recording.poses is not None
    assert kitchen.poses is not None
    check = check_given_poses(recording, recording.camera)
    assert check.axes is axes
    assert check.exact
    np.testing.assert_allclose(check.read(recording.poses.T_map_camera), kitchen.poses.T_map_camera, atol=1e-9)


@pytest.mark.real
def test_auto_takes_exact_poses_and_corrects_their_axes(kitchen: Recording) -> None:
    assert kitchen.poses is not None
    found = estimate_trajectory(_written(kitchen, lambda T: T @ _FLIP), PoseMethod.AUTO)
    np.testing.assert_allclose(found.T_map_camera, kitchen.poses.T_map_camera, atol=1e-9)
    assert "OpenGL" in found.report.why


@pytest.mark.real
@pytest.mark.slow
def test_auto_says_why_it_did_not_use_poses_that_contradict_the_pictures(kitchen: Recording) -> None:
    recording = _written(kitchen, _turned_at_random)
    assert recording.camera is not None
    assert not check_given_poses(recording, recording.camera).usable
    found = estimate_trajectory(recording, PoseMethod.AUTO)
    assert "contradict its pictures" in found.report.why
    assert found.report.method != "given"


@pytest.mark.real
@pytest.mark.slow
def test_auto_adjusts_poses_that_drift(real_data: Path) -> None:
    """ARKit's poses along a corridor with doors that look alike: all pictures are placed, and fit each other."""
    recording = read_recording(real_data / "corridor_lidar" / "scan", frames="::3")
    found = estimate_trajectory(recording, PoseMethod.AUTO)
    assert len(found.rows) >= 0.95 * len(recording.frames.times)
    assert "adjusted to its pictures" in found.report.why
    assert found.report.reprojection_error_px is not None
    assert found.report.reprojection_error_px < 1.5
    assert recording.poses is not None
    moved_m = np.linalg.norm(found.T_map_camera[:, :3, 3] - recording.poses.T_map_camera[found.rows, :3, 3], axis=1)
    assert np.median(moved_m) < 0.6
