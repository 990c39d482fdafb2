"""Positions from the IMU and the directions between keyframes: scale, gravity and bias come back."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hand_held import hand_held_walk
from scipy.spatial.transform import Rotation

from rholoc.geometry import FloatArray, umeyama
from rholoc.recordings import Imu
from rholoc.trajectory.inertial.gyroscope import GyroCalibration, calibrate_gyro
from rholoc.trajectory.initialization.inertial_start import InertialStart, _covered, _integrated, inertial_start
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
    assert np.degrees(np.arccos(np.clip(found.up @ walk.frame[:, 2], -1, 1))) < 0.5
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


_FORCE = np.array([0.3, -0.5, 9.9])  # m/s², in the world's axes
_KEYFRAMES_S = np.array([0.105, 0.4, 1.0, 1.733])
_GYRO = GyroCalibration(0.0, 0.0, np.zeros(3), 0.0, np.eye(3), False, 0.0, 0.0)


def _imu(turn_rad_s: float) -> Imu:
    """Two seconds at 200 Hz of one force, felt by an IMU that turns about the world's z axis."""
    times = np.arange(0, 2, 0.005)
    turned = Rotation.from_rotvec(times[:, None] * [0, 0, turn_rad_s])
    felt = turned.inv().apply(np.tile(_FORCE, (len(times), 1)))
    return Imu(times, felt, np.tile([0, 0, turn_rad_s], (len(times), 1)), True, None)


@pytest.mark.parametrize("turn_rad_s", [0.0, 0.8])
def test_a_constant_force_makes_speed_and_way(turn_rad_s: float) -> None:
    R = Rotation.from_rotvec(_KEYFRAMES_S[:, None] * [0, 0, turn_rad_s]).as_matrix()
    speed, way, by_v, by_p = _integrated(_imu(turn_rad_s), _GYRO, _KEYFRAMES_S, R)
    dt = np.diff(_KEYFRAMES_S)[:, None]
    np.testing.assert_allclose(speed, _FORCE * dt, atol=2e-3)
    np.testing.assert_allclose(way, _FORCE * dt**2 / 2, atol=2e-3)
    middle = Rotation.from_rotvec(0.5 * (_KEYFRAMES_S[1:] + _KEYFRAMES_S[:-1])[:, None] * [0, 0, turn_rad_s])
    np.testing.assert_allclose(by_v, -dt[:, :, None] * middle.as_matrix(), atol=0.02)
    np.testing.assert_allclose(by_p[:, 2, 2], -(dt[:, 0] ** 2) / 2, atol=1e-9)
    if turn_rad_s == 0:
        np.testing.assert_allclose(by_p, -(dt[:, :, None] ** 2) / 2 * np.eye(3), atol=1e-9)


def test_an_interval_is_covered_by_a_table_without_a_gap() -> None:
    imu = _imu(0.0)
    kept = (imu.times < 0.5) | (imu.times > 0.9)
    torn = replace(imu, times=imu.times[kept], acceleration=imu.acceleration[kept])
    torn = replace(torn, angular_velocity=imu.angular_velocity[kept])
    keyframes_s = np.array([-0.1, 0.1, 0.4, 0.6, 0.8, 1.0, 1.5, 1.9, 2.1])
    assert _covered(keyframes_s, torn).tolist() == [False, True, False, False, False, True, True, False]
    assert _covered(keyframes_s, imu).tolist() == [False, True, True, True, True, True, True, False]
