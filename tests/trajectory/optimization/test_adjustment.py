"""The joint least-squares problem: its own factor's derivatives, and synthetic walks given back."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import C, E, S, V, X
from scene import CAMERA, arc, cloud, in_pixels
from scipy.spatial.transform import Rotation

from rholoc.geometry import FloatArray, pose_matrix, umeyama
from rholoc.trajectory.optimization import adjustment, imu_factors
from rholoc.trajectory.optimization.adjustment import Adjusted, adjust
from rholoc.trajectory.optimization.points import residuals_px, triangulate
from rholoc.trajectory.optimization.problem import GUESSED, CameraSigmas, Fix, Problem, State
from rholoc.trajectory.visual.tracks import Observations

_CAMERAS, _POINTS = 14, 70


def _random_pose(rng: np.random.Generator) -> gtsam.Pose3:
    return gtsam.Pose3(pose_matrix(Rotation.random(rng=rng).as_matrix(), rng.uniform(-1, 1, 3)))


@pytest.mark.parametrize("seed", range(3))
def test_the_derivatives_of_the_mounting_are_those_of_its_error(seed: int) -> None:
    """Against central differences, at an error as small as it is near the solution."""
    rng = np.random.default_rng(seed)
    rate, velocity = rng.normal(0, 1, 3), rng.normal(0, 1, 3)
    T_map_imu, T_imu_camera = _random_pose(rng), _random_pose(rng)
    clock_s = 0.004
    twist = np.concatenate([rate, T_map_imu.rotation().matrix().T @ velocity])
    T_map_camera = T_map_imu.compose(gtsam.Pose3.Expmap(twist * clock_s)).compose(T_imu_camera)
    values = gtsam.Values()
    values.insert(C(0), T_map_camera.retract(rng.normal(0, 1e-4, 6)))
    values.insert(X(0), T_map_imu)
    values.insert(V(0), velocity)
    values.insert(E(0), T_imu_camera)
    values.insert(S(0), np.array([clock_s]))
    factor = imu_factors.tie_factor(0, rate, gtsam.noiseModel.Unit.Create(6))
    blocks = factor.linearize(values).jacobian()[0]
    keys = [(C(0), 6), (X(0), 6), (V(0), 3), (E(0), 6), (S(0), 1)]
    column = 0
    for key, size in keys:
        numeric = np.zeros((6, size))
        for i in range(size):
            ends = []
            for step in (1e-5, -1e-5):
                delta = gtsam.VectorValues()
                delta.insert(key, step * np.eye(size)[i])
                for other, other_size in keys:
                    if other != key:
                        delta.insert(other, np.zeros(other_size))
                ends.append(factor.unwhitenedError(values.retract(delta)))
            numeric[:, i] = (ends[0] - ends[1]) / 2e-5
        np.testing.assert_allclose(blocks[:, column : column + size], numeric, atol=1e-3)
        column += size


def _sightings(T: FloatArray, points: FloatArray, noise_px: float, seed: int) -> Observations:
    rng = np.random.default_rng(seed)
    keyframes, tracks = (grid.ravel() for grid in np.meshgrid(np.arange(len(T)), np.arange(len(points)), indexing="ij"))
    pixels = np.concatenate([in_pixels(points, one) for one in T]) + rng.normal(0, noise_px, (len(tracks), 2))
    return Observations(keyframes, tracks, pixels)


def _disturbed(T: FloatArray, seed: int) -> FloatArray:
    rng = np.random.default_rng(seed)
    turns = Rotation.from_rotvec(rng.normal(0, 0.004, (len(T), 3))).as_matrix()
    return pose_matrix(T[:, :3, :3] @ turns, T[:, :3, 3] + rng.normal(0, 0.02, (len(T), 3)))


def _solved(seed: int, fixes: tuple[Fix, ...] = (), iterations: int = 15) -> tuple[FloatArray, Adjusted]:
    T = arc(_CAMERAS)
    observations = _sightings(T, cloud(_POINTS), 0.5, seed)
    problem = Problem(np.arange(_CAMERAS) / 2, observations, fixes=fixes, pixel_sigma_px=0.5)
    return T, adjust(problem, State(_disturbed(T, seed), np.zeros((_POINTS, 3)), CAMERA), iterations)


def _depths(T: FloatArray, points: FloatArray, observations: Observations) -> FloatArray:
    """The true depth (N,) of each sighting."""
    seen = T[observations.keyframes]
    return np.asarray(np.einsum("ni,ni->n", points[observations.tracks] - seen[:, :3, 3], seen[:, :3, 2]))


@pytest.mark.parametrize("seed", range(3))
def test_depths_fix_the_scale(seed: int) -> None:
    """A tenth of the depths are unknown, a tenth are wrong."""
    T, points, rng = arc(_CAMERAS), cloud(_POINTS), np.random.default_rng(seed)
    observations = _sightings(T, points, 0.5, seed)
    depths = _depths(T, points, observations) * rng.normal(1, 0.02, len(observations))
    kind = rng.uniform(0, 1, len(observations))
    depths[kind < 0.1] = np.nan
    depths[kind > 0.9] *= 1.5
    problem = Problem(np.arange(_CAMERAS) / 2, replace(observations, depths=depths), pixel_sigma_px=0.5)
    larger = _disturbed(T, seed)
    larger[:, :3, 3] *= 1.1
    state = State(larger, np.zeros((_POINTS, 3)), CAMERA)
    without = adjust(problem, state, 15)
    assert umeyama(without.state.positions, T[:, :3, 3]).scale == pytest.approx(1 / 1.1, abs=0.02)
    with_depths = adjust(replace(problem, depth_sigma=0.02), state, 15)
    assert umeyama(with_depths.state.positions, T[:, :3, 3]).scale == pytest.approx(1.0, abs=0.006)
    np.testing.assert_array_less(np.diagonal(with_depths.covariances([_CAMERAS - 1])[0])[:3], 0.02**2)


def test_without_a_known_depth_the_scale_stays_as_it_was() -> None:
    T, points = arc(_CAMERAS), cloud(_POINTS)
    observations = _sightings(T, points, 0.5, 0)
    problem = Problem(np.arange(_CAMERAS) / 2, observations, pixel_sigma_px=0.5)
    state = State(_disturbed(T, 0), np.zeros((_POINTS, 3)), CAMERA)
    unknown = replace(observations, depths=np.full(len(observations), np.nan))
    found = adjust(replace(problem, observations=unknown, depth_sigma=0.02), state, 15)
    assert found.cost == pytest.approx(adjust(problem, state, 15).cost)


def test_points_are_where_their_rays_meet() -> None:
    T, points = arc(4), cloud(30)
    observations = _sightings(T, points, 0.0, 0)
    state = State(T, np.zeros((30, 3)), CAMERA)
    found, parallax_deg = triangulate(observations, state)
    np.testing.assert_allclose(found, points, atol=1e-3)
    assert np.all((parallax_deg > 10) & (parallax_deg < 120))
    assert residuals_px(observations, state, points).max() < 1e-2
    behind = residuals_px(observations, state, points - np.array([0.0, 0.0, 50.0]))
    assert np.isinf(behind).any()


def test_pictures_alone_give_the_walk_back_up_to_its_frame() -> None:
    T, adjusted = _solved(0)
    to_truth = umeyama(adjusted.state.positions, T[:, :3, 3])
    off_m = np.linalg.norm(to_truth.points(adjusted.state.positions) - T[:, :3, 3], axis=1)
    assert np.median(off_m) < 0.006
    assert off_m.max() < 0.015
    assert adjusted.used.mean() > 0.98


def test_waypoints_give_it_the_maps_frame() -> None:
    T = arc(_CAMERAS)
    fixes = tuple(Fix(k, tuple(T[k, :3, 3].tolist()), 0.002) for k in (0, 6, 7, 13))
    truth, adjusted = _solved(1, fixes)
    assert np.linalg.norm(adjusted.state.positions - truth[:, :3, 3], axis=1).max() < 0.008


def test_covariances_cover_the_errors() -> None:
    """Over draws, the errors in sigmas (three of position, three of rotation) are as large as they should be."""
    T = arc(_CAMERAS)
    squared = []
    for seed in range(6):
        rng = np.random.default_rng([seed, 5])
        fixes = tuple(Fix(k, tuple((T[k, :3, 3] + rng.normal(0, 0.01, 3)).tolist()), 0.01) for k in range(0, 14, 3))
        _, adjusted = _solved(seed, fixes, iterations=10)
        some = [1, 8, 12]
        for k, covariance in zip(some, adjusted.covariances(some), strict=True):
            turned = Rotation.from_matrix(adjusted.state.R_map_camera[k] @ T[k, :3, :3].T).as_rotvec()
            error = np.concatenate([adjusted.state.positions[k] - T[k, :3, 3], turned])
            squared.append(float(error @ np.linalg.solve(covariance, error)))
    assert 2.5 < np.mean(squared) < 12  # 6 expected
    assert np.mean(np.array(squared) < 12.6) >= 0.75  # 95 % expected


def test_dense_covariances_are_those_of_the_tree(monkeypatch: pytest.MonkeyPatch) -> None:
    T = arc(_CAMERAS)
    _, adjusted = _solved(0, tuple(Fix(k, tuple(T[k, :3, 3].tolist()), 0.01) for k in range(0, 14, 3)))
    dense = adjusted.covariances([1, 8, 12])
    monkeypatch.setattr(adjustment, "_MAX_DENSE", 0)
    np.testing.assert_allclose(adjusted.covariances([1, 8, 12]), dense, rtol=1e-6, atol=1e-12)


def test_an_unknown_camera_is_found_within_its_sigma() -> None:
    T = arc(_CAMERAS)
    observations = _sightings(T, cloud(_POINTS), 0.5, 3)
    guess = replace(CAMERA, fx=520.0, fy=520.0, distortion=(0.0, 0.0, 0.0, 0.0))
    problem = Problem(np.arange(_CAMERAS) / 2, observations, camera_sigmas=GUESSED, pixel_sigma_px=0.5)
    state = State(T, np.zeros((_POINTS, 3)), guess)
    for _ in range(2):
        adjusted = adjust(problem, state, 20)
        state = adjusted.state
    sigmas = adjusted.camera_sigmas()
    assert abs(state.camera.fx - CAMERA.fx) < 4 * sigmas[0]
    assert sigmas[0] < 0.03 * CAMERA.fx
    assert state.camera.fx == pytest.approx(CAMERA.fx, rel=0.02)
    assert state.camera.distortion[0] == pytest.approx(CAMERA.distortion[0], abs=max(0.03, 4 * sigmas[5]))


def test_a_prior_on_the_intrinsics_stays_where_it_is_when_all_is_adjusted_again() -> None:
    T = arc(_CAMERAS)
    observations = _sightings(T, cloud(_POINTS), 0.5, 3)
    guess = replace(CAMERA, fx=560.0, fy=560.0)
    problem = Problem(np.arange(_CAMERAS) / 2, observations, camera_sigmas=CameraSigmas(0.001, 0.01), camera_mean=guess)
    state, focal_px = State(T, np.zeros((_POINTS, 3)), guess), []
    for _ in range(5):
        state = adjust(problem, state, 20).state
        focal_px.append(state.camera.focal)
    assert focal_px[-1] == pytest.approx(focal_px[0], abs=0.3)


def test_a_wrong_sighting_moves_nothing() -> None:
    T = arc(_CAMERAS)
    observations = _sightings(T, cloud(_POINTS), 0.3, 4)
    wrong = np.random.default_rng(0).random(len(observations)) < 0.04
    moved = observations.pixels + wrong[:, None] * np.array([7.0, -6.0])
    problem = Problem(np.arange(_CAMERAS) / 2, replace(observations, pixels=moved), pixel_sigma_px=0.4)
    adjusted = adjust(problem, State(_disturbed(T, 4), np.zeros((_POINTS, 3)), CAMERA), 15)
    to_truth = umeyama(adjusted.state.positions, T[:, :3, 3])
    assert np.linalg.norm(to_truth.points(adjusted.state.positions) - T[:, :3, 3], axis=1).max() < 0.012


def test_a_keyframe_that_sees_nothing_stays_and_says_that_it_is_not_known() -> None:
    T = arc(_CAMERAS)
    observations = _sightings(T, cloud(_POINTS), 0.5, 0)
    seeing = observations.keyframes != 5
    some = Observations(observations.keyframes[seeing], observations.tracks[seeing], observations.pixels[seeing])
    problem = Problem(np.arange(_CAMERAS) / 2, some, pixel_sigma_px=0.5)
    start = State(_disturbed(T, 0), np.zeros((_POINTS, 3)), CAMERA)
    adjusted = adjust(problem, start, 8)
    np.testing.assert_allclose(adjusted.state.T_map_camera[5], start.T_map_camera[5], atol=1e-6)
    unknown, known = adjusted.covariances([5, 6])
    assert np.trace(unknown[:3, :3]) > 100 * np.trace(known[:3, :3])
