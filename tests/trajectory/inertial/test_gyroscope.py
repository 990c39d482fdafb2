"""The gyroscope against the cameras' rotations, on a synthetic spline."""

from dataclasses import replace

import numpy as np
import pytest
from hand_held import R_CAMERA_IMU, hand_held_walk
from scipy.spatial.transform import Rotation

from rholoc.geometry import FloatArray
from rholoc.recordings import Imu
from rholoc.trajectory.inertial.gyroscope import (
    GyroCalibration,
    allowed_apart,
    calibrate_gyro,
    camera_rotations,
    longest_interval_s,
    orientations,
    spaced_rows,
)


@pytest.mark.parametrize("known_mounting", [True, False])
def test_the_gyroscope_is_calibrated(known_mounting: bool) -> None:
    walk = hand_held_walk(delay_s=0.043, known_mounting=known_mounting)
    found = calibrate_gyro(walk.times, walk.T_map_camera[:, :3, :3], walk.imu)
    assert found.time_offset_s == pytest.approx(0.043, abs=0.003)
    np.testing.assert_allclose(found.bias, [0.01, -0.02, 0.005], atol=0.002)
    turned = Rotation.from_matrix(found.R_camera_imu.T @ R_CAMERA_IMU)
    assert np.degrees(turned.magnitude()) < 0.5
    assert found.time_offset_sigma_s < 0.003
    assert found.bias_sigma < 0.001
    assert found.mounting_sigma_deg < 0.2
    assert found.residual_deg < 0.2


@pytest.mark.parametrize("delay_s", [-1.4, 0.3])
def test_clocks_that_are_far_apart_are_brought_together(delay_s: float) -> None:
    walk = hand_held_walk()
    late = replace(walk.imu, times=walk.imu.times + delay_s)
    found = calibrate_gyro(walk.times, walk.T_map_camera[:, :3, :3], late)
    assert found.time_offset_s == pytest.approx(delay_s, abs=0.003)
    assert found.residual_deg < 0.2


def test_a_mounting_that_the_recording_states_wrongly_is_found() -> None:
    walk = hand_held_walk()
    landscape = R_CAMERA_IMU @ Rotation.from_euler("z", 90, degrees=True).as_matrix()
    found = calibrate_gyro(walk.times, walk.T_map_camera[:, :3, :3], replace(walk.imu, R_camera_imu=landscape))
    assert found.contradicts_recording
    assert np.degrees(Rotation.from_matrix(found.R_camera_imu.T @ R_CAMERA_IMU).magnitude()) < 0.5
    right = calibrate_gyro(walk.times, walk.T_map_camera[:, :3, :3], walk.imu)
    assert not right.contradicts_recording
    np.testing.assert_array_equal(right.R_camera_imu, R_CAMERA_IMU)


def test_the_gyroscope_contradicts_wrong_rotations() -> None:
    walk = hand_held_walk()
    bent = Rotation.from_rotvec(np.outer(np.sin(walk.times), [0.0, 0.6, 0.0])).as_matrix()
    found = calibrate_gyro(walk.times, bent @ walk.T_map_camera[:, :3, :3], walk.imu)
    assert not found.fits


def test_a_mounting_that_nothing_shows_is_not_known() -> None:
    walk = hand_held_walk(known_mounting=False)
    straight = np.tile(np.eye(3), (len(walk.times), 1, 1))
    rate = np.tile([0.01, -0.02, 0.005], (len(walk.imu.times), 1))
    found = calibrate_gyro(walk.times, straight, replace(walk.imu, angular_velocity=rate))
    assert not found.mounting_is_known


def test_an_imu_of_another_time_calibrates_nothing() -> None:
    walk = hand_held_walk()
    assert calibrate_gyro(walk.times + 100, walk.T_map_camera[:, :3, :3], walk.imu) is None


def test_camera_rotations_are_those_of_the_camera() -> None:
    walk = hand_held_walk(delay_s=0.043)
    gyro = calibrate_gyro(walk.times, walk.T_map_camera[:, :3, :3], walk.imu)
    assert gyro is not None
    by_gyroscope = camera_rotations(walk.imu, gyro, walk.times)
    true = Rotation.from_matrix(walk.T_map_camera[:, :3, :3])
    for later in (1, 10, 99):
        apart = (by_gyroscope[0].inv() * by_gyroscope[later]).inv() * (true[0].inv() * true[later])
        assert apart.magnitude() < np.radians(0.6)
        assert apart.magnitude() < allowed_apart(walk.times[later] - walk.times[0])


_TIMES = np.arange(0.0, 8.0, 0.01)


def _imu(rate: FloatArray, times: FloatArray = _TIMES) -> Imu:
    """An IMU that only turns, at rates (M, 3)."""
    return Imu(times, np.zeros((len(times), 3)), np.broadcast_to(rate, (len(times), 3)), True, np.eye(3))


def test_a_steady_rate_without_its_bias_turns_about_one_axis() -> None:
    """Also where readings are not evenly spaced; over a ramp by what the trapezoids say."""
    bias = np.array([0.02, -0.01, 0.03])
    times = np.array([0.0, 0.1, 0.15, 0.5, 0.6])
    found = orientations(_imu(np.array([0.3, 0.0, 0.4]) + bias, times), bias)
    np.testing.assert_allclose(found.as_rotvec(), np.outer(times, [0.3, 0.0, 0.4]), atol=1e-12)
    ramp = orientations(_imu(np.outer(times, [0.0, 0.0, 2.0]), times), np.zeros(3))
    np.testing.assert_allclose(ramp.as_rotvec(), np.outer(times**2, [0.0, 0.0, 1.0]), atol=1e-12)


def test_a_camera_turns_with_the_gyroscope_it_is_mounted_on_and_rests_outside_its_table() -> None:
    gyro = GyroCalibration(0.25, 0.0, np.zeros(3), 0.0, R_CAMERA_IMU, False, 0.0, 0.0)
    by_gyroscope = camera_rotations(_imu(np.array([0.1, -0.2, 0.3])), gyro, np.array([-5.0, -0.25, 0.75, 3.75, 100.0]))
    seconds = np.array([0.0, 0.0, 1.0, 4.0, 7.99])
    turned = (by_gyroscope[0].inv() * by_gyroscope).as_rotvec()
    axis = R_CAMERA_IMU @ [0.1, -0.2, 0.3]
    expected = Rotation.from_rotvec(np.outer(seconds, axis)).as_rotvec()
    np.testing.assert_allclose(turned, expected, atol=1e-9)


def test_a_camera_may_leave_the_gyroscope_by_a_drift_that_grows() -> None:
    np.testing.assert_allclose(np.degrees(allowed_apart(np.array([0.0, 10.0, -10.0, 60.0]))), [6.0, 7.0, 7.0, 12.0])


@pytest.mark.parametrize(("step_s", "longest_s"), [(0.005, 0.1), (0.019, 0.1), (0.021, 0.105), (0.1, 0.5)])
def test_a_gap_is_a_tenth_of_a_second_or_five_intervals(step_s: float, longest_s: float) -> None:
    assert longest_interval_s(_imu(np.zeros(3), np.arange(20) * step_s)) == pytest.approx(longest_s)


def test_rows_are_taken_as_soon_as_they_are_far_enough() -> None:
    assert spaced_rows(np.array([0.0, 0.1, 0.25, 0.3, 0.5, 0.5, 0.75]), 0.25).tolist() == [0, 2, 4, 6]
    assert spaced_rows(np.array([3.0]), 0.25).tolist() == [0]


@pytest.mark.parametrize(
    ("mounting_sigma_deg", "residual_deg", "known", "fits"),
    [(0.0, 0.1, True, True), (2.9, 1.9, True, True), (3.1, 2.1, False, False)],
)
def test_what_counts_as_known(mounting_sigma_deg: float, residual_deg: float, known: bool, fits: bool) -> None:
    found = GyroCalibration(0.0, 0.0, np.zeros(3), 0.0, np.eye(3), False, mounting_sigma_deg, residual_deg)
    assert (found.mounting_is_known, found.fits) == (known, fits)


@pytest.mark.parametrize("delay_s", [0.037, -0.104])
def test_without_noise_clock_bias_and_mounting_are_exact(delay_s: float) -> None:
    """A camera that sways; the gyroscope reads midway between its own rotations."""
    fine_s = np.arange(-1.0, 9.0, 0.001)
    sway = np.column_stack([0.5 * np.sin(2.1 * fine_s), 0.6 * np.sin(1.3 * fine_s + 1), 0.4 * np.sin(1.7 * fine_s + 2)])
    turn = Rotation.from_rotvec(sway)
    rate = (turn[:-1].inv() * turn[1:]).as_rotvec() / 0.001
    bias = np.array([0.01, -0.02, 0.015])
    imu = Imu(fine_s[:-1] + 0.0005 + delay_s, np.zeros((len(rate), 3)), rate @ R_CAMERA_IMU + bias, True, None)
    rows = np.searchsorted(fine_s, np.arange(0.0, 8.0, 0.1))
    found = calibrate_gyro(fine_s[rows], turn[rows].as_matrix(), imu)
    assert found.time_offset_s == pytest.approx(delay_s, abs=5e-4)
    np.testing.assert_allclose(found.bias, bias, atol=2e-4)
    np.testing.assert_allclose(found.R_camera_imu, R_CAMERA_IMU, atol=1e-3)
    assert found.residual_deg < 0.01


def test_sigmas_are_those_of_the_fit() -> None:
    """By noise of a known size on the camera's rotations, over many of them."""
    rng = np.random.default_rng(3)
    walk = hand_held_walk(known_mounting=False)
    noise_deg = 0.3
    shaken = (
        walk.T_map_camera[:, :3, :3] @ Rotation.from_rotvec(np.radians(rng.normal(0, noise_deg, (100, 3)))).as_matrix()
    )
    found = calibrate_gyro(walk.times, shaken, walk.imu)
    sigma_rad = np.radians(noise_deg * np.sqrt(2))  # of a rotation from one to the next
    assert np.radians(found.residual_deg) == pytest.approx(1.54 * sigma_rad, rel=0.25)  # the median of a norm
    turns = (Rotation.from_matrix(shaken[:-1]).inv() * Rotation.from_matrix(shaken[1:])).as_rotvec()[1:-1]
    assert found.bias_sigma == pytest.approx(sigma_rad / (0.2 * np.sqrt(len(turns))), rel=0.25)
    weakest = np.sort(np.linalg.eigvalsh(turns.T @ turns))[:2].sum()
    assert np.radians(found.mounting_sigma_deg) == pytest.approx(sigma_rad / np.sqrt(weakest), rel=0.25)
    rates = np.column_stack([np.interp(walk.times, walk.imu.times, axis) for axis in walk.imu.angular_velocity.T])
    changes = np.sqrt(np.sum(np.diff(rates, axis=0) ** 2))
    assert found.time_offset_sigma_s == pytest.approx(sigma_rad / changes, rel=0.25)
