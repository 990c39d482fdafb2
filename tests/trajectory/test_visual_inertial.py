"""Gyroscope calibration and linear visual-inertial alignment on a synthetic spline."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from rholoc.trajectory.imu_evidence import compare_with_inertial, weigh_imu
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation, RotationSpline

from rholoc.geometry import FloatArray, pose_matrix
from rholoc.recordings import Imu, Waypoint
from rholoc.trajectory.dead_reckoning import integrate_between_waypoints
from rholoc.trajectory.gyroscope import calibrate_gyro
from rholoc.trajectory.inertial_alignment import GRAVITY, align_inertially

_R_CAMERA_IMU = Rotation.from_euler("xyz", [90, 0, 80], degrees=True).as_matrix()


@dataclass(frozen=True, eq=False)
class _Spline:
    """A hand-held walk: its poses at 5 Hz, and what an IMU with bias and noise measures at 200 Hz."""

    times: FloatArray
    T_map_camera: FloatArray
    imu: Imu


def _walk(
    delay_s: float = 0.0, includes_gravity: bool = True, known_mounting: bool = True, moving: bool = True
) -> _Spline:
    rng = np.random.default_rng(4)
    knots = np.arange(-2.0, 24.0, 0.7)
    path = make_interp_spline(knots, np.cumsum(rng.normal(0, 0.25 * moving, (len(knots), 3)), axis=0), k=5)
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
    assert found.time_offset_sigma_s < 0.003
    assert found.bias_sigma < 0.001
    assert found.mounting_sigma_deg < 0.2
    assert found.residual_deg < 0.2


def test_a_mounting_that_the_recording_states_wrongly_is_found() -> None:
    walk = _walk()
    landscape = _R_CAMERA_IMU @ Rotation.from_euler("z", 90, degrees=True).as_matrix()
    found = calibrate_gyro(walk.times, walk.T_map_camera[:, :3, :3], replace(walk.imu, R_camera_imu=landscape))
    assert found is not None
    assert found.contradicts_recording
    assert np.degrees(Rotation.from_matrix(found.R_camera_imu.T @ _R_CAMERA_IMU).magnitude()) < 0.5
    right = calibrate_gyro(walk.times, walk.T_map_camera[:, :3, :3], walk.imu)
    assert right is not None
    assert not right.contradicts_recording
    np.testing.assert_array_equal(right.R_camera_imu, _R_CAMERA_IMU)


def test_the_gyroscope_contradicts_wrong_rotations() -> None:
    walk = _walk()
    bent = Rotation.from_rotvec(np.outer(np.sin(walk.times), [0.0, 0.6, 0.0])).as_matrix()
    own = pose_matrix(bent @ walk.T_map_camera[:, :3, :3], walk.T_map_camera[:, :3, 3])
    evidence = weigh_imu(walk.times, own, walk.imu)
    assert any("gyroscope contradicts" in doubt for doubt in evidence.doubts)
    assert evidence.alignment is None


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
    assert abs(found.scale * 0.37 - 1) < 4 * found.scale_sigma < 0.1
    np.testing.assert_allclose(found.lever_m, 0, atol=0.03)
    if includes_gravity:
        assert found.up is not None
        assert np.degrees(np.arccos(np.clip(found.up @ frame[:, 2], -1, 1))) < 0.3
    else:
        assert found.up is None


def test_a_camera_at_rest_leaves_the_scale_open() -> None:
    walk = _walk()
    still = walk.T_map_camera.copy()
    still[:, :3, 3] = np.random.default_rng(0).normal(0, 0.01, (len(still), 3))
    evidence = weigh_imu(walk.times, still, walk.imu)
    assert evidence.alignment is not None
    assert evidence.alignment.why_no_scale
    assert evidence.report["not_observable"]["scale"] == evidence.alignment.why_no_scale


def test_a_camera_that_only_turns_is_told_so() -> None:
    walk = _walk(moving=False)
    own = walk.T_map_camera.copy()
    own[:, :3, 3] += np.random.default_rng(0).normal(0, 0.02, (len(own), 3))
    why = weigh_imu(walk.times, own, walk.imu).report["not_observable"]["scale"]
    assert "turned but hardly moved" in why


def test_an_accelerometer_of_the_wrong_sign_is_told() -> None:
    walk = _walk(includes_gravity=False)
    negative = replace(walk.imu, acceleration=-walk.imu.acceleration)
    why = weigh_imu(walk.times, walk.T_map_camera, negative).report["not_observable"]
    assert "contradicts the cameras" in why["scale"]
    assert "gravity" in why


def test_a_mounting_that_nothing_shows_is_told() -> None:
    walk = _walk(known_mounting=False)
    straight = np.tile(walk.T_map_camera[0], (len(walk.times), 1, 1))
    rate = np.tile([0.01, -0.02, 0.005], (len(walk.imu.times), 1))
    evidence = weigh_imu(walk.times, straight, replace(walk.imu, angular_velocity=rate))
    assert "mounting" in evidence.report["not_observable"]
    assert evidence.alignment is None


def test_frames_that_the_gyroscope_contradicts_are_dropped() -> None:
    walk = _walk()
    torn = walk.T_map_camera.copy()
    torn[40:45, :3, :3] = Rotation.from_euler("z", 90, degrees=True).as_matrix() @ torn[40:45, :3, :3]
    evidence = weigh_imu(walk.times, torn, walk.imu)
    assert np.flatnonzero(~evidence.kept).tolist() == [40, 41, 42, 43, 44]
    assert not evidence.doubts
    torn[40:, :3, :3] = Rotation.from_euler("z", 90, degrees=True).as_matrix() @ walk.T_map_camera[40:, :3, :3]
    evidence = weigh_imu(walk.times, torn, walk.imu)
    assert np.flatnonzero(~evidence.kept).tolist() == list(range(40))
    assert "contradicts 40% of the frames" in evidence.doubts[0]


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
    R_map_imu = R @ _R_CAMERA_IMU
    imu = Imu(
        t,
        np.add(np.einsum("nij,ni->nj", R_map_imu, acceleration), [0.03, -0.02, 0.02]),
        np.add(np.einsum("nij,ni->nj", R_map_imu, rate), [0.002, -0.001, 0.001]),
        True,
        _R_CAMERA_IMU,
    )
    waypoints = [Waypoint(str(i), float(stops[i]), tuple(places[i])) for i in (0, 1, 3)]  # the third is a mere rest
    rows = np.flatnonzero((t >= stops[0]) & (t <= stops[-1]))[::40]
    found = integrate_between_waypoints(imu, waypoints, t[rows])
    assert np.linalg.norm(found[:, :3, 3] - path[rows], axis=1).max() < 0.05
    turned = Rotation.from_matrix(np.swapaxes(found[:, :3, :3], 1, 2) @ R[rows])
    assert np.degrees(turned.magnitude()).max() < 4

    truth = pose_matrix(R[::20], path[::20])
    gyro = calibrate_gyro(t[::20], R[::20], imu)
    assert gyro is not None
    beside = compare_with_inertial(t[::20], truth, waypoints, imu, gyro)
    assert beside["frames"] == np.count_nonzero((t[::20] >= stops[0]) & (t[::20] <= stops[-1]))
    assert beside["rms_m"] < beside["worst_m"] < 0.05
    truth[:, 0, 3] += 1.0
    assert compare_with_inertial(t[::20], truth, waypoints, imu, gyro)["rms_m"] == pytest.approx(1.0, abs=0.03)
