"""Synthetic hand-held walks, along splines or from stop to stop, and what an IMU feels of them."""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation, RotationSpline

from rholoc.geometry import FloatArray, pose_matrix
from rholoc.recordings import GRAVITY, Imu, Waypoint

R_CAMERA_IMU = Rotation.from_euler("xyz", [90, 0, 80], degrees=True).as_matrix()


@dataclass(frozen=True, eq=False)
class HandHeld:
    """A hand-held walk: its poses at 5 Hz, and what an IMU with bias and noise measures at 200 Hz."""

    times: FloatArray
    T_map_camera: FloatArray
    imu: Imu


def hand_held_walk(delay_s: float = 0.0, known_mounting: bool = True) -> HandHeld:
    rng = np.random.default_rng(4)
    knots = np.arange(-2.0, 24.0, 0.7)
    path = make_interp_spline(knots, np.cumsum(rng.normal(0, 0.25, (len(knots), 3)), axis=0), k=5)
    angles = np.column_stack([rng.uniform(-20, 20, len(knots)), np.cumsum(rng.normal(0, 15, len(knots))), 0 * knots])
    turn = RotationSpline(knots, Rotation.from_euler("xyz", np.add(angles, [-90, 0, 0]), degrees=True))
    t = np.arange(-1.0, 22.0, 0.005)
    R_map_camera = turn(t).as_matrix()
    force = path.derivative(2)(t) + np.array([0.0, 0.0, GRAVITY])
    rate = (turn(t - 1e-4).inv() * turn(t + 1e-4)).as_rotvec() / 2e-4  # in the camera's axes
    imu = Imu(
        times=t + delay_s,
        acceleration=np.einsum("nij,ni->nj", R_map_camera @ R_CAMERA_IMU, force) + rng.normal(0, 0.02, (len(t), 3)),
        angular_velocity=rate @ R_CAMERA_IMU + rng.normal(0, 0.002, (len(t), 3)) + [0.01, -0.02, 0.005],
        includes_gravity=True,
        R_camera_imu=R_CAMERA_IMU if known_mounting else None,
    )
    times = np.arange(0.0, 20.0, 0.2)
    return HandHeld(times, pose_matrix(turn(times).as_matrix(), path(times)), imu)


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
