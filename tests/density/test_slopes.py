"""How densities change with a small motion of the camera: against finite differences, for every form of them."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rholoc.density import DensityKind
from rholoc.density.density import Densities, LocalDensities, Sightings
from rholoc.density.evidence import Evidence
from rholoc.density.observed import fit_observed
from rholoc.density.ray import RayDensities, RayOffsets, ray_densities, squared_tolerances
from rholoc.density.tensor import fit_tensors
from rholoc.geometry import FloatArray, Pose
from rholoc_lab.paper.equations import squared_ray_distance

_FOCAL_PX = 500.0
_TOLERANCE_PX = 40.0
_POSE = Pose.from_heading(
    np.array([0.1, -0.2, 1.5]), np.array([0.9, 0.3, -0.1]) / np.linalg.norm([0.9, 0.3, -0.1]), 0.2
)
_LANDMARKS = np.array([[3.0, 0.4, 1.4], [3.0, 1.2, 0.8], [2.0, 1.5, 1.7], [4.0, 0.5, 0.7]])
_COUNT = len(_LANDMARKS)


def _evidence(off_px: float, sigma_m: float) -> Evidence:
    """Every landmark, seen so many pixels beside where it is, each in another direction."""
    rays = (_LANDMARKS - _POSE.position) @ _POSE.R_map_camera
    turns = np.arange(_COUNT) * 2.0
    plane = rays[:, :2] / rays[:, 2:] + off_px / _FOCAL_PX * np.column_stack([np.cos(turns), np.sin(turns)])
    rays = np.column_stack([plane, np.ones(_COUNT)])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    covariances = np.tile(sigma_m**2 * np.eye(3), (_COUNT, 1, 1))
    return Evidence.of(np.arange(_COUNT), rays, _LANDMARKS, covariances, np.full(_COUNT, 0.5), _FOCAL_PX)


def _densities(kind: DensityKind) -> Densities:
    place = np.array([0.0, 0.0, 1.5])
    match kind:
        case DensityKind.RAY:
            return RayDensities()
        case DensityKind.TENSOR:
            return fit_tensors(_LANDMARKS, np.tile(place, (_COUNT, 1)), np.full(_COUNT, 0.8), 2)
        case DensityKind.OBSERVED:
            positions = np.random.default_rng(0).uniform(-0.5, 0.5, (40, 3)) + place
            seen_from = np.tile(positions, (_COUNT, 1))
            features = np.repeat(np.arange(_COUNT), 40)
            away = _LANDMARKS[features] - seen_from
            bearings = away / np.linalg.norm(away, axis=1, keepdims=True)
            return fit_observed(Sightings(_LANDMARKS, features, seen_from, bearings), 2)


def _moved(T_map_camera: FloatArray, motion: FloatArray) -> FloatArray:
    """A pose (4, 4) after a motion (6,): position in metres, rotation in radians from the left."""
    T = T_map_camera.copy()
    T[:3, 3] += motion[:3]
    T[:3, :3] = Rotation.from_rotvec(motion[3:]).as_matrix() @ T[:3, :3]
    return T


def _slopes(of: Callable[[FloatArray], FloatArray], step: float) -> FloatArray:
    """Differences (..., 6) of a function of the pose."""
    T = _POSE.T_map_camera
    return np.stack([(of(_moved(T, step * axis)) - of(_moved(T, -step * axis))) / (2 * step) for axis in np.eye(6)], -1)


def test_offsets_from_rays_and_their_slopes() -> None:
    evidence = _evidence(15.0, 0.01)
    offsets = RayOffsets.of(evidence, _POSE.T_map_camera)
    bearings = evidence.rays @ _POSE.R_map_camera.T
    aside_m2 = squared_ray_distance(_LANDMARKS, bearings, _POSE.position)
    np.testing.assert_allclose(np.sum(offsets.offset**2, axis=1), aside_m2, rtol=1e-9)
    expected = _slopes(lambda T: RayOffsets.of(evidence, T).offset, 1e-6)
    np.testing.assert_allclose(offsets.jacobian, expected, atol=1e-6)


def test_a_tolerance_is_an_angle_at_the_landmark_and_its_own_uncertainty() -> None:
    evidence = _evidence(0.0, 0.05)
    away_m = np.linalg.norm(_LANDMARKS - _POSE.position, axis=1)
    expected = (_TOLERANCE_PX / _FOCAL_PX * away_m) ** 2 + 0.05**2
    np.testing.assert_allclose(squared_tolerances(evidence, _POSE.T_map_camera, _TOLERANCE_PX), expected, rtol=1e-9)
    np.testing.assert_allclose(evidence.variances, 0.05**2)


@pytest.mark.parametrize("kind", list(DensityKind))
def test_densities_fall_as_their_slopes_say(kind: DensityKind) -> None:
    evidence = _evidence(12.0, 0.01)
    local = _densities(kind).near(evidence, _POSE.T_map_camera, _TOLERANCE_PX)
    assert local.matches.tolist() == list(range(_COUNT))
    at = local.at(_POSE.T_map_camera, _TOLERANCE_PX)
    assert at.inside.tolist() == list(range(_COUNT))
    np.testing.assert_allclose(at.density, 1 - (12.0 / _TOLERANCE_PX) ** 2, atol=0.05)
    expected = -_slopes(lambda T: _of_held_tolerances(local, evidence, T), 1e-3)
    np.testing.assert_allclose(at.gradient, expected, rtol=0.03, atol=0.06)


def _of_held_tolerances(local: LocalDensities, evidence: Evidence, T_map_camera: FloatArray) -> FloatArray:
    """ρ (M,) at a pose with the tolerances of the first one: the slopes hold them."""
    here, there = (_tolerances(evidence, T) for T in (_POSE.T_map_camera, T_map_camera))
    return 1 - (1 - local.at(T_map_camera, _TOLERANCE_PX).density) * there / here


def _tolerances(evidence: Evidence, T_map_camera: FloatArray) -> FloatArray:
    away_m = np.linalg.norm(_LANDMARKS - T_map_camera[:3, 3], axis=1)
    return (_TOLERANCE_PX / _FOCAL_PX * away_m) ** 2 + evidence.variances


@pytest.mark.parametrize("kind", list(DensityKind))
def test_the_roots_are_of_the_curvature_at_the_peak(kind: DensityKind) -> None:
    """At its peak d is δᵀ Lᵀ L δ for a small motion δ, which Gauss–Newton's steps rely on."""
    evidence = _evidence(0.0, 0.01)
    local = _densities(kind).near(evidence, _POSE.T_map_camera, _TOLERANCE_PX)
    at = local.at(_POSE.T_map_camera, _TOLERANCE_PX)
    rng = np.random.default_rng(1)
    for _ in range(4):
        motion = 0.01 * rng.normal(size=6)
        there, back = (local.at(_moved(_POSE.T_map_camera, one), _TOLERANCE_PX).density for one in (motion, -motion))
        expected = np.sum((at.roots @ motion) ** 2, axis=1)
        np.testing.assert_allclose(at.density - (there + back) / 2, expected, rtol=0.1, atol=1e-4)


def test_many_poses_at_once_have_the_densities_of_each() -> None:
    evidence = _evidence(12.0, 0.01)
    local = RayDensities().near(evidence, _POSE.T_map_camera, _TOLERANCE_PX)
    poses = np.stack([_moved(_POSE.T_map_camera, 0.05 * axis) for axis in np.eye(6)])
    each = [local.at(T, _TOLERANCE_PX).density for T in poses]
    np.testing.assert_allclose(ray_densities(evidence, poses, _TOLERANCE_PX), each, rtol=1e-9)


def test_a_landmark_may_be_farther_off_along_the_axis_that_it_is_known_worse_along() -> None:
    evidence = _evidence(0.0, 0.01)
    sigma_m = np.array([0.2, 0.01])  # along the two axes across the ray
    axes = _POSE.T_map_camera[:3, :3] @ evidence.across
    spread = np.einsum("mir,r,mjr->mij", axes, sigma_m**2, axes)
    away = np.einsum("mi,mi->m", evidence.rays, (evidence.landmarks - _POSE.position) @ _POSE.R_map_camera)
    for axis, offset_m in ((0, 0.1), (1, 0.02)):
        shifted = replace(evidence, covariances=spread, landmarks=evidence.landmarks + offset_m * axes[:, :, axis])
        found = RayDensities().near(shifted, _POSE.T_map_camera, _TOLERANCE_PX).at(_POSE.T_map_camera, _TOLERANCE_PX)
        allowed = (_TOLERANCE_PX * away / evidence.focal_px) ** 2 + sigma_m[axis] ** 2
        np.testing.assert_allclose(found.density, np.maximum(1 - offset_m**2 / allowed, 0), atol=1e-9)


def test_outside_the_tolerance_there_is_no_density_and_no_slope() -> None:
    evidence = _evidence(2 * _TOLERANCE_PX, 1e-6)
    at = RayDensities().near(evidence, _POSE.T_map_camera, _TOLERANCE_PX).at(_POSE.T_map_camera, _TOLERANCE_PX)
    assert not at.density.any()
    assert len(at.inside) == len(at.gradient) == len(at.roots) == 0


def test_only_rays_peak_exactly_at_their_landmark() -> None:
    assert [_densities(kind).has_exact_peaks for kind in DensityKind] == [
        kind is DensityKind.RAY for kind in DensityKind
    ]


def test_another_focal_length_keeps_the_pixels() -> None:
    evidence = _evidence(12.0, 0.01)
    longer = evidence.refocused(1.25)
    assert longer.focal_px == 1.25 * _FOCAL_PX
    pixels = [e.focal_px * e.rays[:, :2] / e.rays[:, 2:] for e in (evidence, longer)]
    np.testing.assert_allclose(pixels[1], pixels[0], rtol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(longer.rays, axis=1), 1)
    np.testing.assert_allclose(np.einsum("mi,mij->mj", longer.rays, longer.across), 0, atol=1e-12)
    some = longer.take(np.array([2, 0]))
    np.testing.assert_array_equal(some.features, [2, 0])
    np.testing.assert_array_equal(some.rays, longer.rays[[2, 0]])
    np.testing.assert_array_equal(some.landmarks, _LANDMARKS[[2, 0]])
    assert (len(some), some.focal_px) == (2, longer.focal_px)
