"""The IMU integrated between waypoints, the paper's own way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hand_held import R_CAMERA_IMU
from scipy.spatial.transform import Rotation

from rholoc.errors import MappingFailed
from rholoc.geometry import FloatArray
from rholoc.recordings import GRAVITY, Imu, Waypoint
from rholoc.trajectory.dead_reckoning import integrate_between_waypoints

STOPS = np.array([1.0, 6.0, 11.0, 16.0])
PLACES = np.array([[0.0, 0, 1.4], [2.0, 0.5, 1.4], [2.5, 2.5, 1.3], [0.5, 2.0, 1.4]])
HOLD_S = 1.6


def walk(drift: float = 0.0) -> tuple[Imu, FloatArray, FloatArray]:
    """From stop to stop: the IMU, and the camera's path (N, 3) and rotations (N, 3, 3) at its times.

    ``drift``: m/s³, by which the accelerometer's error along y grows while the camera moves.
    """
    t = np.arange(0.0, 17.0, 0.005)
    share = np.clip((t[:, None] - STOPS[:-1] - HOLD_S / 2) / (np.diff(STOPS) - HOLD_S), 0, 1)
    smooth = 10 * share**3 - 15 * share**4 + 6 * share**5
    path = PLACES[0] + smooth @ np.diff(PLACES, axis=0)
    yaw = 0.8 * smooth.sum(axis=1)
    R = (Rotation.from_rotvec(np.outer(yaw, [0, 0, 1])) * Rotation.from_euler("x", -90, degrees=True)).as_matrix()
    acceleration = np.add(np.gradient(np.gradient(path, t, axis=0), t, axis=0), [0, 0, GRAVITY])
    moving = np.where((share > 0) & (share < 1), share, 0).sum(axis=1) * (STOPS[1] - STOPS[0] - HOLD_S)
    acceleration[:, 1] += drift * moving
    rate = np.column_stack([0 * t, 0 * t, np.gradient(yaw, t)])
    R_map_imu = R @ R_CAMERA_IMU
    imu = Imu(
        t,
        np.add(np.einsum("nij,ni->nj", R_map_imu, acceleration), [0.03, -0.02, 0.02]),
        np.add(np.einsum("nij,ni->nj", R_map_imu, rate), [0.002, -0.001, 0.001]),
        True,
        R_CAMERA_IMU,
    )
    return imu, path, R


def waypoints(which: tuple[int, ...]) -> list[Waypoint]:
    return [Waypoint(str(i), float(STOPS[i]), tuple(PLACES[i])) for i in which]


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
