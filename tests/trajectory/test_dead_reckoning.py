"""The IMU integrated between waypoints, the paper's own way."""

from __future__ import annotations

import numpy as np
from hand_held import R_CAMERA_IMU
from scipy.spatial.transform import Rotation

from rholoc.recordings import GRAVITY, Imu, Waypoint
from rholoc.trajectory.dead_reckoning import integrate_between_waypoints


def test_the_imu_alone_joins_waypoints_and_rests_between_them() -> None:
    stops, hold = np.array([1.0, 6.0, 11.0, 16.0]), 1.6
    places = np.array([[0.0, 0, 1.4], [2.0, 0.5, 1.4], [2.5, 2.5, 1.3], [0.5, 2.0, 1.4]])
    t = np.arange(0.0, 17.0, 0.005)
    share = np.clip((t[:, None] - stops[:-1] - hold / 2) / (np.diff(stops) - hold), 0, 1)
    smooth = 10 * share**3 - 15 * share**4 + 6 * share**5
    path = places[0] + smooth @ np.diff(places, axis=0)
    yaw = 0.8 * smooth.sum(axis=1)
    R = (Rotation.from_rotvec(np.outer(yaw, [0, 0, 1])) * Rotation.from_euler("x", -90, degrees=True)).as_matrix()
    acceleration = np.add(np.gradient(np.gradient(path, t, axis=0), t, axis=0), [0, 0, GRAVITY])
    rate = np.column_stack([0 * t, 0 * t, np.gradient(yaw, t)])
    R_map_imu = R @ R_CAMERA_IMU
    imu = Imu(
        t,
        np.add(np.einsum("nij,ni->nj", R_map_imu, acceleration), [0.03, -0.02, 0.02]),
        np.add(np.einsum("nij,ni->nj", R_map_imu, rate), [0.002, -0.001, 0.001]),
        True,
        R_CAMERA_IMU,
    )
    waypoints = [Waypoint(str(i), float(stops[i]), tuple(places[i])) for i in (0, 1, 3)]  # the third is a mere rest
    rows = np.flatnonzero((t >= stops[0]) & (t <= stops[-1]))[::40]
    found = integrate_between_waypoints(imu, waypoints, t[rows])
    assert np.linalg.norm(found[:, :3, 3] - path[rows], axis=1).max() < 0.05
    turned = Rotation.from_matrix(np.swapaxes(found[:, :3, :3], 1, 2) @ R[rows])
    assert np.degrees(turned.magnitude()).max() < 4
