"""Angles and distances between rotations, directions and poses."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from rholoc.geometry import UP, angles_between, direction_angles, pose_distances, pose_matrix, rotation_angles


@given(angle=st.floats(0, np.pi), seed=st.integers(0, 1000))
def test_a_rotation_is_its_own_angle_from_what_it_turned(angle: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    R = Rotation.random(rng=rng)
    axis = rng.normal(size=3)
    turned = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)) * R
    assert rotation_angles(R.as_matrix(), turned.as_matrix()) == pytest.approx(angle, abs=1e-6)


def test_angles_of_many_rotations_keep_their_shape() -> None:
    R = Rotation.from_rotvec(np.arange(6)[:, None] * [0.0, 0.0, 0.5]).as_matrix().reshape(2, 3, 3, 3)
    np.testing.assert_allclose(rotation_angles(np.eye(3), R)[0], [0, 0.5, 1], atol=1e-9)
    assert rotation_angles(np.zeros((0, 3, 3)), np.zeros((0, 3, 3))).shape == (0,)


def test_directions_are_compared_each_with_each() -> None:
    axes = np.eye(3)
    np.testing.assert_allclose(direction_angles(axes, axes[:2])[2], [np.pi / 2, np.pi / 2])
    np.testing.assert_allclose(direction_angles(axes[:1], -axes[:1]), [[np.pi]])


def test_directions_are_compared_pair_by_pair() -> None:
    rng = np.random.default_rng(0)
    a, b = (some / np.linalg.norm(some, axis=1, keepdims=True) for some in rng.normal(size=(2, 20, 3)))
    np.testing.assert_allclose(angles_between(a, b), np.diag(direction_angles(a, b)))
    assert np.cos(angles_between(a[0], UP)) == pytest.approx(a[0, 2])
    assert angles_between(UP * (1 + 1e-9), UP) == 0
    assert angles_between(7.0 * a[0], 0.1 * b[0]) == pytest.approx(angles_between(a[0], b[0]))


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-9, 1e-4, np.pi / 2, np.pi - 1e-9])
def test_small_and_straight_angles_are_as_exact_as_others(angle: float) -> None:
    axes = Rotation.random(50, rng=np.random.default_rng(1)).as_matrix()
    a, across = axes[:, 0], axes[:, 1]
    b = np.cos(angle) * a + np.sin(angle) * across
    np.testing.assert_allclose(angles_between(a, b), angle, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(np.diag(direction_angles(a, b)), angle, rtol=1e-9, atol=1e-15)


def test_poses_are_metres_and_radians_apart() -> None:
    a = pose_matrix(np.eye(3), np.zeros(3))
    b = pose_matrix(Rotation.from_euler("y", 0.3).as_matrix(), np.array([3.0, 4.0, 0.0]))
    apart_m, turned_rad = pose_distances(a, b)
    assert (float(apart_m), float(turned_rad)) == pytest.approx((5.0, 0.3))
