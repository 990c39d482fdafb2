"""Positions from the IMU and the directions between keyframes: scale, gravity and bias come back."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hand_held import hand_held_walk
from scipy.spatial.transform import Rotation

from rholoc.geometry import FloatArray, angles_between, umeyama
from rholoc.recordings import GRAVITY, Imu
from rholoc.trajectory.inertial.gyroscope import GyroCalibration, calibrate_gyro
from rholoc.trajectory.initialization.inertial_start import InertialStart, inertial_start
from rholoc.trajectory.visual.directions import PairDirection

_BIAS = np.array([0.08, -0.05, 0.06])  # m/s²
_BLANK = range(50, 56)  # keyframes before a white wall, 1.2 s


@dataclass(frozen=True, eq=False)
class _Walk:
    """A walk in a frame (3, 3) of its own, and the directions between its keyframes."""

    times: FloatArray
    true: FloatArray
    frame: FloatArray
    R: FloatArray
    imu: Imu
    gyro: GyroCalibration

    def directions(self, blank: range = range(0), wrong: float = 0.0) -> list[PairDirection]:
        """Right to half a degree, a share of them entirely wrong; none of keyframes that see nothing."""
        rng = np.random.default_rng(3)
        found = []
        for step in (1, 2, 4):
            for i in range(len(self.true) - step):
                way = self.true[i + step] - self.true[i]
                if i in blank or i + step in blank or np.linalg.norm(way) < 0.02:
                    continue
                unit = self.frame @ way / np.linalg.norm(way) + rng.normal(0, np.radians(0.5), 3)
                unit = rng.normal(size=3) if rng.random() < wrong else unit
                found.append(PairDirection(i, i + step, unit / np.linalg.norm(unit), float(np.radians(0.7))))
        return found

    def started(self, directions: list[PairDirection]) -> InertialStart:
        found = inertial_start(self.times, self.R, directions, self.imu, self.gyro)
        assert found is not None
        return found

    def off_m(self, found: InertialStart) -> FloatArray:
        """How far positions are from the true ones, scale included: only turn and place are taken out."""
        apart = found.positions @ self.frame - self.true
        return np.linalg.norm(apart - apart.mean(axis=0), axis=1)


@pytest.fixture(scope="module")
def walk() -> _Walk:
    """Twenty seconds at 5 Hz."""
    spline = hand_held_walk(delay_s=0.02)
    frame = Rotation.random(rng=np.random.default_rng(9)).as_matrix()
    R = frame @ spline.T_map_camera[:, :3, :3]
    imu = replace(spline.imu, acceleration=spline.imu.acceleration + _BIAS)
    gyro = calibrate_gyro(spline.times, R, imu)
    assert gyro is not None
    return _Walk(spline.times, spline.T_map_camera[:, :3, 3], frame, R, imu, gyro)


def test_scale_gravity_and_bias_come_back(walk: _Walk) -> None:
    found = walk.started(walk.directions())
    assert np.degrees(angles_between(found.up, walk.frame[:, 2])) < 0.5
    assert umeyama(found.positions, walk.true).scale == pytest.approx(1, abs=0.05)
    np.testing.assert_allclose(found.accelerometer_bias, _BIAS, atol=0.06)
    assert np.median(walk.off_m(found)) < 0.1
    speed = np.gradient(walk.true, walk.times, axis=0)
    assert np.median(np.linalg.norm(found.velocities @ walk.frame - speed, axis=1)) < 0.15


def test_wrong_directions_are_outvoted(walk: _Walk) -> None:
    assert np.median(walk.off_m(walk.started(walk.directions(wrong=0.1)))) < 0.15


def test_a_second_before_a_white_wall_is_carried_by_the_imu(walk: _Walk) -> None:
    found = walk.started(walk.directions(_BLANK))
    across = np.diff(found.positions[[49, 56]] @ walk.frame, axis=0) - np.diff(walk.true[[49, 56]], axis=0)
    assert np.linalg.norm(across) < 0.1
    assert np.median(walk.off_m(found)) < 0.15


def test_an_imu_of_another_time_starts_nothing(walk: _Walk) -> None:
    late = replace(walk.imu, times=walk.imu.times + 100)
    assert inertial_start(walk.times, walk.R, walk.directions(), late, walk.gyro) is None
    assert inertial_start(walk.times, walk.R, [], walk.imu, walk.gyro) is None


def test_directions_worse_than_they_claim_do_not_shrink_the_walk(walk: _Walk) -> None:
    """Two places that a direction misses are nearer to it the nearer they are to each other."""
    rng = np.random.default_rng(5)
    noisy = []
    for one in walk.directions() * 30:
        off = one.direction + rng.normal(0, np.radians(1.5), 3)
        noisy.append(replace(one, direction=off / np.linalg.norm(off), sigma_rad=float(np.radians(0.7))))
    assert umeyama(walk.started(noisy).positions, walk.true).scale == pytest.approx(1, abs=0.25)


_R_CAMERA_IMU = Rotation.from_euler("xyz", [80, 10, 5], degrees=True).as_matrix()
_SPEED, _PUSH = np.array([0.4, -0.2, 0.1]), np.array([0.3, 0.25, -0.1])
_STEPS_S = np.cumsum([0.0, 0.2, 0.3, 0.25, 0.2, 0.4, 0.35, 0.3])
_DELAY_S = 0.015
_SWAY = np.array([0.9, -0.7, 0.5])  # m/s², four radians a second


def _pushed(bias: FloatArray, sway: float) -> tuple[FloatArray, FloatArray, FloatArray, Imu, GyroCalibration]:
    """A camera that does not turn and is pushed, steadily but for a share of sway.

    Its places, speeds and rotations at :data:`_STEPS_S`, and what an IMU with that bias reads.
    """
    R_world_camera = Rotation.from_euler("xyz", [30, -50, 70], degrees=True).as_matrix()
    times = np.arange(-0.1, 2.3, 0.005)
    swaying = np.outer(np.sin(4 * (times - _DELAY_S)), sway * _SWAY)
    force = (swaying + _PUSH + [0.0, 0.0, GRAVITY]) @ (R_world_camera @ _R_CAMERA_IMU) + bias
    imu = Imu(times, force, np.zeros((len(times), 3)), True, _R_CAMERA_IMU)
    gyro = GyroCalibration(_DELAY_S, 0.0, np.zeros(3), 0.0, _R_CAMERA_IMU, False, 0.0, 0.0)
    t = _STEPS_S[:, None]
    positions = _SPEED * t + _PUSH * t**2 / 2 + sway * _SWAY * (t / 4 - np.sin(4 * t) / 16)
    speeds = _SPEED + _PUSH * t + sway * _SWAY * (1 - np.cos(4 * t)) / 4
    return positions, speeds, np.tile(R_world_camera, (len(t), 1, 1)), imu, gyro


def _ways(positions: FloatArray) -> list[PairDirection]:
    """Exact directions between all keyframes up to three apart."""
    pairs = [(i, j) for j in range(len(positions)) for i in range(max(0, j - 3), j)]
    units = [(positions[j] - positions[i]) / np.linalg.norm(positions[j] - positions[i]) for i, j in pairs]
    return [PairDirection(i, j, unit, 0.01) for (i, j), unit in zip(pairs, units, strict=True)]


def test_exact_measurements_give_the_exact_walk() -> None:
    positions, speeds, R, imu, gyro = _pushed(np.zeros(3), 1.0)
    found = inertial_start(_STEPS_S, R, _ways(positions), imu, gyro)
    np.testing.assert_allclose(found.positions, positions, atol=5e-4)
    np.testing.assert_allclose(found.velocities, speeds, atol=5e-4)
    np.testing.assert_allclose(found.up, [0, 0, 1], atol=1e-4)
    np.testing.assert_allclose(found.accelerometer_bias, 0, atol=1e-3)
    assert found.residual < 1e-3


def test_the_origin_is_the_first_keyframe_and_gravitys_length_is_the_earths() -> None:
    """An accelerometer that reads a hundredth too much is biased, but stays upright."""
    positions, _, R, imu, gyro = _pushed(np.zeros(3), 1.0)
    too_much = replace(imu, acceleration=1.01 * imu.acceleration)
    found = inertial_start(_STEPS_S, R, _ways(positions), too_much, gyro)
    assert np.linalg.norm(found.positions[0]) < 1e-5
    np.testing.assert_allclose(found.up, [0, 0, 1], atol=0.01)
    world = R[0] @ _R_CAMERA_IMU @ found.accelerometer_bias
    assert world[2] == pytest.approx(0.01 * GRAVITY, abs=0.03)


def test_half_of_a_walk_must_be_covered() -> None:
    positions, _, R, imu, gyro = _pushed(np.zeros(3), 1.0)
    for last_s, starts in ((_STEPS_S[4] + 0.05, True), (_STEPS_S[3] + 0.05, False)):
        kept = imu.times <= last_s + _DELAY_S
        part = replace(imu, times=imu.times[kept], acceleration=imu.acceleration[kept])
        part = replace(part, angular_velocity=imu.angular_velocity[kept])
        assert (inertial_start(_STEPS_S, R, _ways(positions), part, gyro) is not None) is starts
