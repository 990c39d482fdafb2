"""Gyroscope calibration and linear visual-inertial alignment on a synthetic spline."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation, RotationSpline

from rholoc.geometry import FloatArray, pose_matrix
from rholoc.recordings import Imu, Waypoint
from rholoc.trajectory.imu import calibrate_gyro
from rholoc.trajectory.inertial import integrate_between_waypoints
from rholoc.trajectory.visual_inertial import GRAVITY, align_inertially

_R_CAMERA_IMU = Rotation.from_euler("xyz", [90, 0, 80], degrees=True).as_matrix()


@dataclass(frozen=True, eq=False)
class _Spline:
    """A hand-held walk: its poses at 5 Hz, and what an IMU with bias and noise measures at 200 Hz."""

    times: FloatArray
    T_map_camera: FloatArray
    imu: Imu


def _walk(delay_s: float = 0.0, includes_gravity: bool = True, known_mounting: bool = True) -> _Spline:
    rng = np.random.default_rng(4)
    knots = np.arange(-2.0, 24.0, 0.7)
    path = make_interp_spline(knots, np.cumsum(rng.normal(0, 0.25, (len(knots), 3)), axis=0), k=5)
    angles = np.column_stack([rng.uniform(-20, 20, len(knots)), np.cumsum(rng.normal(0, 15, len(knots))), 0 * knots])
    turn = RotationSpline(knots, Rotation.from_euler("xyz", np.add(angles, [-90, 0, 0]), degrees=True))
    t = np.arange(-1.0, 22.0, 0.005)
    R_map_camera = turn(t).as_matrix()
    force = path.derivative(2)(t) + ([0, 0, GRAVITY] if includes_gravity else [0, 0, 0])
    rate = (turn(t - 1e-4).inv() * turn(t + 1e-4)).as_rotvec() / 2e-4  # in the camera's axes
    imu = Imu(
        times=t + delay_s,
        acceleration=np.einsum("nij,ni->nj", R_map_camera @ _R_CAMERA_IMU, force) + rng.normal(0, 0.02, (len(t), 3)),
        angular_velocity=rate @ _R_CAMERA_IMU + rng.normal(0, 0.002, (len(t), 3)) + [0.01, -0.02, 0.005],
        includes_gravity=includes_gravity,
        R_camera_imu=_R_CAMERA_IMU if known_mounting else None,
    )
    times = np.arange(0.0, 20.0, 0.2)
    return _Spline(times, pose_matrix(turn(times).as_matrix(), path(times)), imu)


@pytest.mark.parametrize("known_mounting", [True, False])
def test_the_gyroscope_is_calibrated(known_mounting: bool) -> None:
    walk = _walk(delay_s=0.043, known_mounting=known_mounting)
    found = calibrate_gyro(walk.times, walk.T_map_camera[:, :3, :3], walk.imu)
    assert found is not None
    assert found.time_offset_s == pytest.approx(0.043, abs=0.003)
    np.testing.assert_allclose(found.bias, [0.01, -0.02, 0.005], atol=0.002)
    turned = Rotation.from_matrix(found.R_camera_imu.T @ _R_CAMERA_IMU)
    assert np.degrees(turned.magnitude()) < 0.5
    assert found.residual_deg < 0.2
    assert found.contradiction == 0


def test_the_gyroscope_contradicts_wrong_rotations() -> None:
    walk = _walk()
    bent = Rotation.from_rotvec(np.outer(np.sin(walk.times), [0.0, 0.6, 0.0])).as_matrix()
    found = calibrate_gyro(walk.times, bent @ walk.T_map_camera[:, :3, :3], walk.imu)
    assert found is not None
    assert found.contradiction > 0.5


@pytest.mark.parametrize("includes_gravity", [True, False])
def test_scale_and_gravity_come_back(includes_gravity: bool) -> None:
    walk = _walk(includes_gravity=includes_gravity)
    frame = Rotation.random(rng=np.random.default_rng(9)).as_matrix()
    own = walk.T_map_camera.copy()
    own[:, :3, :3] = frame @ own[:, :3, :3]
    own[:, :3, 3] = 0.37 * own[:, :3, 3] @ frame.T
    gyro = calibrate_gyro(walk.times, own[:, :3, :3], walk.imu)
    assert gyro is not None
    found = align_inertially(walk.times, own, walk.imu, gyro)
    assert found is not None
    assert found.scale * 0.37 == pytest.approx(1, abs=0.02)
    assert found.scale_sigma < 0.05
    if includes_gravity:
        assert found.up is not None
        assert np.degrees(np.arccos(np.clip(found.up @ frame[:, 2], -1, 1))) < 0.3
    else:
        assert found.up is None


def test_a_camera_at_rest_leaves_the_scale_open() -> None:
    walk = _walk()
    still = walk.T_map_camera.copy()
    still[:, :3, 3] = np.random.default_rng(0).normal(0, 0.01, (len(still), 3))
    gyro = calibrate_gyro(walk.times, still[:, :3, :3], walk.imu)
    assert gyro is not None
    found = align_inertially(walk.times, still, walk.imu, gyro)
    assert found is not None
    assert found.scale_sigma > 0.1 or found.scale <= 0


def test_the_imu_alone_joins_waypoints_at_rest() -> None:
    stops, hold = np.array([1.0, 6.0, 11.0]), 1.0
    places = np.array([[0.0, 0, 1.4], [2.0, 0.5, 1.4], [2.5, 2.5, 1.3]])
    t = np.arange(0.0, 12.0, 0.005)
    share = np.clip((t[:, None] - stops[:-1] - hold / 2) / (np.diff(stops) - hold), 0, 1)
    smooth = 10 * share**3 - 15 * share**4 + 6 * share**5
    path = places[0] + smooth @ np.diff(places, axis=0)
    yaw = 0.8 * smooth.sum(axis=1)
    R = (Rotation.from_rotvec(np.outer(yaw, [0, 0, 1])) * Rotation.from_euler("x", -90, degrees=True)).as_matrix()
    acceleration = np.add(np.gradient(np.gradient(path, t, axis=0), t, axis=0), [0, 0, GRAVITY])
    rate = np.column_stack([0 * t, 0 * t, np.gradient(yaw, t)])
    R_map_imu = R @ _R_CAMERA_IMU
    imu = Imu(
        t,
        np.add(np.einsum("nij,ni->nj", R_map_imu, acceleration), [0.03, -0.02, 0.02]),
        np.add(np.einsum("nij,ni->nj", R_map_imu, rate), [0.002, -0.001, 0.001]),
        True,
        _R_CAMERA_IMU,
    )
    waypoints = [Waypoint(str(i), float(s), tuple(p)) for i, (s, p) in enumerate(zip(stops, places, strict=True))]
    rows = np.flatnonzero((t >= stops[0]) & (t <= stops[-1]))[::40]
    found = integrate_between_waypoints(imu, waypoints, t[rows])
    assert np.linalg.norm(found[:, :3, 3] - path[rows], axis=1).max() < 0.05
    turned = Rotation.from_matrix(np.swapaxes(found[:, :3, :3], 1, 2) @ R[rows])
    assert np.degrees(turned.magnitude()).max() < 4
