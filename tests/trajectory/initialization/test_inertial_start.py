"""Positions from the IMU and the directions between keyframes: scale, gravity and bias come back."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hand_held import hand_held_walk
from scipy.sparse import csr_matrix
from scipy.spatial.transform import Rotation

from rholoc.geometry import FloatArray, angles_between, umeyama
from rholoc.recordings import GRAVITY, Imu
from rholoc.trajectory.inertial.gyroscope import GyroCalibration, calibrate_gyro
from rholoc.trajectory.initialization import inertial_start as module
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


def test_the_true_walk_solves_the_equations_of_motion() -> None:
    positions, speeds, R, imu, gyro = _pushed(_BIAS, 0.0)
    motion = module._equations_of_motion(_STEPS_S + _DELAY_S, R, imu, gyro, np.arange(7) != 2)
    true = np.concatenate([[0, 0, -GRAVITY], _BIAS, np.column_stack([speeds, positions]).ravel()])
    A = module._stacked(
        motion, module._direction_rows(np.array([1, 4]), np.array([3, 5]), np.array([[0, 0.6, 0.8]] * 2))
    )
    np.testing.assert_allclose((A @ true)[: len(motion.measured)], motion.measured, atol=1e-9)
    across = (A @ true)[len(motion.measured) :].reshape(2, 3)
    for found, (i, j) in zip(across, [(1, 3), (4, 5)], strict=True):
        way = positions[j] - positions[i]
        np.testing.assert_allclose(found, way - (way @ [0, 0.6, 0.8]) * np.array([0, 0.6, 0.8]), atol=1e-12)
    dt = np.diff(_STEPS_S)
    sigmas = motion.sigmas.reshape(2, 7, 3) / np.where(np.arange(7) == 2, 1e3, 1)[:, None]  # over a gap next to nothing
    np.testing.assert_allclose(sigmas[0], np.tile(0.03 * np.sqrt(dt)[:, None], 3))
    np.testing.assert_allclose(sigmas[1], np.tile(np.sqrt(0.03**2 * dt**3 / 3 + 0.002**2)[:, None], 3))


def test_exact_measurements_give_the_exact_walk() -> None:
    positions, speeds, R, imu, gyro = _pushed(np.zeros(3), 1.0)
    found = inertial_start(_STEPS_S, R, _ways(positions), imu, gyro)
    assert found is not None
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
    assert found is not None
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


def test_a_force_that_turns_is_summed_where_it_was_felt_and_a_bias_counts_as_less() -> None:
    """By the accelerometer's bias the sums are linear: differences give the derivatives exactly."""
    rng = np.random.default_rng(1)
    times = np.arange(0, 2, 0.01)
    rate = np.column_stack([np.sin(times), np.cos(2 * times), 0.5 + 0 * times])
    imu = Imu(times, rng.normal(0, 1, (len(times), 3)), rate, True, None)
    gyro = replace(_GYRO, R_camera_imu=_R_CAMERA_IMU, bias=np.array([0.1, -0.2, 0.05]))
    keyframes_s = np.array([0.004, 0.5, 0.507, 1.111, 1.98])
    R = Rotation.random(5, rng=rng).as_matrix()
    speed, way, by_v, by_p = _integrated(imu, gyro, keyframes_s, R)
    for axis in range(3):
        more = replace(imu, acceleration=imu.acceleration - np.eye(3)[axis])
        other_speed, other_way, *_ = _integrated(more, gyro, keyframes_s, R)
        np.testing.assert_allclose(other_speed - speed, by_v[:, :, axis], atol=1e-12)
        np.testing.assert_allclose(other_way - way, by_p[:, :, axis], atol=1e-12)
    turn = np.linalg.inv(R[0] @ _R_CAMERA_IMU) @ by_v[0] / -(keyframes_s[1] - keyframes_s[0])
    mean_rate = rate[times < 0.5].mean(axis=0) - gyro.bias
    expected = Rotation.from_rotvec(0.5 * 0.5 * mean_rate).as_matrix()  # about half of the turn
    assert np.degrees(Rotation.from_matrix(expected.T @ turn, assume_valid=True).magnitude()) < 3


def test_outside_of_the_imus_table_nothing_is_summed() -> None:
    speed, way, by_v, by_p = _integrated(
        _imu(0.0), _GYRO, np.array([-2.0, -1.0, 0.5, 3.0, 4.0]), np.tile(np.eye(3), (5, 1, 1))
    )
    for sums in (speed, way, by_v, by_p):
        assert not sums[[0, 3]].any()
    np.testing.assert_allclose(speed[1:3], np.outer([0.5, 1.495], _FORCE), rtol=1e-6)


def test_the_border_and_the_band_are_solved_as_one_system() -> None:
    rng = np.random.default_rng(0)
    n = 6 + 6 * 5
    band = np.abs(np.subtract.outer(np.arange(n), np.arange(n))) < 12
    band[:6], band[:, :6] = True, True
    A = rng.normal(size=(n, n)) * band
    information = A @ A.T + 10 * np.eye(n)
    target = rng.normal(size=n)
    found = module._solved(csr_matrix(information).tocsc(), target)
    np.testing.assert_allclose(found, np.linalg.solve(information, target), atol=1e-10)


def test_weights_of_motion_fall_from_two_sigmas_on_or_from_twice_the_usual() -> None:
    felt = np.array([0.0, 0.1, 0.4, 2.0, 6.0])
    np.testing.assert_allclose(module._weights_of_motion(felt), 1 / (1 + felt**2 / 4))
    np.testing.assert_allclose(module._weights_of_motion(10 * felt), 1 / (1 + (felt / 0.8) ** 2))


def test_weights_of_directions_fall_with_the_angle_and_next_to_nothing_is_left_of_a_backward_one() -> None:
    unit = np.tile([0.0, 0.0, 1.0], (4, 1))
    sigma = np.full(4, 0.02)
    between = np.array([[0.0, 0, 0.5], [0.02, 0, 0.5], [0.0, 0, -0.5], [0.0004, 0, 0.0]])
    off = np.array([0.0, 0.02 / (0.02 * np.hypot(0.02, 0.5)), 3.0, 0.0004 / (0.02 * 0.02)])
    np.testing.assert_allclose(module._weights_of_directions(between, unit, sigma), 1 / (1 + off**2 / 4) ** 2)


def test_a_way_is_to_turn_to_its_direction_and_keeps_its_length() -> None:
    """What is wanted lies across the way; one that is no way yet, or leads backward, is only to lose what is across."""
    unit = np.tile([0.0, 0.6, 0.8], (3, 1))
    between = np.array([[0.0, 0.0, 2.0], [0.0, 0.0, 0.015], [0.0, 0.0, -1.0]])
    toward, wanted = module._turned_to(between, unit)
    np.testing.assert_allclose(toward, [[0, 0, 1], unit[1], unit[2]])
    np.testing.assert_allclose(wanted, [[0.0, 1.2, 0.0], [0, 0, 0], [0, 0, 0]], atol=1e-12)


def test_an_interval_that_ends_with_the_table_is_covered() -> None:
    imu = _imu(0.0)
    ends = np.array([imu.times[0], imu.times[100], imu.times[-1]])
    assert _covered(ends, imu).tolist() == [True, True]
    kept = (np.arange(400) < 101) | (np.arange(400) > 180)
    torn = Imu(imu.times[kept], imu.acceleration[kept], imu.angular_velocity[kept], True, None)
    at = imu.times[[0, 100, 181, 399]]
    assert _covered(at, torn).tolist() == [True, False, True]
