"""What each measurement is worth in the joint problem: its error and its noise, by formulas of their own."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import B, C, D, E, G, L, S, V, X
from scene import CAMERA, arc, cloud, in_pixels
from scipy.spatial.transform import Rotation

from rholoc.geometry import Camera, FloatArray, pose_matrix
from rholoc.recordings import GRAVITY, Imu
from rholoc.trajectory.inertial.gyroscope import GyroCalibration
from rholoc.trajectory.optimization import adjustment
from rholoc.trajectory.optimization.adjustment import (
    GIVEN,
    GUESSED,
    Adjusted,
    CameraSigmas,
    Fix,
    InertialState,
    Problem,
    State,
    adjust,
    imu_noise,
    preintegrated,
    residuals_px,
    robust,
    triangulate,
)
from rholoc.trajectory.visual.tracks import Observations

_PINHOLE = Camera(640, 480, 500.0, 500.0, 320.0, 240.0)
_R_CAMERA_IMU = Rotation.from_euler("xyz", [80, 10, 5], degrees=True).as_matrix()
_FORCE = np.array([0.4, -0.3, 0.2])  # m/s², by which the walk below speeds up, in the map's axes
_START_SPEED = np.array([0.5, 0.1, -0.2])
_TURN_RAD_S = 0.4  # about the map's z axis
_DELAY_S, _CLOCK_S = 0.013, 0.002
_LEVER_M = np.array([0.02, -0.01, 0.005])  # from the IMU to the camera
_BIAS = np.array([0.05, -0.02, 0.03, 0.004, -0.003, 0.002])


def _cauchy(squared: FloatArray, sigmas: float) -> float:
    """The cost of errors whose squares in standard deviations are given."""
    return float(np.sum(sigmas**2 / 2 * np.log1p(squared / sigmas**2)))


def _sightings(T: FloatArray, points: FloatArray, noise_px: float = 0.0, seed: int = 0) -> Observations:
    rng = np.random.default_rng(seed)
    keyframes, tracks = (grid.ravel() for grid in np.meshgrid(np.arange(len(T)), np.arange(len(points)), indexing="ij"))
    pixels = np.concatenate([in_pixels(points, one) for one in T]) + rng.normal(0, noise_px, (len(tracks), 2))
    return Observations(keyframes, tracks, pixels)


def _factors_of(graph: gtsam.NonlinearFactorGraph, *keys: int) -> list[gtsam.NonlinearFactor]:
    """Those between just these unknowns."""
    every = (graph.at(i) for i in range(graph.size()))
    return [factor for factor in every if sorted(factor.keys()) == sorted(keys)]


def _covariance(factor: gtsam.NonlinearFactor, values: gtsam.Values) -> FloatArray:
    """Of the one unknown that a factor measures."""
    A = factor.linearize(values).jacobian()[0]
    return np.asarray(np.linalg.inv(A.T @ A))


def _sigmas(factor: gtsam.NonlinearFactor, values: gtsam.Values) -> FloatArray:
    return np.sqrt(np.diag(_covariance(factor, values)))


@pytest.mark.parametrize("known", [True, False])
def test_sightings_cost_what_cauchys_loss_makes_of_their_distance(known: bool) -> None:
    """Two sigmas are where it begins to doubt; intrinsics at their guess cost nothing more."""
    T, points = arc(3), cloud(10)
    observations = _sightings(T, points, 1.5)
    used = np.arange(len(observations)) % 4 > 0
    problem = Problem(np.arange(3.0), observations, camera_sigmas=None if known else GUESSED, pixel_sigma_px=0.6)
    state = State(T, points, CAMERA)
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k, one in enumerate(T):
        values.insert(C(k), gtsam.Pose3(one))
    adjustment._add_sightings(graph, values, problem, state, used)
    seen = np.concatenate([in_pixels(points, one) for one in T])
    off_px = residuals_px(observations, state) if known else np.linalg.norm(seen - observations.pixels, axis=1)
    assert graph.error(values) == pytest.approx(_cauchy((off_px[used] / 0.6) ** 2, 2.0), rel=1e-4)
    assert values.exists(D(0)) is not known


@pytest.mark.parametrize("sigmas", [GUESSED, GIVEN, CameraSigmas(0.1, 0.02, 0.3)])
def test_intrinsics_are_known_as_well_as_is_said(sigmas: CameraSigmas) -> None:
    camera = replace(CAMERA, fx=500.0, fy=520.0)
    covariance = adjustment._camera_prior(camera, sigmas).covariance()
    deviations = np.sqrt(np.diag(covariance))
    focal = np.sqrt(500.0 * 520.0)
    np.testing.assert_allclose(deviations[:2], sigmas.focal * focal, rtol=1e-5)
    np.testing.assert_allclose(deviations[3:5], sigmas.centre * 640)
    np.testing.assert_allclose(deviations[5:7], sigmas.distortion)
    assert deviations[[2, 7, 8]].max() < 1e-4  # no skew, nothing tangential
    shape = np.array([1.0, -1.0, 0, 0, 0, 0, 0, 0, 0])  # of a pixel, which stays a square to a thousandth
    assert np.sqrt(shape @ covariance @ shape) == pytest.approx(np.sqrt(2) * 1e-3 * sigmas.focal * focal, rel=1e-3)
    assert np.count_nonzero(covariance - np.diag(np.diag(covariance))) == 2
    assert GIVEN.focal < 1e-3 < 1e-2 < GUESSED.focal < 0.1
    assert GIVEN.centre < 1e-4 < 5e-3 < GUESSED.centre < 0.02
    assert 5e-3 < GIVEN.distortion < 0.02 < 0.1 < GUESSED.distortion < 0.3


@pytest.mark.parametrize("distortion", [(), (-0.1, 0.02, 1e-3, -2e-3)])
def test_a_camera_goes_to_the_solver_and_comes_back(distortion: tuple[float, ...]) -> None:
    camera = Camera(640, 480, 500.0, 510.0, 322.0, 241.0, distortion)
    model = adjustment._to_gtsam(camera)
    for point in ([0.3, -0.2], [-0.1, 0.4]):
        expected = camera.project(np.array([[*point, 1.0]]))[0]
        np.testing.assert_allclose(model.uncalibrate(np.array(point)), expected, atol=1e-9)
    back = adjustment._from_gtsam(model, camera)
    assert back == replace(camera, distortion=(*distortion, 0.0, 0.0, 0.0, 0.0)[:4])


def test_a_phones_imu_is_worth_what_data_sheets_say() -> None:
    for times in (1.0, 3.0):
        noise = imu_noise(times)
        np.testing.assert_allclose(np.sqrt(noise.getAccelerometerCovariance()), times * 0.01 * np.eye(3))
        np.testing.assert_allclose(np.sqrt(noise.getGyroscopeCovariance()), times * 5e-4 * np.eye(3))
        np.testing.assert_allclose(np.sqrt(noise.getIntegrationCovariance()), times * 1e-4 * np.eye(3))
        np.testing.assert_allclose(np.sqrt(noise.getBiasAccCovariance()), 2e-3 * np.eye(3))
        np.testing.assert_allclose(np.sqrt(noise.getBiasOmegaCovariance()), 2e-4 * np.eye(3))


def _walk(times: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Poses of the IMU (K, 4, 4) and its speed (K, 3): a steady push, a steady turn."""
    t = times[:, None]
    R = Rotation.from_rotvec(t * [0.0, 0.0, _TURN_RAD_S]).as_matrix() @ _R_CAMERA_IMU
    return pose_matrix(R, _START_SPEED * t + _FORCE * t**2 / 2), _START_SPEED + _FORCE * t


def _imu(until_s: float = 3.0, hz: float = 400.0) -> Imu:
    """What it reads on the way, on a clock of its own."""
    times = np.arange(-0.2, until_s, 1 / hz)
    T, _ = _walk(times)
    felt = np.einsum("nji,j->ni", T[:, :3, :3], np.add(_FORCE, [0.0, 0.0, GRAVITY])) + _BIAS[:3]
    rate = np.einsum("nji,j->ni", T[:, :3, :3], [0.0, 0.0, _TURN_RAD_S]) + _BIAS[3:]
    return Imu(times + _DELAY_S + _CLOCK_S, felt, rate, True, None)


_MOUNTED = pose_matrix(np.eye(3), _LEVER_M) @ pose_matrix(
    Rotation.from_euler("x", 20, degrees=True).as_matrix(), _LEVER_M
)


def _inertial_problem(imu: Imu, times: FloatArray) -> tuple[Problem, State]:
    """A problem without sightings, and the true state of its walk."""
    T, speed = _walk(times)
    gyro = GyroCalibration(_DELAY_S, 0.0, _BIAS[3:], 0.0, _MOUNTED[:3, :3].T, False, 0.0, 0.0)
    count = len(times)
    inertial = InertialState(speed, np.tile(_BIAS, (count, 1)), _MOUNTED, _CLOCK_S, np.array([0.0, 0.0, -GRAVITY]))
    nothing = Observations(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 2)))
    return Problem(times, nothing, imu, gyro), State(T @ _MOUNTED, np.zeros((0, 3)), _PINHOLE, inertial)


def _inertial_graph(problem: Problem, state: State) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k, one in enumerate(state.T_map_camera):
        values.insert(C(k), gtsam.Pose3(one))
    assert problem.imu is not None
    assert state.inertial is not None
    adjustment._add_imu(graph, values, problem, problem.imu, state, state.inertial)
    return graph, values


def test_the_true_walk_explains_what_the_imu_reads() -> None:
    problem, state = _inertial_problem(_imu(), np.array([0.0, 0.4, 1.0, 2.0]))
    graph, values = _inertial_graph(problem, state)
    for k in range(3):
        (moved,) = _factors_of(graph, X(k), V(k), X(k + 1), V(k + 1), B(k), B(k + 1), G(0))
        assert moved.error(values) < 1e-2  # of some 1e4, were a sign wrong
        place = values.atPose3(X(k + 1))
        shifted = gtsam.Values(values)
        shifted.update(X(k + 1), gtsam.Pose3(place.rotation(), place.translation() + np.array([0.05, 0.0, 0.0])))
        assert moved.error(shifted) > 1
    for k in range(4):  # rates are read where the camera's clock says, the IMU's delay on top
        (tied,) = _factors_of(graph, C(k), X(k), V(k), E(0), S(0))
        off = tied.unwhitenedError(values)
        speed = np.linalg.norm(_walk(problem.times)[1][k])
        assert np.abs(off[:3]).max() < 1.1 * _TURN_RAD_S * _CLOCK_S
        assert np.abs(off[3:]).max() < 1.1 * speed * _CLOCK_S
        at_once = gtsam.Values(values)
        at_once.update(S(0), np.zeros(1))
        np.testing.assert_allclose(tied.unwhitenedError(at_once), 0, atol=1e-9)
        np.testing.assert_allclose(tied.noiseModel().sigmas(), np.repeat([2e-4, 5e-4], 3))


def test_the_imus_mounting_clock_and_biases_are_known_as_well_as_a_phones() -> None:
    problem, state = _inertial_problem(_imu(), np.array([0.0, 1.0]))
    graph, values = _inertial_graph(problem, state)
    (mounting,), (clock,), (bias,) = (_factors_of(graph, key) for key in (E(0), S(0), B(0)))
    np.testing.assert_allclose(mounting.noiseModel().sigmas(), np.repeat([0.02, 0.03], 3))
    assert mounting.unwhitenedError(values)[:3] == pytest.approx(0, abs=1e-9)  # as calibrated, …
    assert np.linalg.norm(mounting.unwhitenedError(values)[3:]) == pytest.approx(np.linalg.norm(_MOUNTED[:3, 3]))
    assert clock.unwhitenedError(values)[0] == pytest.approx(_CLOCK_S)
    np.testing.assert_allclose(clock.noiseModel().sigmas(), 3e-3)
    np.testing.assert_allclose(bias.unwhitenedError(values), [*_BIAS[:3], 0, 0, 0])  # … and the gyroscope's bias
    np.testing.assert_allclose(bias.noiseModel().sigmas(), np.repeat([0.3, 0.02], 3))
    (gravity,) = _factors_of(graph, G(0))
    np.testing.assert_allclose(gravity.unwhitenedError(values), 0)


def test_over_a_gap_biases_wander_and_the_speed_is_open() -> None:
    imu = _imu()
    kept = (imu.times < 0.5) | (imu.times > 0.8)
    torn = Imu(imu.times[kept], imu.acceleration[kept], imu.angular_velocity[kept], True, None)
    problem, state = _inertial_problem(torn, np.array([0.0, 0.4, 1.3, 1.5]))
    graph, values = _inertial_graph(problem, state)
    assert not _factors_of(graph, X(1), V(1), X(2), V(2), B(1), B(2), G(0))
    assert _factors_of(graph, X(2), V(2), X(3), V(3), B(2), B(3), G(0))
    (wander,), (speed,) = _factors_of(graph, B(1), B(2)), _factors_of(graph, V(2))
    np.testing.assert_allclose(wander.noiseModel().sigmas(), np.repeat([2e-3, 2e-4], 3) * np.sqrt(0.9))
    np.testing.assert_allclose(speed.noiseModel().sigmas(), 10.0)
    np.testing.assert_allclose(speed.unwhitenedError(values), values.atVector(V(2)))


def test_keyframes_outside_the_imus_table_have_no_imu() -> None:
    imu = _imu(until_s=1.2)
    problem, state = _inertial_problem(imu, np.array([-0.6, 0.0, 0.5, 1.5]))
    _, values = _inertial_graph(problem, state)
    assert [values.exists(X(k)) for k in range(4)] == [False, True, True, False]
    ends = imu.times[[0, -1]] - _DELAY_S
    problem, state = _inertial_problem(imu, np.array([ends[0], 0.5, ends[1]]))
    _, values = _inertial_graph(problem, state)
    assert all(values.exists(X(k)) for k in range(3))


def test_readings_are_summed_as_trapezoids_between_any_two_times() -> None:
    """A force that grows, felt by an IMU that does not turn: known to the last digit, between readings too."""
    times = np.arange(0, 2, 0.01)
    jerk, start = np.array([0.3, -0.2, 0.1]), np.array([0.1, 0.2, 9.8])
    imu = Imu(times, start + times[:, None] * jerk, np.zeros((len(times), 3)), True, None)
    still = gtsam.imuBias.ConstantBias()
    a, b = 0.1234, 1.5678
    summed = preintegrated(imu, a, b, imu_noise(1), still, 0.1)
    assert summed is not None
    assert summed.deltaTij() == pytest.approx(b - a)
    np.testing.assert_allclose(summed.deltaVij(), start * (b - a) + jerk * (b**2 - a**2) / 2, atol=1e-9)
    speed_at_a = start * a + jerk * a**2 / 2
    way = start * (b**2 - a**2) / 2 + jerk * (b**3 - a**3) / 6 - speed_at_a * (b - a)
    np.testing.assert_allclose(summed.deltaPij(), way, atol=1e-5)
    whole = preintegrated(imu, 0.5, 1.0, imu_noise(1), still, 0.1)
    assert whole is not None
    assert whole.deltaTij() == pytest.approx(0.5)
    turning = Imu(times, imu.acceleration, np.tile([0.0, 0.0, 0.7], (len(times), 1)), True, None)
    turned = preintegrated(turning, a, b, imu_noise(1), still, 0.1)
    assert turned is not None
    assert turned.deltaRij().yaw() == pytest.approx(0.7 * (b - a))


def test_a_gap_is_bridged_by_nothing_wherever_it_begins() -> None:
    times = np.concatenate([np.arange(0, 1, 0.01), np.arange(1.2, 2, 0.01)])
    imu = Imu(times, np.zeros((len(times), 3)), np.zeros((len(times), 3)), True, None)
    parameters, still = imu_noise(1), gtsam.imuBias.ConstantBias()
    for start, end, carried in [
        (0.2, 0.9, True),
        (0.2, 0.995, False),
        (1.1, 1.15, False),
        (1.1, 1.4, False),
        (1.205, 1.9, True),
        (0.5, 1.5, False),
    ]:
        assert (preintegrated(imu, start, end, parameters, still, 0.1) is not None) is carried, (start, end)
    assert preintegrated(imu, 0.5, 1.5, parameters, still, 0.3) is not None


def test_gravity_is_as_level_as_the_waypoints() -> None:
    nothing = Observations(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 2)))
    fixed = Problem(np.zeros(1), nothing, fixes=(Fix(0, (0.0, 0.0, 0.0), 0.02),))
    level = GRAVITY * np.radians(0.5)
    np.testing.assert_allclose(adjustment._gravity_prior(fixed).sigmas(), [level, level, 0.05])
    np.testing.assert_allclose(adjustment._gravity_prior(replace(fixed, fixes=())).sigmas(), [1e-4, 1e-4, 0.05])
    free = replace(fixed, level_sigma_rad=None)
    np.testing.assert_allclose(adjustment._gravity_prior(free).sigmas(), GRAVITY)
    np.testing.assert_allclose(adjustment._gravity_prior(replace(free, fixes=())).sigmas(), [1e-4, 1e-4, 0.05])


def _posed(T: FloatArray) -> gtsam.Values:
    values = gtsam.Values()
    for k, one in enumerate(T):
        values.insert(C(k), gtsam.Pose3(one))
    return values


def test_keyframes_that_see_less_than_four_points_stay_about_where_they_are() -> None:
    """By a radian, and by as much as the walk measures."""
    T = arc(5)
    graph, values = gtsam.NonlinearFactorGraph(), _posed(T)
    values.insert(X(3), gtsam.Pose3())  # the IMU holds it
    seeing = np.repeat([0, 1, 2], [4, 3, 9])
    adjustment._hold_unseen(graph, values, seeing, State(T, np.zeros((0, 3)), _PINHOLE))
    held = [k for k in range(5) if _factors_of(graph, C(k))]
    assert held == [1, 4]
    extent_m = np.linalg.norm(np.ptp(T[:, :3, 3], axis=0))
    for k in held:
        (factor,) = _factors_of(graph, C(k))
        np.testing.assert_allclose(factor.unwhitenedError(values), 0, atol=1e-12)
        np.testing.assert_allclose(_sigmas(factor, values), [1, 1, 1, *[extent_m] * 3])


def test_fixes_cost_what_cauchys_loss_makes_of_them() -> None:
    T = arc(4)
    graph, values = gtsam.NonlinearFactorGraph(), _posed(T)
    off_m = np.array([0.03, -0.06, 0.02])
    adjustment._add_fixes(graph, [Fix(2, tuple((T[2, :3, 3] + off_m).tolist()), 0.02)])
    assert graph.error(values) == pytest.approx(_cauchy(np.array([off_m @ off_m / 0.02**2]), 3.0))


def test_what_nothing_measures_is_held() -> None:
    """Place and heading of the first camera where an IMU measures the rest; else its pose, and the walk's size."""
    T = pose_matrix(Rotation.random(5, rng=np.random.default_rng(2)).as_matrix(), arc(5)[:, :3, 3])
    T[:, :3, 3] *= np.array([1, 2, 5, 3, 4])[:, None]
    state, values = State(T, np.zeros((0, 3)), _PINHOLE), _posed(T)
    metric = gtsam.NonlinearFactorGraph()
    adjustment._fix_gauge(metric, values, state, metric=True)
    assert metric.size() == 1
    covariance = _covariance(metric.at(0), values)
    about_map = T[0, :3, :3] @ covariance[:3, :3] @ T[0, :3, :3].T
    assert np.sqrt(about_map[2, 2]) == pytest.approx(1e-4)
    assert np.sqrt(np.linalg.eigvalsh(about_map)[1]) > 1  # rad, of its tilt
    np.testing.assert_allclose(covariance[3:, 3:], 1e-8 * np.eye(3), atol=1e-12)

    graph = gtsam.NonlinearFactorGraph()
    adjustment._fix_gauge(graph, values, state, metric=False)
    (pose,) = _factors_of(graph, C(0))
    np.testing.assert_allclose(_sigmas(pose, values), 1e-4)
    away_m = np.linalg.norm(T[:, :3, 3] - T[0, :3, 3], axis=1)
    far = int(away_m.argmax())
    (size,) = _factors_of(graph, C(0), C(far))
    assert size.unwhitenedError(values) == pytest.approx(0, abs=1e-12)
    np.testing.assert_allclose(size.noiseModel().sigmas(), 1e-4 * away_m[far])


def test_points_are_held_by_their_distance_from_who_sees_them() -> None:
    T, points = arc(3), cloud(4)
    observations = _sightings(T, points)
    used = observations.tracks != 1
    used &= ~((observations.tracks == 2) & (observations.keyframes == 0))
    held = adjustment._held_points(observations, State(T, points, CAMERA), used, 0.3)
    assert held.size() == 3
    for i, (track, seeing) in enumerate([(0, [0, 1, 2]), (2, [1, 2]), (3, [0, 1, 2])]):
        assert list(held.at(i).keys()) == [L(track)]
        furthest_m = max(np.linalg.norm(points[track] - T[k, :3, 3]) for k in seeing)
        A, b = held.at(i).jacobian()
        np.testing.assert_allclose(A, 0.3 / furthest_m * np.eye(3))
        np.testing.assert_allclose(b, 0)


def test_points_go_first_and_what_all_share_last() -> None:
    problem, state = _inertial_problem(_imu(), np.array([0.0, 0.4, 1.0, 2.0]))
    points = cloud(12)
    observations = _sightings(arc(4), points)
    problem = replace(problem, observations=observations, camera_sigmas=GUESSED)
    _, values = _inertial_graph(problem, state)
    used = observations.tracks != 3
    adjustment._add_sightings(gtsam.NonlinearFactorGraph(), values, problem, replace(state, points=points), used)
    ordering = adjustment._ordering(values, observations, used)
    keys = [ordering.at(i) for i in range(ordering.size())]
    assert sorted(keys) == sorted(values.keys())
    assert keys[:11] == [L(track) for track in range(12) if track != 3]
    assert keys[-4:] == [G(0), S(0), E(0), D(0)]


def test_a_state_goes_to_the_solver_and_comes_back() -> None:
    problem, state = _inertial_problem(_imu(until_s=1.2), np.array([0.0, 0.5, 1.5]))
    _, values = _inertial_graph(problem, state)
    values.update(V(1), np.array([1.0, 2.0, 3.0]))
    values.update(B(0), gtsam.imuBias.ConstantBias(np.array([0.1, 0.2, 0.3]), np.array([0.4, 0.5, 0.6])))
    values.update(S(0), np.array([0.007]))
    back = adjustment._state_of(values, problem, state, np.zeros(0, np.bool_))
    np.testing.assert_allclose(back.T_map_camera, state.T_map_camera, atol=1e-12)
    assert back.inertial is not None
    assert state.inertial is not None
    np.testing.assert_allclose(back.inertial.velocities[1], [1, 2, 3])
    np.testing.assert_allclose(back.inertial.velocities[[0, 2]], state.inertial.velocities[[0, 2]])
    np.testing.assert_allclose(back.inertial.biases[0], np.arange(1, 7) / 10)
    np.testing.assert_allclose(back.inertial.biases[1:], np.tile(_BIAS, (2, 1)))
    assert back.inertial.clock_s == 0.007
    np.testing.assert_allclose(back.inertial.T_imu_camera, _MOUNTED)
    np.testing.assert_allclose(back.inertial.gravity, [0, 0, -GRAVITY])


def _no_points(_: float) -> gtsam.GaussianFactorGraph:
    return gtsam.GaussianFactorGraph()


def _adjusted(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, T: FloatArray) -> Adjusted:
    ordering = gtsam.Ordering()
    for key in values.keys():  # noqa: SIM118 - no mapping
        ordering.push_back(key)
    state = State(T, np.zeros((0, 3)), _PINHOLE)
    return Adjusted(state, np.zeros(0, np.bool_), 0.0, graph, values, ordering, _no_points)


def test_covariances_are_of_the_place_and_of_the_rotation_about_the_maps_axes() -> None:
    """Each by itself: known a priori along the camera's axes."""
    T = arc(3, 2.5)
    graph, values = gtsam.NonlinearFactorGraph(), _posed(T)
    deviations = np.array([0.01, 0.02, 0.03, 0.1, 0.2, 0.4])  # about x, y, z, then along them
    for k in range(3):
        noise = gtsam.noiseModel.Diagonal.Sigmas((k + 1) * deviations)
        graph.add(gtsam.PriorFactorPose3(C(k), gtsam.Pose3(T[k]), noise))
    found = _adjusted(graph, values, T).covariances([2, 0])
    for covariance, k in zip(found, (2, 0), strict=True):
        R = T[k, :3, :3]
        np.testing.assert_allclose(covariance[:3, :3], (k + 1) ** 2 * R @ np.diag(deviations[3:] ** 2) @ R.T, atol=1e-9)
        np.testing.assert_allclose(covariance[3:, 3:], (k + 1) ** 2 * R @ np.diag(deviations[:3] ** 2) @ R.T, atol=1e-9)
        np.testing.assert_allclose(covariance[:3, 3:], 0, atol=1e-9)


def test_the_intrinsics_sigmas_are_in_the_order_of_the_intrinsics() -> None:
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    values.insert(D(0), adjustment._to_gtsam(CAMERA))
    sigmas = np.arange(1.0, 10.0)
    noise = gtsam.noiseModel.Diagonal.Sigmas(sigmas)
    graph.add(gtsam.PriorFactorCal3DS2(D(0), adjustment._to_gtsam(CAMERA), noise))
    np.testing.assert_allclose(_adjusted(graph, values, arc(1)).camera_sigmas(), sigmas)


def test_the_imus_misfit_is_in_its_own_noise() -> None:
    """A walk whose errors are as large as the noise has a misfit of one; other factors have no say in it."""
    problem, state = _inertial_problem(_imu(), np.array([0.0, 0.4, 1.0]))
    graph, values = _inertial_graph(problem, state)
    whole = _adjusted(graph, values, state.T_map_camera)
    assert whole.imu_misfit() < 0.1
    for k in (1, 2):
        place = values.atPose3(X(k))
        shifted = gtsam.Pose3(place.rotation(), place.translation() + np.array([0.02 * k, 0.0, 0.0]))
        values.update(X(k), shifted)
    squares = 0.0
    for k in range(2):
        (moved,) = _factors_of(graph, X(k), V(k), X(k + 1), V(k + 1), B(k), B(k + 1), G(0))
        squares += float(np.sum(moved.whitenedError(values) ** 2))
    assert whole.imu_misfit() == pytest.approx(np.sqrt(squares / 18))
    assert whole.imu_misfit() > 0.5
    assert _adjusted(gtsam.NonlinearFactorGraph(), values, state.T_map_camera).imu_misfit() == 0


def test_cauchys_loss_begins_to_doubt_where_it_is_told() -> None:
    noise = robust(2.5, gtsam.noiseModel.Isotropic.Sigma(1, 0.1))
    assert noise.loss(0.3**2 / 0.1**2) == pytest.approx(_cauchy(np.array([9.0]), 2.5))
    assert noise.weight(np.array([2.5])) == pytest.approx(0.5)


def _two_rays(half_angle_deg: float) -> tuple[Observations, State]:
    """A point ten metres ahead of the middle between cameras that look along z, seen at twice the angle."""
    half_m = 10 * np.tan(np.radians(half_angle_deg))
    T = pose_matrix(np.tile(np.eye(3), (3, 1, 1)), np.array([[-half_m, 0, 0], [half_m, 0, 0], [0.0, 0, 0]]))
    pixels = _PINHOLE.project(np.array([0.0, 0, 10]) - T[:, :3, 3])
    return Observations(np.arange(3), np.zeros(3, np.int64), pixels), State(T, np.zeros((1, 3)), _PINHOLE)


@pytest.mark.parametrize("half_angle_deg", [0.5, 4.0, 30.0])
def test_the_widest_angle_is_between_the_outermost_rays(half_angle_deg: float) -> None:
    points, parallax_deg = triangulate(*_two_rays(half_angle_deg))
    np.testing.assert_allclose(points, [[0, 0, 10]], atol=1e-4)
    assert parallax_deg == pytest.approx([2 * half_angle_deg], rel=1e-6)


@pytest.mark.parametrize(("half_angle_deg", "used"), [(0.7, False), (0.8, True)])
def test_points_need_a_degree_and_a_half(half_angle_deg: float, used: bool) -> None:
    assert adjustment._usable_points(*_two_rays(half_angle_deg), 0.7)[1].all() == used
    assert adjustment._usable_points(*_two_rays(half_angle_deg), 0.7)[1].any() == used


def test_the_distance_of_a_sighting_is_in_pixels() -> None:
    observations, state = _two_rays(4.0)
    moved = replace(observations, pixels=np.add(observations.pixels, [[3.0, 4.0], [0.0, 0.0], [-6.0, 8.0]]))
    np.testing.assert_allclose(residuals_px(moved, state, np.array([[0.0, 0, 10]])), [5, 0, 10], atol=1e-9)
    np.testing.assert_allclose(
        residuals_px(moved, replace(state, points=np.array([[0.0, 0, 10]]))), [5, 0, 10], atol=1e-9
    )
    assert np.isinf(residuals_px(moved, state, np.array([[0.0, 0, -10]]))).all()


def test_sightings_far_off_and_points_seldom_seen_are_not_used() -> None:
    """Twenty pixels are far off where most are near, four times the median where none is."""
    T, points = arc(5), cloud(30)
    seen = _sightings(T, points)
    kept = ~((seen.tracks == 0) & (seen.keyframes > 1)) & ~((seen.tracks == 1) & (seen.keyframes > 2))
    seen = Observations(seen.keyframes[kept], seen.tracks[kept], seen.pixels[kept])
    state = State(T, points, CAMERA)
    pixels = seen.pixels.copy()
    (wrong,) = np.flatnonzero((seen.tracks == 7) & (seen.keyframes == 2))
    pixels[wrong] += [0.0, 60.0]
    found, used = adjustment._usable_points(replace(seen, pixels=pixels), state, 0.7)
    assert not used[wrong]
    assert used[(seen.tracks == 7) & (seen.keyframes != 2)].all()
    assert not used[seen.tracks == 0].any()
    assert used[seen.tracks == 1].all()
    assert used.sum() == len(seen) - 3
    np.testing.assert_allclose(found[8:], points[8:], atol=1e-4)
    rough = pixels + np.random.default_rng(0).normal(0, 15, pixels.shape)
    assert adjustment._usable_points(replace(seen, pixels=rough), state, 0.7)[1].mean() > 0.8


def test_settled_points_are_where_no_step_lowers_their_cost() -> None:
    """Under Cauchy's loss in the image; what lies behind a camera has no say."""
    T, points = arc(6), cloud(12)
    observations = _sightings(T, points, 1.0)
    pixels = observations.pixels.copy()
    pixels[3] += [9.0, -7.0]
    behind = pose_matrix(np.eye(3), np.array([0.0, 0.0, 3.0]))
    T = np.concatenate([T, behind[None]])
    keyframes, tracks = np.append(observations.keyframes, 6), np.append(observations.tracks, 5)
    seen = Observations(keyframes, tracks, np.concatenate([pixels, [[100.0, 100.0]]]))
    state, sigma_px = State(T, points, CAMERA), 0.8
    settled = adjustment._settled(points, seen, state, sigma_px)

    def cost(at: FloatArray) -> FloatArray:
        off_px = residuals_px(seen, state, at)
        each = np.where(np.isfinite(off_px), np.log1p(np.minimum(off_px, 1e6) ** 2 / (2 * sigma_px) ** 2), 0.0)
        return np.bincount(seen.tracks, each)

    lowest = cost(settled)
    for step in 2e-3 * np.concatenate([np.eye(3), -np.eye(3)]):
        assert np.all(cost(settled + step) > lowest - 1e-4)
        assert np.mean(cost(settled + step) > lowest) > 0.8
    np.testing.assert_array_equal(points, cloud(12))  # the ones given are what they were


class _Scripted(adjustment._Descent):
    """Steps whose costs are known beforehand."""

    costs: Iterator[float]

    def _stepped(self, values: gtsam.Values, cost: float) -> tuple[gtsam.Values, float]:
        return values, next(self.costs)


@pytest.mark.parametrize(
    ("costs", "tolerance", "steps"),
    [
        ([50.0, 49.0, 48.9], 1e-2, 3),
        ([50.0, 49.6, 40.0], 1e-2, 2),
        ([50.0, 49.0, 48.9, 48.899], 1e-3, 4),
        ([100.0], 1e-3, 1),
        ([90.0, 80.0, 70.0, 60.0, 50.0], 1e-3, 5),
    ],
)
def test_steps_end_where_they_gain_too_little(costs: list[float], tolerance: float, steps: int) -> None:
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    values.insert(V(0), np.full(3, 10.0))
    noise = gtsam.noiseModel.Isotropic.Sigma(3, np.sqrt(1.5))
    graph.add(gtsam.PriorFactorVector(V(0), np.zeros(3), noise))  # a cost of a hundred
    descent = _Scripted(graph, gtsam.Ordering(), _no_points, lambda values: values)
    object.__setattr__(descent, "costs", iter(costs))
    heard: list[float] = []
    _, cost = descent.solve(values, 5, tolerance, heard.append)
    assert cost == costs[steps - 1]
    assert heard == pytest.approx(np.arange(1, steps + 1) / 5)


def test_a_step_is_tried_whole_and_in_part_with_the_points_settled() -> None:
    values = gtsam.Values()
    values.insert(V(0), np.array([1.0, 0.0, 0.0]))
    step = gtsam.VectorValues()
    step.insert(V(0), np.array([8.0, 0.0, 0.0]))

    def settled(there: gtsam.Values) -> gtsam.Values:
        found = gtsam.Values(there)
        found.update(V(0), np.add(there.atVector(V(0)), [0.0, 1.0, 0.0]))
        return found

    descent = adjustment._Descent(gtsam.NonlinearFactorGraph(), gtsam.Ordering(), _no_points, settled)
    tried = [there.atVector(V(0)).tolist() for there in descent._along(values, step)]
    assert tried == [[9, 0, 0], [9, 1, 0], [5, 1, 0], [3, 1, 0]]


def test_points_are_held_more_and_more_firmly() -> None:
    asked: list[float] = []

    def held(firmness: float) -> gtsam.GaussianFactorGraph:
        asked.append(firmness)
        return _no_points(firmness)

    assert len(list(adjustment._with_points_held(gtsam.GaussianFactorGraph(), held))) == 3
    assert asked == sorted(asked)
    assert asked[0] < 0.02
    assert asked[-1] < 20


def test_the_cost_that_is_reported_is_that_of_all_measurements() -> None:
    """Half the sum of squares under Cauchy's loss: of sightings and fixes."""
    T, points = arc(5), cloud(30)
    observations = _sightings(T, points, 0.5)
    off_m = np.array([0.01, 0.0, -0.01])
    fixes = tuple(Fix(k, tuple((T[k, :3, 3] + off_m * (k - 2)).tolist()), 0.02) for k in (0, 2, 4))
    problem = Problem(np.arange(5.0), observations, fixes=fixes, pixel_sigma_px=0.5)
    found = adjust(problem, State(T, points, CAMERA), 12)
    off_px = residuals_px(observations, found.state)[found.used]
    missed_m = np.array([np.linalg.norm(found.state.positions[fix.keyframe] - fix.position) for fix in fixes])
    expected = _cauchy((off_px / 0.5) ** 2, 2.0) + _cauchy((missed_m / 0.02) ** 2, 3.0)
    assert found.cost == pytest.approx(expected, rel=1e-3)


def test_what_nothing_measures_leaves_the_shape_open() -> None:
    """Covariances without a bound are NaN."""
    values, ordering = gtsam.Values(), gtsam.Ordering()
    graph = gtsam.NonlinearFactorGraph()
    for k in range(2):
        values.insert(V(k), np.ones(3))
        ordering.push_back(V(k))
    graph.add(gtsam.BetweenFactorVector(V(0), V(1), np.ones(3), gtsam.noiseModel.Unit.Create(3)))
    state = State(arc(1), np.zeros((0, 3)), _PINHOLE)
    open_shape = Adjusted(state, np.zeros(0, np.bool_), 0.0, graph, values, ordering, _no_points)
    assert np.isnan(open_shape.covariances([0])).all()
    assert np.isnan(open_shape.camera_sigmas()).all()


@pytest.mark.parametrize(("coarsely", "tolerance"), [(True, 1e-3), (False, 2e-4)])
def test_how_little_a_step_may_gain(coarsely: bool, tolerance: float, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[int, float]] = []

    def solve(
        self: object, values: gtsam.Values, iterations: int, least: float, progress: object
    ) -> tuple[gtsam.Values, float]:
        asked.append((iterations, least))
        return values, 1.0

    monkeypatch.setattr(adjustment._Descent, "solve", solve)
    T, points = arc(5), cloud(30)
    problem = Problem(np.arange(5.0), _sightings(T, points, 0.5))
    adjust(problem, State(T, points, CAMERA), 7, coarsely=coarsely)
    assert asked == [(7, tolerance)]
    assert problem.pixel_sigma_px == 0.7
    assert problem.imu_noise == 1.0
    assert problem.level_sigma_rad == np.radians(0.5)


def test_a_step_that_leads_up_is_tried_with_the_points_settled_before_a_firmer_one() -> None:
    """A point far from where its sightings put it would throw the cameras; settled first, the cost falls at once."""
    T, points = arc(5), cloud(30)
    observations = _sightings(T, points, 0.3)
    problem = Problem(np.arange(5.0), observations, pixel_sigma_px=0.5)
    rng = np.random.default_rng(0)
    turned = T[:, :3, :3] @ Rotation.from_rotvec(rng.normal(0, 0.03, (5, 3))).as_matrix()
    start = State(pose_matrix(turned, T[:, :3, 3] + rng.normal(0, 0.1, (5, 3))), points, CAMERA)
    heard: list[float] = []
    found = adjust(problem, start, 30, heard.append)
    assert len(heard) < 25
    assert np.median(residuals_px(observations, found.state)) < 0.5
