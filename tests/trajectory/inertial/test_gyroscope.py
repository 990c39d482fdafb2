"""The gyroscope against the cameras' rotations, on a synthetic spline."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hand_held import R_CAMERA_IMU, hand_held_walk
from scipy.spatial.transform import Rotation

from rholoc.trajectory.inertial.gyroscope import allowed_apart, calibrate_gyro, camera_rotations


@pytest.mark.parametrize("known_mounting", [True, False])
def test_the_gyroscope_is_calibrated(known_mounting: bool) -> None:
    walk = hand_held_walk(delay_s=0.043, known_mounting=known_mounting)
    found = calibrate_gyro(walk.times, walk.T_map_camera[:, :3, :3], walk.imu)
    assert found is not None
    assert found.time_offset_s == pytest.approx(0.043, abs=0.003)
    np.testing.assert_allclose(found.bias, [0.01, -0.02, 0.005], atol=0.002)
    turned = Rotation.from_matrix(found.R_camera_imu.T @ R_CAMERA_IMU)
    assert np.degrees(turned.magnitude()) < 0.5
    assert found.time_offset_sigma_s < 0.003
    assert found.bias_sigma < 0.001
    assert found.mounting_sigma_deg < 0.2
    assert found.residual_deg < 0.2


@pytest.mark.parametrize("delay_s", [-1.4, -0.3, 0.3, 0.8])
def test_clocks_that_are_far_apart_are_brought_together(delay_s: float) -> None:
    walk = hand_held_walk()
    late = replace(walk.imu, times=walk.imu.times + delay_s)
    found = calibrate_gyro(walk.times, walk.T_map_camera[:, :3, :3], late)
    assert found is not None
    assert found.time_offset_s == pytest.approx(delay_s, abs=0.003)
    assert found.residual_deg < 0.2


def test_a_mounting_that_the_recording_states_wrongly_is_found() -> None:
    walk = hand_held_walk()
    landscape = R_CAMERA_IMU @ Rotation.from_euler("z", 90, degrees=True).as_matrix()
    found = calibrate_gyro(walk.times, walk.T_map_camera[:, :3, :3], replace(walk.imu, R_camera_imu=landscape))
    assert found is not None
    assert found.contradicts_recording
    assert np.degrees(Rotation.from_matrix(found.R_camera_imu.T @ R_CAMERA_IMU).magnitude()) < 0.5
    right = calibrate_gyro(walk.times, walk.T_map_camera[:, :3, :3], walk.imu)
    assert right is not None
    assert not right.contradicts_recording
    np.testing.assert_array_equal(right.R_camera_imu, R_CAMERA_IMU)


def test_the_gyroscope_contradicts_wrong_rotations() -> None:
    walk = hand_held_walk()
    bent = Rotation.from_rotvec(np.outer(np.sin(walk.times), [0.0, 0.6, 0.0])).as_matrix()
    found = calibrate_gyro(walk.times, bent @ walk.T_map_camera[:, :3, :3], walk.imu)
    assert found is not None
    assert not found.fits


def test_a_mounting_that_nothing_shows_is_not_known() -> None:
    walk = hand_held_walk(known_mounting=False)
    straight = np.tile(np.eye(3), (len(walk.times), 1, 1))
    rate = np.tile([0.01, -0.02, 0.005], (len(walk.imu.times), 1))
    found = calibrate_gyro(walk.times, straight, replace(walk.imu, angular_velocity=rate))
    assert found is not None
    assert not found.mounting_is_known


def test_an_imu_of_another_time_calibrates_nothing() -> None:
    walk = hand_held_walk()
    assert calibrate_gyro(walk.times + 100, walk.T_map_camera[:, :3, :3], walk.imu) is None


def test_camera_rotations_are_those_of_the_camera() -> None:
    walk = hand_held_walk(delay_s=0.043)
    gyro = calibrate_gyro(walk.times, walk.T_map_camera[:, :3, :3], walk.imu)
    assert gyro is not None
    felt = camera_rotations(walk.imu, gyro, walk.times)
    true = Rotation.from_matrix(walk.T_map_camera[:, :3, :3])
    for later in (1, 10, 99):
        apart = (felt[0].inv() * felt[later]).inv() * (true[0].inv() * true[later])
        assert apart.magnitude() < np.radians(0.6)
        assert apart.magnitude() < allowed_apart(walk.times[later] - walk.times[0])
