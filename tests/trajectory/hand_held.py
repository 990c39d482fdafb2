"""A synthetic hand-held walk: splines, and what an IMU feels of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation, RotationSpline

from rholoc.geometry import FloatArray, pose_matrix
from rholoc.recordings import GRAVITY, Imu

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
