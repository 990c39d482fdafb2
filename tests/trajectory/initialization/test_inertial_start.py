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
