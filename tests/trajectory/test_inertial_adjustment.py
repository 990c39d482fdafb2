"""The IMU between waypoints in one least-squares problem: better than leg by leg."""

from dataclasses import replace

import numpy as np
import pytest
from hand_held import PLACES, STOPS, walk, waypoints
from scipy.spatial.transform import Rotation

from rholoc.errors import MappingFailed
from rholoc.geometry import BoolArray, FloatArray, pose_distances, pose_matrix
from rholoc.recordings import Imu
from rholoc.trajectory.dead_reckoning import integrate_between_waypoints
from rholoc.trajectory.inertial_adjustment import adjust_between_waypoints


def _biased(imu: Imu, seed: int) -> Imu:
    """The readings of a worse IMU: biases and noise as a phone's."""
    rng = np.random.default_rng(seed)
    return replace(
        imu,
        acceleration=imu.acceleration + rng.normal(0, 0.05, 3) + rng.normal(0, 0.03, imu.acceleration.shape),
        angular_velocity=imu.angular_velocity + rng.normal(0, 0.004, 3) + rng.normal(0, 0.003, (len(imu.times), 3)),
    )


def _errors(found: FloatArray, path: FloatArray, R: FloatArray) -> tuple[float, float]:
    """Median errors, metres and degrees."""
    moved, turned = pose_distances(found, pose_matrix(R, path))
    return float(np.median(moved)), float(np.degrees(np.median(turned)))


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_all_of_the_walk_at_once_is_better_than_leg_by_leg(seed: int) -> None:
    imu, path, R = walk()
    rows = np.flatnonzero((imu.times >= STOPS[0]) & (imu.times <= STOPS[-1]))[::40]
    at, measured = imu.times[rows], waypoints((0, 1, 2, 3))
    worse = _biased(imu, seed)
    adjusted = _errors(adjust_between_waypoints(worse, measured, at), path[rows], R[rows])
    by_leg = _errors(integrate_between_waypoints(worse, measured, at), path[rows], R[rows])
    assert adjusted[0] < min(0.03, 1.2 * by_leg[0])
    assert adjusted[1] < 1.5


def test_poses_come_in_the_order_of_their_times() -> None:
    imu, path, _ = walk()
    at = np.array([2.0, 3.0, 3.0004, 8.0, 15.0])
    found = adjust_between_waypoints(imu, waypoints((0, 1, 2, 3)), at)
    expected = np.column_stack([np.interp(at, imu.times, path[:, axis]) for axis in range(3)])
    assert np.linalg.norm(found[:, :3, 3] - expected, axis=1).max() < 0.03


def part_of(imu: Imu, kept: BoolArray) -> Imu:
    """The readings of a mask (N,)."""
    return replace(
        imu,
        times=imu.times[kept],
        acceleration=imu.acceleration[kept],
        angular_velocity=imu.angular_velocity[kept],
    )


def test_a_gap_is_said() -> None:
    imu, _, _ = walk()
    broken = part_of(imu, (imu.times < 8.0) | (imu.times > 8.7))
    with pytest.raises(MappingFailed, match="gap between"):
        adjust_between_waypoints(broken, waypoints((0, 1, 2, 3)), np.array([2.0, 3.0]))


def test_a_perfect_imu_and_waypoints_give_the_perfect_walk() -> None:
    imu, path, R = walk()
    exact = replace(
        imu,
        acceleration=imu.acceleration - [0.03, -0.02, 0.02],
        angular_velocity=imu.angular_velocity - [0.002, -0.001, 0.001],
    )
    rows = np.flatnonzero((imu.times >= STOPS[0]) & (imu.times <= STOPS[-1]))[::100]
    found = adjust_between_waypoints(exact, waypoints((0, 1, 2, 3)), imu.times[rows])
    np.testing.assert_allclose(found[:, :3, 3], path[rows], atol=2e-3)
    np.testing.assert_allclose(found[:, :3, :3], R[rows], atol=2e-3)


def test_steady_biases_are_found() -> None:
    """As large as a phone's: the walk does not show them."""
    imu, path, R = walk()
    worse = replace(
        imu,
        acceleration=np.add(imu.acceleration, [0.07, -0.05, 0.06]),
        angular_velocity=np.add(imu.angular_velocity, [0.01, -0.008, 0.012]),
    )
    rows = np.flatnonzero((imu.times >= STOPS[0]) & (imu.times <= STOPS[-1]))[::100]
    found = adjust_between_waypoints(worse, waypoints((0, 1, 2, 3)), imu.times[rows])
    moved_m, turned_deg = _errors(found, path[rows], R[rows])
    assert moved_m < 0.01
    assert turned_deg < 0.6


def test_a_waypoint_that_is_wrong_does_not_bend_the_walk() -> None:
    imu, path, _ = walk()
    measured = waypoints((0, 1, 2, 3))
    x, y, z = measured[2].position
    measured[2] = replace(measured[2], position=(x, y, z + 1.0))
    rows = np.flatnonzero((imu.times >= STOPS[0]) & (imu.times <= STOPS[-1]))[::100]
    found = adjust_between_waypoints(imu, measured, imu.times[rows])
    assert np.median(np.linalg.norm(found[:, :3, 3] - path[rows], axis=1)) < 0.15


def test_the_imu_alone_joins_waypoints_and_rests_between_them() -> None:
    imu, path, R = walk()
    rows = np.flatnonzero((imu.times >= STOPS[0]) & (imu.times <= STOPS[-1]))[::40]
    found = integrate_between_waypoints(imu, waypoints((0, 1, 3)), imu.times[rows])  # the third is a mere rest
    assert np.linalg.norm(found[:, :3, 3] - path[rows], axis=1).max() < 0.05
    turned = Rotation.from_matrix(np.swapaxes(found[:, :3, :3], 1, 2) @ R[rows])
    assert np.degrees(turned.magnitude()).max() < 4


def test_what_is_left_of_place_at_a_waypoint_is_spread_over_the_way_there() -> None:
    imu, path, _ = walk(drift=0.1)
    moving = np.flatnonzero((imu.times >= STOPS[0]) & (imu.times <= STOPS[-1]))[::20]
    found = integrate_between_waypoints(imu, waypoints((0, 1, 2, 3)), imu.times[moving])
    assert np.linalg.norm(found[:, :3, 3] - path[moving], axis=1).max() < 0.2

    just_before = STOPS[1:] - 0.01
    arrived = integrate_between_waypoints(imu, waypoints((0, 1, 2, 3)), just_before)
    np.testing.assert_allclose(arrived[:, :3, 3], PLACES[1:], atol=0.005)


def test_a_perfect_imu_gives_the_perfect_walk() -> None:
    imu, path, R = walk()
    exact = replace(
        imu,
        acceleration=imu.acceleration - [0.03, -0.02, 0.02],
        angular_velocity=imu.angular_velocity - [0.002, -0.001, 0.001],
    )
    rows = np.flatnonzero((imu.times >= STOPS[0]) & (imu.times <= STOPS[-1]))[::20]
    shuffled = waypoints((2, 0, 3, 1))
    found = integrate_between_waypoints(exact, shuffled, imu.times[rows])
    np.testing.assert_allclose(found[:, :3, 3], path[rows], atol=1e-3)
    np.testing.assert_allclose(found[:, :3, :3], R[rows], atol=2e-3)


def test_an_imu_that_cannot_place_the_camera_is_refused() -> None:
    imu, *_ = walk()
    at = np.array([2.0])
    for useless in (replace(imu, R_camera_imu=None), replace(imu, includes_gravity=False)):
        with pytest.raises(MappingFailed, match="mounting or gravity"):
            integrate_between_waypoints(useless, waypoints((0, 1, 3)), at)
    for kept in (imu.times > 1.1, imu.times < 15.9):
        part = replace(imu, times=imu.times[kept], acceleration=imu.acceleration[kept])
        with pytest.raises(MappingFailed, match="does not cover"):
            integrate_between_waypoints(part, waypoints((0, 1, 3)), at)


def test_a_gap_at_a_waypoint_and_two_waypoints_at_once_are_said() -> None:
    imu, *_ = walk()
    part = part_of(imu, np.abs(imu.times - STOPS[1]) > 0.5)
    with pytest.raises(MappingFailed, match="no readings at the waypoint"):
        integrate_between_waypoints(part, waypoints((0, 1, 3)), np.array([2.0]))
    first, second, third = waypoints((0, 1, 3))
    with pytest.raises(MappingFailed, match="the same time"):
        integrate_between_waypoints(imu, [first, replace(second, time=third.time), third], np.array([2.0]))
