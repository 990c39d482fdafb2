"""Poses: heading, roll and quaternion say the same as the matrix."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rholoc.geometry import Pose, is_rotation, rotation_from_heading

angles = st.floats(-3.1, 3.1)
pitches = st.floats(-1.4, 1.4)


@given(yaw=angles, pitch=pitches, roll=angles)
def test_heading_and_roll_round_trip(yaw: float, pitch: float, roll: float) -> None:
    heading = np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)])
    pose = Pose.from_heading(np.array([1.0, 2.0, 3.0]), heading, roll)
    np.testing.assert_allclose(pose.heading, heading, atol=1e-12)
    assert pose.roll == pytest.approx(roll, abs=1e-9)
    np.testing.assert_allclose(pose.R_map_camera.T @ pose.R_map_camera, np.eye(3), atol=1e-12)


@given(yaw=angles, pitch=pitches)
def test_upright_cameras_have_a_horizontal_x_axis_and_look_down_with_y(yaw: float, pitch: float) -> None:
    heading = np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)])
    R = rotation_from_heading(heading)
    assert R[2, 0] == pytest.approx(0, abs=1e-12)
    assert R[2, 1] < 0


@given(yaw=angles, pitch=pitches, roll=angles)
def test_quaternions_round_trip(yaw: float, pitch: float, roll: float) -> None:
    heading = np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)])
    pose = Pose.from_heading(np.zeros(3), heading, roll)
    again = Pose.from_quaternion(pose.position, pose.quaternion_xyzw)
    np.testing.assert_allclose(again.T_map_camera, pose.T_map_camera, atol=1e-12)
    assert pose.quaternion_xyzw[3] >= 0


def test_inverse_takes_the_position_to_the_origin() -> None:
    pose = Pose.from_heading(np.array([1.0, -2.0, 0.5]), np.array([1.0, 1.0, 0.2]), 0.3)
    np.testing.assert_allclose(pose.inverse() @ pose.T_map_camera, np.eye(4), atol=1e-12)


def test_a_vertical_heading_still_gives_a_rotation() -> None:
    R = rotation_from_heading(np.array([0.0, 0.0, 1.0]))
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)


def test_what_is_a_rotation() -> None:
    turned = Pose.from_heading(np.zeros(3), np.array([1.0, 2.0, 0.3]), roll=0.4).R_map_camera
    assert is_rotation(turned)
    assert is_rotation(turned + 1e-4)
    assert not is_rotation(turned + 0.1)
    assert is_rotation(turned + 1e-3, tolerance=1e-2)
    for wrong in (np.diag([1.0, 1, -1]), 2 * turned, 1e200 * turned, np.full((3, 3), np.nan), np.eye(4), np.zeros(0)):
        assert not is_rotation(wrong)
