"""The ascent: its gradient is the density's, and it climbs to the truth."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from rholoc.density import Evidence, RayDensities
from rholoc.geometry import Pose, pose_matrix
from rholoc.localization import Dof
from rholoc.localization.pose.ascent import ascend, covariance_at, gains, refined
from rholoc_lab.paper.equations import gradient

FOCAL_PX = 500.0
RAY = RayDensities()
TRUTH = Pose.from_heading(np.array([0.3, -0.2, 1.5]), np.array([0.9, 0.3, -0.1])).T_map_camera


def _evidence(seed: int, count: int = 80, false: int = 0, noise_px: float = 0.0) -> Evidence:
    rng = np.random.default_rng(seed)
    rays = np.column_stack([rng.uniform(-0.6, 0.6, (count, 2)), np.ones(count)])
    points = rays * rng.uniform(1.5, 5, (count, 1))
    rays = rays + np.column_stack([rng.normal(size=(count, 2)) * noise_px / FOCAL_PX, np.zeros(count)])
    landmarks = points @ TRUTH[:3, :3].T + TRUTH[:3, 3]
    landmarks[:false] += rng.normal(size=(false, 3))
    covariances = np.tile(np.eye(3) * 0.002**2, (count, 1, 1))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    return Evidence.of(np.arange(count), rays, landmarks, covariances, np.full(count, 0.5), FOCAL_PX)


def _moved(step: np.ndarray) -> np.ndarray:
    return pose_matrix(Rotation.from_rotvec(step[3:]).as_matrix() @ TRUTH[:3, :3], TRUTH[:3, 3] + step[:3])


@given(seed=st.integers(0, 10_000))
def test_the_gradient_agrees_with_finite_differences(seed: int) -> None:
    evidence = _evidence(seed, count=12)
    here = np.random.default_rng(seed).normal(size=6) * 0.004
    T, step, tolerance_px = _moved(here), 1e-6, 40.0
    found = gradient(RAY, evidence, T, tolerance_px)

    def value(delta: np.ndarray) -> float:
        R = Rotation.from_rotvec(delta[3:]).as_matrix() @ T[:3, :3]
        there = pose_matrix(R, T[:3, 3] + delta[:3])
        return float(_fixed_tolerance_value(evidence, there, T, tolerance_px))

    numeric = [(value(step * axis) - value(-step * axis)) / (2 * step) for axis in np.eye(6)]
    np.testing.assert_allclose(found, numeric, rtol=1e-3, atol=1e-2)


def _fixed_tolerance_value(evidence: Evidence, T: np.ndarray, T_reference: np.ndarray, tolerance_px: float) -> float:
    """Σ log(ε + ρ) at ``T`` with the tolerances that belong to ``T_reference``, written out independently."""
    total = 0.0
    for ray, landmark, covariance, epsilon in zip(
        evidence.rays, evidence.landmarks, evidence.covariances, evidence.epsilon, strict=True
    ):
        offset = T[:3, :3].T @ (landmark - T[:3, 3])
        squared = offset @ offset - (offset @ ray) ** 2
        along = ray @ (T_reference[:3, :3].T @ (landmark - T_reference[:3, 3]))
        tolerance = (tolerance_px / FOCAL_PX * along) ** 2 + np.trace(covariance) / 3
        total += np.log(epsilon + max(0.0, 1 - squared / tolerance))
    return total


def test_its_last_steps_suit_errors_with_long_tails() -> None:
    """Student's t with two degrees of freedom, 0.5 px: about how far real detections are from where they should be."""
    apart_m: dict[str, list[float]] = {"climbed": [], "refined": []}
    for seed in range(30):
        exact = _evidence(seed, count=150)
        aside = np.random.default_rng(seed).standard_t(2, (150, 2)) * 0.5 / FOCAL_PX
        rays = exact.rays + np.einsum("mir,mr->mi", exact.across, aside)
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        evidence = Evidence.of(exact.features, rays, exact.landmarks, exact.covariances, np.full(150, 0.5), FOCAL_PX)
        climbed = ascend(RAY, evidence, TRUTH, (8.0, 4.0), Dof.FREE).T_map_camera
        for name, T in (("climbed", climbed), ("refined", refined(evidence, climbed, Dof.FREE))):
            apart_m[name].append(float(np.linalg.norm((T - TRUTH)[:3, 3])))
    assert np.median(apart_m["refined"]) < 0.8 * np.median(apart_m["climbed"])


@pytest.mark.parametrize("dof", list(Dof))
def test_it_climbs_to_the_truth_through_false_matches(dof: Dof) -> None:
    evidence = _evidence(1, false=40)
    start = _moved(np.array([0.05, -0.04, 0.03, 0.02, -0.02, 0.03]))
    optimum = ascend(RAY, evidence, start, (40.0, 20.0, 8.0, 4.0, 2.0), dof)
    np.testing.assert_allclose(optimum.T_map_camera, TRUTH, atol=1e-4)
    assert (optimum.density[40:] > 0.9).all()


def test_a_roll_that_the_matches_do_not_show_is_none() -> None:
    # one landmark straight ahead says nothing about roll: the prior about zero decides
    evidence = _evidence(2, count=400)
    ahead = evidence.take(np.argsort(-evidence.rays[:, 2])[:1])
    start = Pose(TRUTH)
    rolled = Pose.from_heading(start.position, start.heading, 0.1).T_map_camera
    optimum = ascend(RAY, ahead, rolled, (400.0,), Dof.UPRIGHT, iterations=10)
    assert Pose(optimum.T_map_camera).roll == pytest.approx(0, abs=1e-3)


def test_ascending_never_lowers_the_value() -> None:
    evidence, start = _evidence(3, false=20, noise_px=1.0), _moved(np.full(6, 0.01))
    optimum = ascend(RAY, evidence, start, (10.0,), Dof.FREE, iterations=10)
    assert optimum.value >= gains(evidence, start[None], 10.0)[0]


def test_more_matches_make_the_covariance_smaller() -> None:
    few, many = _evidence(4, count=20, noise_px=1.0), _evidence(4, count=200, noise_px=1.0)
    sizes = [
        np.trace(covariance_at(evidence, ascend(RAY, evidence, TRUTH, (4.0,), Dof.FREE))) for evidence in (few, many)
    ]
    assert sizes[1] < sizes[0] / 3


def test_the_covariance_is_the_spread_of_optima_with_a_factor_of_three() -> None:
    """Detections 1 px off; the factor allows for what no single frame shows, and nothing else may change the size."""
    squared = []
    for seed in range(40):
        evidence = _evidence(seed, count=60, noise_px=1.0)
        optimum = ascend(RAY, evidence, TRUTH, (8.0, 8.0), Dof.FREE)
        R = optimum.T_map_camera[:3, :3] @ TRUTH[:3, :3].T
        error = np.r_[(optimum.T_map_camera - TRUTH)[:3, 3], Rotation.from_matrix(R).as_rotvec()]
        covariance = covariance_at(evidence, optimum)
        squared.append([_mean_square(error, covariance), _mean_square(error[:3], covariance[:3, :3])])
    assert 3**2 * np.mean(squared, axis=0).min() > 1 / 3
    assert 3**2 * np.mean(squared, axis=0).max() < 3


def _mean_square(error: np.ndarray, covariance: np.ndarray) -> float:
    return float(error @ np.linalg.solve(covariance, error) / len(error))
