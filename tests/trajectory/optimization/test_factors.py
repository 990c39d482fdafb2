"""What each measurement is worth in the joint problem: its error and its noise, by formulas of their own."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import B, C, E, G, S, V, X
from scene import CAMERA, arc, cloud, in_pixels
from scipy.spatial.transform import Rotation

from rholoc.geometry import Camera, FloatArray, pose_matrix
from rholoc.recordings import GRAVITY, Imu
from rholoc.trajectory.inertial.gyroscope import GyroCalibration
from rholoc.trajectory.optimization import imu_factors
from rholoc.trajectory.optimization.adjustment import Adjusted, adjust
from rholoc.trajectory.optimization.factors import robust
from rholoc.trajectory.optimization.imu_factors import imu_noise, preintegrated
from rholoc.trajectory.optimization.points import residuals_px, triangulate
from rholoc.trajectory.optimization.problem import Fix, InertialState, Problem, State
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
    nothing = Observations.none()
    return Problem(times, nothing, imu, gyro), State(T @ _MOUNTED, np.zeros((0, 3)), _PINHOLE, inertial)


def _inertial_graph(problem: Problem, state: State) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k, one in enumerate(state.T_map_camera):
        values.insert(C(k), gtsam.Pose3(one))
    assert problem.imu is not None
    assert state.inertial is not None
    imu_factors.add_imu(graph, values, problem, problem.imu, state, state.inertial)
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


def test_a_gap_after_the_first_keyframe_leaves_the_covariances_known() -> None:
    imu = _imu()
    kept = (imu.times < 0.1) | (imu.times > 0.35)
    torn = Imu(imu.times[kept], imu.acceleration[kept], imu.angular_velocity[kept], True, None)
    problem, state = _inertial_problem(torn, np.array([0.0, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0]))
    ahead = np.random.default_rng(1).uniform([-1, -1, 2], [1, 1, 4], (60, 3))
    points = ahead @ state.R_map_camera[3].T + state.positions[3]
    assert state.inertial is not None
    state = replace(state, camera=CAMERA, inertial=replace(state.inertial, clock_s=0.0))
    adjusted = adjust(replace(problem, observations=_sightings(state.T_map_camera, points, 0.3)), state, 8)
    assert np.isfinite(adjusted.covariances([0, 4, 7])).all()


def test_readings_are_summed_as_trapezoids_between_any_two_times() -> None:
    """A force that grows, felt by an IMU that does not turn: known to the last digit, between readings too."""
    times = np.arange(0, 2, 0.01)
    jerk, start = np.array([0.3, -0.2, 0.1]), np.array([0.1, 0.2, 9.8])
    imu = Imu(times, start + times[:, None] * jerk, np.zeros((len(times), 3)), True, None)
    still = gtsam.imuBias.ConstantBias()
    a, b = 0.1234, 1.5678
    summed = preintegrated(imu, a, b, imu_noise(1), still, 0.1)
    assert summed.deltaTij() == pytest.approx(b - a)
    np.testing.assert_allclose(summed.deltaVij(), start * (b - a) + jerk * (b**2 - a**2) / 2, atol=1e-9)
    speed_at_a = start * a + jerk * a**2 / 2
    way = start * (b**2 - a**2) / 2 + jerk * (b**3 - a**3) / 6 - speed_at_a * (b - a)
    np.testing.assert_allclose(summed.deltaPij(), way, atol=1e-5)
    whole = preintegrated(imu, 0.5, 1.0, imu_noise(1), still, 0.1)
    assert whole.deltaTij() == pytest.approx(0.5)
    turning = Imu(times, imu.acceleration, np.tile([0.0, 0.0, 0.7], (len(times), 1)), True, None)
    turned = preintegrated(turning, a, b, imu_noise(1), still, 0.1)
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


def _posed(T: FloatArray) -> gtsam.Values:
    values = gtsam.Values()
    for k, one in enumerate(T):
        values.insert(C(k), gtsam.Pose3(one))
    return values


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


def test_the_distance_of_a_sighting_is_in_pixels() -> None:
    observations, state = _two_rays(4.0)
    moved = replace(observations, pixels=np.add(observations.pixels, [[3.0, 4.0], [0.0, 0.0], [-6.0, 8.0]]))
    np.testing.assert_allclose(residuals_px(moved, state, np.array([[0.0, 0, 10]])), [5, 0, 10], atol=1e-9)
    np.testing.assert_allclose(
        residuals_px(moved, replace(state, points=np.array([[0.0, 0, 10]]))), [5, 0, 10], atol=1e-9
    )
    assert np.isinf(residuals_px(moved, state, np.array([[0.0, 0, -10]]))).all()


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
