"""Patches in space: what a detection says of one is what another camera sees of it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from rholoc.geometry import Camera, Pose, mean_patches, patch_appearance, patch_vectors

CAMERA = Camera(640, 480, 500.0, 540.0, 319.5, 239.5)
SQUARE = Camera(640, 480, 500.0, 500.0, 319.5, 239.5)

angles = st.floats(-np.pi, np.pi)
lengths = st.floats(0.1, 10)
offsets = st.floats(-0.5, 0.5)


def looking_down(height: float, roll: float = 0.0, at: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    """A camera at a height over the floor that looks straight down, turned by ``roll`` about its axis."""
    T = np.eye(4)
    T[:3, :3] = np.diag([1.0, -1.0, -1.0]) @ Rotation.from_euler("z", roll).as_matrix()
    T[:3, 3] = *at, height
    return T


def turned(a: float, b: float) -> float:
    return float(np.abs(np.angle(np.exp(1j * (a - b)))))


@given(yaw=angles, pitch=st.floats(-1, 1), roll=angles, angle=angles, size_px=st.floats(1, 200), depth=lengths)
def test_the_camera_that_saw_a_patch_sees_it_as_it_did(
    yaw: float, pitch: float, roll: float, angle: float, size_px: float, depth: float
) -> None:
    heading = np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)])
    T = Pose.from_heading(np.array([1.0, -2.0, 1.5]), heading, roll).T_map_camera
    in_camera = np.array([[0.4, -0.3, 1.0], [-0.5, 0.2, 1.0]]) * depth
    landmarks = in_camera @ T[:3, :3].T + T[:3, 3]
    vectors = patch_vectors(CAMERA, T, landmarks, np.full(2, angle), np.full(2, size_px))
    np.testing.assert_allclose(np.sum(vectors * (landmarks - T[:3, 3]), axis=1), 0, atol=1e-9 * size_px * depth)
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), size_px * depth / CAMERA.focal)
    seen, sizes_px = patch_appearance(CAMERA, T, landmarks, vectors)
    assert max(turned(one, angle) for one in seen) < 1e-7
    np.testing.assert_allclose(sizes_px, size_px)


def test_an_angle_is_the_one_of_the_projected_vector() -> None:
    T, landmark = looking_down(2.0, roll=0.3), np.array([[0.3, -0.2, 0.5]])
    step = 1e-6 * patch_vectors(CAMERA, T, landmark, np.array([1.1]), np.array([10.0]))
    ends = CAMERA.project((np.concatenate([landmark, landmark + step]) - T[:3, 3]) @ T[:3, :3])
    du, dv = ends[1] - ends[0]
    assert np.arctan2(dv, du) == pytest.approx(1.1, abs=1e-4)


@given(roll=angles, angle=angles)
def test_a_camera_rolled_clockwise_sees_a_patch_turned_the_other_way(roll: float, angle: float) -> None:
    landmark, size_px = np.array([[0.2, 0.1, 0.0]]), np.array([12.0])
    vector = patch_vectors(SQUARE, looking_down(1.5), landmark, np.array([angle]), size_px)
    seen, sizes_px = patch_appearance(SQUARE, looking_down(1.5, roll), landmark, vector)
    assert turned(seen[0], angle - roll) < 1e-7
    np.testing.assert_allclose(sizes_px, size_px)


@given(x=offsets, y=offsets, height=lengths, angle=angles)
def test_on_a_plane_that_faces_the_camera_a_patch_looks_the_same_from_elsewhere(
    x: float, y: float, height: float, angle: float
) -> None:
    landmark = np.zeros((1, 3))
    on_axis = patch_vectors(CAMERA, looking_down(1.0), landmark, np.array([angle]), np.array([20.0]))
    seen, sizes_px = patch_appearance(CAMERA, looking_down(height, at=(x, y)), landmark, on_axis)
    assert turned(seen[0], angle) < 1e-7
    np.testing.assert_allclose(sizes_px, 20.0 / height)


def test_what_is_not_known_is_nan() -> None:
    landmarks = np.array([[0, 0, 0], [0, 0, 0], [0, 0, 0], [0, 0, 5.0], [0, 0, 2.0]])
    angles_known, sizes = np.array([0.5, np.nan, 0.5, 0.5, 0.5]), np.array([9.0, 9.0, 0.0, 9.0, 9.0])
    vectors = patch_vectors(CAMERA, looking_down(2.0), landmarks, angles_known, sizes)
    np.testing.assert_array_equal(np.isfinite(vectors).all(axis=1), [True, False, False, False, False])
    np.testing.assert_array_equal(np.isnan(vectors).all(axis=1), [False, True, True, True, True])
    patches = np.array([[0.1, 0, 0], [np.nan] * 3, [0.1, 0, 0], [0.1, 0, 0], [0.1, 0, 0]])
    for seen in patch_appearance(CAMERA, looking_down(2.0), landmarks, patches):
        np.testing.assert_array_equal(np.isfinite(seen), [True, False, True, False, False])


def test_a_mean_is_of_directions_and_of_ratios() -> None:
    vectors = np.array([[0.1, 0, 0], [0, 0.4, 0], [np.nan] * 3, [0, 0, 3.0], [1.0, 0, 0], [-1.0, 0, 0]])
    means = mean_patches(vectors, np.array([0, 0, 0, 2, 3, 3]), 5)
    np.testing.assert_allclose(means[0], np.array([0.2, 0.2, 0]) / np.sqrt(2))
    np.testing.assert_allclose(means[2], [0, 0, 3])
    assert np.isnan(means[[1, 3, 4]]).all()  # never seen, seen in opposite directions, never seen
