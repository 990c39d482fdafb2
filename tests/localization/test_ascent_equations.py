"""The ascent's equations against ones that are written out independently, and against differences."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rholoc.density import Evidence, RayDensities
from rholoc.geometry import FloatArray, Pose, pose_distances
from rholoc.localization import Dof
from rholoc.localization.pose.ascent import (
    Step,
    ascend,
    ascend_with_focal,
    climb,
    covariance_at,
    freed_focal,
    gains,
    information_at,
    moved,
    normal_equations,
    optimum_at,
    refined,
    refinement_equations,
    roll_prior,
    upright,
)
from rholoc_lab.paper.equations import gradient

FOCAL_PX = 480.0
ROLL_SIGMA_RAD = np.deg2rad(1.5)
RAY = RayDensities()
HERE = Pose.from_heading(np.array([1.3, -0.7, 1.6]), np.array([0.8, 0.6, 0.0]), 0.04).T_map_camera


def scene(seed: int, count: int = 40, noise_px: float = 0.0, scale: float = 1.0) -> Evidence:
    """What a camera at ``HERE`` sees through a lens of FOCAL_PX, said to be ``scale`` times as long."""
    rng = np.random.default_rng(seed)
    plane = rng.uniform(-0.6, 0.6, (count, 2))
    local = np.column_stack([plane, np.ones(count)]) * rng.uniform(1.5, 6, (count, 1))
    seen = plane + rng.normal(size=(count, 2)) * noise_px / FOCAL_PX
    rays = np.column_stack([seen, np.full(count, scale)])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    spread = rng.normal(size=(count, 3, 3)) * 0.004
    landmarks = local @ HERE[:3, :3].T + HERE[:3, 3]
    chances = rng.uniform(0.1, 0.9, count)
    return Evidence.of(np.arange(count), rays, landmarks, spread @ spread.transpose(0, 2, 1), chances, FOCAL_PX * scale)


def offsets(evidence: Evidence, T: FloatArray) -> FloatArray:
    """(M, 2) of landmarks from their rays, metres."""
    local = (evidence.landmarks - T[:3, 3]) @ T[:3, :3]
    return np.einsum("mir,mi->mr", evidence.across, local)


def derivative(function: Callable[[FloatArray], FloatArray], size: int, step: float = 1e-6) -> FloatArray:
    """(..., size) by central differences at zero."""
    return np.stack([(function(step * a) - function(-step * a)) / (2 * step) for a in np.eye(size)], axis=-1)


def curvature_of(function: Callable[[FloatArray], float], size: int, step: float) -> FloatArray:
    """(size, size) the second derivatives at zero."""
    axes = step * np.eye(size)
    return np.array(
        [[function(a + b) - function(a - b) - function(b - a) + function(-a - b) for b in axes] for a in axes]
    ) / (4 * step**2)


def value(evidence: Evidence, T: FloatArray, allowed: FloatArray, dof: Dof) -> float:
    """Σ log(ε + ρ) with tolerances (M,) or spreads (M, 2, 2) that are held, and the log of the roll's prior."""
    spread = allowed if allowed.ndim == 3 else allowed[:, None, None] * np.eye(2)
    density = np.maximum(1 - squares(evidence, T, spread), 0)
    return float(np.log(evidence.epsilon + density).sum()) + log_prior(T, dof)


def refinement_value(evidence: Evidence, T: FloatArray, spread: FloatArray, dof: Dof) -> float:
    """Log-likelihood by Cauchy's distribution in two dimensions, weighted by the matches' chances."""
    chances = 0.1 / (0.1 + evidence.epsilon)
    return float(-1.5 * (chances * np.log1p(squares(evidence, T, spread))).sum()) + log_prior(T, dof)


def squares(evidence: Evidence, T: FloatArray, spread: FloatArray) -> FloatArray:
    """(M,) squared offsets, whitened by spreads (M, 2, 2)."""
    e = offsets(evidence, T)
    return np.einsum("mi,mij,mj->m", e, np.linalg.inv(spread), e)


def log_prior(T: FloatArray, dof: Dof) -> float:
    """A Gaussian's logarithm of the roll; for ``AUTO`` that of Cauchy's distribution to the power of a half."""
    squared = (Pose(T).roll / ROLL_SIGMA_RAD) ** 2
    return float({Dof.FREE: 0.0, Dof.UPRIGHT: -squared / 2, Dof.AUTO: -np.log1p(squared) / 2}[dof])


def spreads(evidence: Evidence, T: FloatArray, tolerance_px: float) -> FloatArray:
    """(M, 2, 2) of offsets: the pixel tolerance, and the landmark's covariance across the ray."""
    along = np.einsum("mi,mi->m", (evidence.landmarks - T[:3, 3]) @ T[:3, :3], evidence.rays)
    across = np.array([T[:3, :3] @ basis for basis in evidence.across])
    own = np.array([A.T @ C @ A for A, C in zip(across, evidence.covariances, strict=True)])
    return (tolerance_px * along / evidence.focal_px)[:, None, None] ** 2 * np.eye(2) + own


def tolerances(evidence: Evidence, T: FloatArray, tolerance_px: float) -> FloatArray:
    along = np.einsum("mi,mi->m", (evidence.landmarks - T[:3, 3]) @ T[:3, :3], evidence.rays)
    return (tolerance_px * along / evidence.focal_px) ** 2 + np.trace(evidence.covariances, axis1=1, axis2=2) / 3


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-9, 1e-8, 1e-4, 0.01, 1.0, 3.1])
def test_a_motion_is_a_rotation_from_the_left_and_a_shift(angle: float) -> None:
    axis = np.array([0.48, -0.6, 0.64])
    there = moved(HERE, np.r_[0.1, -0.2, 0.3, angle * axis])
    np.testing.assert_allclose(there[:3, :3], Rotation.from_rotvec(angle * axis).as_matrix() @ HERE[:3, :3], atol=1e-14)
    np.testing.assert_allclose(there[:3, 3], HERE[:3, 3] + (0.1, -0.2, 0.3))
    np.testing.assert_array_equal(there[3], [0, 0, 0, 1])


@pytest.mark.parametrize("roll_deg", [-20.0, -0.5, 0.0, 1.0, 4.0])
@pytest.mark.parametrize("dof", list(Dof))
def test_the_rolls_prior_is_a_distributions_slope(dof: Dof, roll_deg: float) -> None:
    T = Pose.from_heading(np.array([3.0, -2.0, 1.0]), np.array([0.3, 0.9, 0.2]), np.deg2rad(roll_deg)).T_map_camera
    pull, stiffness = roll_prior(T, dof)
    about_axis = np.r_[np.zeros(3), T[:3, 2]]
    slope = derivative(lambda a: np.asarray(log_prior(moved(T, a[0] * about_axis), dof)), 1)[0]
    np.testing.assert_allclose(pull, slope * about_axis, atol=1e-4)
    if roll_deg == 0.0:
        bent = curvature_of(lambda a: log_prior(moved(T, a[0] * about_axis), dof), 1, 1e-5)[0, 0]
        np.testing.assert_allclose(stiffness, -bent * np.outer(about_axis, about_axis), rtol=1e-3)
    np.testing.assert_allclose(pull * roll_deg, -np.deg2rad(roll_deg) * roll_deg * stiffness @ about_axis, atol=1e-9)


@pytest.mark.parametrize("last", [False, True])
@pytest.mark.parametrize("dof", list(Dof))
def test_normal_equations_are_slope_and_curvature_of_the_value(dof: Dof, last: bool) -> None:
    tolerance_px = 1.0 if last else 12.0
    for noise_px in (0.0, 3.0):
        evidence = scene(1, noise_px=noise_px)
        T = HERE if noise_px else upright(HERE)
        if noise_px == 0.0:  # at the very peak, where Gauss and Newton agree
            evidence = replace(
                evidence, landmarks=(evidence.landmarks - HERE[:3, 3]) @ HERE[:3, :3] @ T[:3, :3].T + T[:3, 3]
            )
        allowed = spreads(evidence, T, tolerance_px)
        if last:
            slope, curvature = refinement_equations(evidence, T, dof)
        else:
            slope, curvature = normal_equations(RAY.near(evidence, T, 12.0), evidence.epsilon, T, 12.0, dof)

        def at(step: FloatArray, T: FloatArray = T, e: Evidence = evidence, r2: FloatArray = allowed) -> float:
            return (refinement_value if last else value)(e, moved(T, step), r2, dof)

        expected = derivative(lambda step: np.asarray(at(step)), 6)
        np.testing.assert_allclose(slope, expected, rtol=1e-4, atol=1e-5 * np.abs(curvature).max() ** 0.5)
        if noise_px == 0.0:
            bent = -curvature_of(at, 6, 1e-5)
            np.testing.assert_allclose(curvature, bent, rtol=1e-3, atol=1e-4 * np.abs(bent).max())
    np.testing.assert_array_equal(
        gradient(RAY, evidence, T, 12.0),
        normal_equations(RAY.near(evidence, T, 12.0), evidence.epsilon, T, 12.0, Dof.FREE)[0],
    )


def derivative_at_peak(evidence: Evidence) -> FloatArray:
    """(M, 2) of the offsets by ln f, where they are none."""
    local = (evidence.landmarks - HERE[:3, 3]) @ HERE[:3, :3]

    def aside(step: FloatArray) -> FloatArray:
        rays = evidence.refocused(float(np.exp(step[0]))).rays
        across = local - np.einsum("mi,mi->m", local, rays)[:, None] * rays
        return np.einsum("mir,mi->mr", evidence.across, across)

    return derivative(aside, 1)[..., 0]


def written_out_information(evidence: Evidence, T: FloatArray, noise_px: float, focal_free: bool) -> FloatArray:
    away = np.linalg.norm(evidence.landmarks - T[:3, 3], axis=1)
    variances = (noise_px * away / evidence.focal_px) ** 2 + np.trace(evidence.covariances, axis1=1, axis2=2) / 3
    J = derivative(lambda step: offsets(evidence, moved(T, step)), 6)
    if focal_free:
        J = np.concatenate([J, derivative_at_peak(evidence)[..., None]], axis=2)
    return sum(j.T @ j / (9 * variance) for j, variance in zip(J, variances, strict=True))


@pytest.mark.parametrize("focal_free", [False, True])
@pytest.mark.parametrize("noise_px", [0.0, 0.1, 2.0])
def test_information_is_that_of_independent_detections_a_ninth(focal_free: bool, noise_px: float) -> None:
    evidence = scene(5, 60, noise_px)
    optimum = optimum_at(RAY, evidence, HERE, 200.0)
    away = np.linalg.norm(evidence.landmarks - HERE[:3, 3], axis=1)
    off_px = FOCAL_PX * np.linalg.norm(offsets(evidence, HERE), axis=1) / away
    measured_px = max(np.median(off_px) / 1.177, 0.3)
    assert measured_px == pytest.approx(max(noise_px, 0.3), rel=0.4)
    information = information_at(evidence, optimum, focal_free)
    expected = written_out_information(evidence, HERE, measured_px, focal_free)
    tolerance = 1e-4 if noise_px < 1 else 0.01  # the focal length's slope is that of the peak
    np.testing.assert_allclose(information, expected, atol=tolerance * np.abs(expected).max())
    covariance = np.linalg.inv(expected + 1e-6 * np.eye(len(expected)))[:6, :6]
    np.testing.assert_allclose(
        covariance_at(evidence, optimum, focal_free), covariance, atol=10 * tolerance * np.abs(covariance).max()
    )


def test_only_matches_that_agree_inform_and_without_any_nothing_is_known() -> None:
    evidence = scene(6, 20)
    optimum = optimum_at(RAY, evidence, HERE, 50.0)
    some = np.arange(0, 20, 2)
    partly = replace(optimum, density=np.where(np.isin(np.arange(20), some), 1e-3, 0.0))
    alone = optimum_at(RAY, evidence.take(some), HERE, 50.0)
    np.testing.assert_allclose(information_at(evidence, partly), information_at(evidence.take(some), alone), rtol=1e-9)
    none = replace(optimum, density=np.zeros(20))
    np.testing.assert_array_equal(information_at(evidence, none), np.zeros((6, 6)))
    np.testing.assert_array_equal(information_at(evidence, none, focal_free=True), np.zeros((7, 7)))
    np.testing.assert_allclose(covariance_at(evidence, none), 1e6 * np.eye(6))


def lengths(steps: list[Step]) -> FloatArray:
    """The greatest component of each step, metres or radians."""
    greatest = []
    for a, b in pairwise(steps):
        turn = Rotation.from_matrix(b.T_map_camera[:3, :3] @ a.T_map_camera[:3, :3].T).as_rotvec()
        greatest.append(np.abs(np.r_[(b.T_map_camera - a.T_map_camera)[:3, 3], turn]).max())
    return np.array(greatest)


def test_a_tolerance_ends_when_steps_are_below_a_millimetre_and_the_last_below_ten_micrometres() -> None:
    tolerances_px = (60.0, 30.0, 6.0)
    between = 0
    for seed in range(12):
        evidence = scene(seed, 25, noise_px=4.0)
        start = moved(HERE, np.random.default_rng(seed).normal(0, 0.03, 6))
        steps = list(climb(RAY, evidence, start, tolerances_px, Dof.FREE, 60))
        np.testing.assert_array_equal(steps[0].T_map_camera, start)
        assert steps[0].tolerance_px == tolerances_px[0]
        long, of = lengths(steps), np.array([step.tolerance_px for step in steps[1:]])
        for tolerance_px in tolerances_px:
            mine, settled = long[of == tolerance_px], 1e-5 if tolerance_px == tolerances_px[-1] else 1e-3
            assert (mine[:-1] >= settled).all()
            assert mine[-1] < settled or len(mine) == 60
            between += ((mine > settled) & (mine < 8 * settled)).sum()
    assert between > 20  # so that another limit would show


def test_three_steps_at_each_tolerance_and_the_optimum_where_they_end() -> None:
    evidence, start = scene(7, noise_px=4.0), moved(HERE, np.full(6, 0.06))
    steps = list(climb(RAY, evidence, start, (80.0, 10.0), Dof.FREE))
    assert [step.tolerance_px for step in steps] == [80.0] * 4 + [10.0] * 3
    optimum = ascend(RAY, evidence, start, (80.0, 10.0), Dof.FREE)
    np.testing.assert_array_equal(optimum.T_map_camera, steps[-1].T_map_camera)
    np.testing.assert_array_equal(optimum.density, optimum_at(RAY, evidence, optimum.T_map_camera, 10.0).density)
    assert optimum.value == pytest.approx(gains(evidence, optimum.T_map_camera[None], 10.0)[0], rel=0.02)
    assert optimum.value == pytest.approx(np.log((evidence.epsilon + optimum.density) / evidence.epsilon).sum())
    for dof in (Dof.UPRIGHT, Dof.AUTO):
        first = next(climb(RAY, evidence, start, (10.0,), dof))
        np.testing.assert_allclose(first.T_map_camera, upright(start) if dof is Dof.UPRIGHT else start)


def test_upright_is_the_same_place_and_heading() -> None:
    straight = Pose(upright(HERE))
    np.testing.assert_allclose(straight.position, HERE[:3, 3])
    np.testing.assert_allclose(straight.heading, HERE[:3, 2])
    assert straight.roll == pytest.approx(0, abs=1e-12)


def test_the_last_steps_end_where_nothing_is_gained_and_leave_out_what_is_behind() -> None:
    evidence = scene(8, 60, noise_px=3.0)
    start = moved(HERE, np.full(6, 2e-3))
    end = refined(evidence, start, Dof.FREE, iterations=40)
    pull, curvature = refinement_equations(evidence, end, Dof.FREE)
    assert np.abs(np.linalg.solve(curvature, pull)).max() < 2e-5
    behind = evidence.landmarks[:5] - 2 * (evidence.landmarks[:5] - HERE[:3, 3])
    some = replace(evidence, landmarks=np.r_[behind, evidence.landmarks[5:]])
    np.testing.assert_allclose(
        refined(some, start, Dof.FREE), refined(evidence.take(np.arange(5, 60)), start, Dof.FREE), atol=1e-12
    )


def test_a_landmark_counts_by_how_exactly_it_is_known_in_each_direction() -> None:
    """Landmarks 5 % off along the rays of the view that saw them: where this is known, it does not move the pose."""
    evidence = scene(13, 60)
    seen_from = HERE[:3, 3] + HERE[:3, :3] @ [0.4, 0.1, 0.0]
    along = evidence.landmarks - seen_from
    axes = along / np.linalg.norm(along, axis=1, keepdims=True)
    deep = 0.04 * along[:, :, None] * along[:, None, :] + 1e-7 * np.eye(3)
    wrong = evidence.landmarks + np.random.default_rng(13).normal(0, 0.05, (60, 1)) * along
    known, blurred = (
        replace(evidence, landmarks=wrong, covariances=one)
        for one in (deep, np.trace(deep, axis1=1, axis2=2)[:, None, None] / 3 * np.eye(3))
    )
    off_m = [pose_distances(refined(one, HERE, Dof.FREE), HERE)[0] for one in (known, blurred)]
    assert np.abs(np.einsum("mi,mi->m", wrong - evidence.landmarks, axes)).mean() > 0.1
    assert off_m[0] < 0.2 * off_m[1]


@pytest.mark.parametrize("scale", [0.995, 1.004])
def test_what_freeing_the_focal_length_would_change_is_what_it_does_change(scale: float) -> None:
    evidence = scene(9, 200, noise_px=0.3, scale=scale)
    held = ascend(RAY, evidence, HERE, (20.0,), Dof.FREE, 60)
    moved_m, gain = freed_focal(evidence, held.T_map_camera, 20.0, Dof.FREE)
    free, found, _ = ascend_with_focal(evidence, held.T_map_camera, (20.0,), Dof.FREE, 60)
    assert found == pytest.approx(1 / scale, abs=1e-3)
    assert moved_m == pytest.approx(pose_distances(free.T_map_camera, held.T_map_camera)[0], rel=0.1)
    assert gain == pytest.approx(free.value - held.value, rel=0.1)
    aside_m, _ = freed_focal(evidence, moved(held.T_map_camera, np.full(6, 1e-3)), 20.0, Dof.FREE)
    assert aside_m == pytest.approx(moved_m, rel=0.2)  # what the pose is off by itself does not count


def test_the_focal_lengths_sigma_is_the_curvatures() -> None:
    evidence = scene(10, 80)
    optimum, scale, sigma = ascend_with_focal(evidence, HERE, (10.0,), Dof.FREE)
    assert scale == pytest.approx(1.0, abs=1e-6)
    allowed = tolerances(evidence, HERE, 10.0)

    def at(step: FloatArray) -> float:
        return value(evidence.refocused(float(np.exp(step[6]))), moved(HERE, step[:6]), allowed, Dof.FREE)

    assert sigma == pytest.approx(np.sqrt(np.linalg.inv(-curvature_of(at, 7, 1e-5))[6, 6]), rel=0.01)
    np.testing.assert_allclose(optimum.T_map_camera, HERE, atol=1e-6)


def test_a_focal_length_changes_by_a_tenth_at_a_time_and_sixteenfold_at_most() -> None:
    for scale, way in ((1 / 6, 1), (6.0, -1)):
        evidence = scene(11, 60, scale=scale)
        for steps in (1, 3):
            _, found, _ = ascend_with_focal(evidence, HERE, (800.0 * scale,), Dof.FREE, steps)
            assert np.log(found) == pytest.approx(0.1 * way * steps)
        _, found, _ = ascend_with_focal(evidence, HERE, (800.0 * scale,), Dof.FREE)
        assert np.log(found) == pytest.approx(0.6 * way)
        _, found, _ = ascend_with_focal(evidence, HERE, (800.0 * scale,), Dof.FREE, 40)
        assert found == 4.0**way
