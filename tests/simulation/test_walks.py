"""Walks are smooth, slow and upright; the IMU feels exactly them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid
from scipy.spatial.transform import Rotation

from rholoc.geometry import Pose
from rholoc.recordings import GRAVITY, check_waypoints_fix_frame
from rholoc.simulation import ImuErrors, make_walk, measure_imu, measure_waypoints
from rholoc.simulation.walk import PAUSE_S

SECONDS = 30.0
PERFECT = ImuErrors(0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("number", [1, 2, 3])
def test_walks_are_those_of_a_careful_person(number: int) -> None:
    walk = make_walk(number, SECONDS)
    times = np.linspace(0, SECONDS, 3001)
    speed = np.linalg.norm(np.gradient(walk.positions(times), times, axis=0), axis=1)
    turning_deg_s = np.degrees(np.linalg.norm(walk.angular_velocities(times), axis=1))
    roll_deg = np.degrees([Pose(T).roll for T in walk.T_map_camera(times[::10])])
    assert speed.max() < 0.55
    assert turning_deg_s.max() < 45
    assert np.sqrt(np.mean(roll_deg**2)) < 0.5
    assert np.abs(walk.accelerations(times)).max() < 3


def test_the_first_walk_starts_at_the_origin_and_the_second_beside_it() -> None:
    first, second = make_walk(1), make_walk(2)
    np.testing.assert_allclose(first.positions(np.zeros(1)), 0, atol=1e-12)
    way = first.positions(np.linspace(0, SECONDS, 600))
    off = [np.linalg.norm(way - p, axis=1).min() for p in second.positions(np.linspace(0, SECONDS, 60))]
    assert 0.1 < np.median(off) < 0.5


def test_waypoints_lie_on_the_path_where_the_walker_stands_still() -> None:
    walk = make_walk(1, SECONDS)
    waypoints = measure_waypoints(walk, SECONDS)
    assert [w.name for w in waypoints] == ["START", "W1", "W2", "W3", "E"]
    assert waypoints[0].position == (0.0, 0.0, 0.0)
    check_waypoints_fix_frame(waypoints)
    for waypoint in waypoints:
        around = walk.positions(waypoint.time + np.linspace(-0.3, 0.3, 7) * PAUSE_S)
        assert np.linalg.norm(around - waypoint.position, axis=1).max() < 0.04
    assert len(measure_waypoints(walk, 10.0)) == 2


def test_acceleration_integrates_to_the_path() -> None:
    walk = make_walk(1, SECONDS)
    imu = measure_imu(walk, SECONDS, rate_hz=400.0, errors=PERFECT)
    assert imu.R_camera_imu is not None
    R_map_imu = walk.rotations(imu.times) @ imu.R_camera_imu
    acceleration = np.einsum("nij,nj->ni", R_map_imu, imu.acceleration) - (0, 0, GRAVITY)
    start = walk.positions(np.array([-1e-4, 0.0, 1e-4]))
    velocity = (start[2] - start[0]) / 2e-4 + cumulative_trapezoid(acceleration, imu.times, axis=0, initial=0)
    position = start[1] + cumulative_trapezoid(velocity, imu.times, axis=0, initial=0)
    for time in (1.0, 5.0, 15.0, 29.0):
        i = int(np.searchsorted(imu.times, time))
        np.testing.assert_allclose(position[i], walk.positions(imu.times[i : i + 1])[0], atol=0.01)


def test_angular_velocity_integrates_to_the_rotation() -> None:
    walk = make_walk(2, SECONDS)
    imu = measure_imu(walk, SECONDS, rate_hz=400.0, errors=PERFECT)
    assert imu.R_camera_imu is not None
    middle = 0.5 * (imu.angular_velocity[1:] + imu.angular_velocity[:-1])
    R = Rotation.from_matrix(walk.rotations(imu.times[:1])[0] @ imu.R_camera_imu)
    for step in Rotation.from_rotvec(middle * np.diff(imu.times)[:, None]):
        R = R * step
    end = Rotation.from_matrix(walk.rotations(imu.times[-1:])[0] @ imu.R_camera_imu)
    assert np.degrees((R.inv() * end).magnitude()) < 0.05


def test_imu_errors_and_time_offset() -> None:
    walk = make_walk(1, SECONDS)
    true, read = measure_imu(walk, 5.0, errors=PERFECT), measure_imu(walk, 5.0)
    rest = read.acceleration - true.acceleration
    assert np.abs(rest.mean(axis=0)).max() < 0.2
    assert rest.std(axis=0) == pytest.approx(ImuErrors().accelerometer_noise_m_s2, rel=0.15)
    late = measure_imu(walk, 5.0, errors=PERFECT, time_offset_s=0.1)
    np.testing.assert_allclose(late.angular_velocity[10:], true.angular_velocity[:-10], atol=1e-9)
    again = measure_imu(walk, 5.0)
    np.testing.assert_array_equal(again.acceleration, read.acceleration)
