"""The tensor density: where it peaks, what it is worth elsewhere, its gradients."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from rholoc.density.polynomial import monomials, tensor_powers
from rholoc.density.tensor import (
    HEADING_LIMIT_RAD,
    TARGET_RADIUS,
    TensorDensities,
    coefficient_columns,
    fit_tensors,
    kept_powers,
    local_frames,
)
from rholoc.geometry import FloatArray, Pose, pose_matrix, rotation_from_heading
from rholoc_lab.paper.equations import polynomial_values, variables_at

_FOCAL_PX = 525


@cache
def _some(count: int, degree: int, seed: int = 0) -> TensorDensities:
    """Densities of landmarks 1–5 m from their places, in any direction, also straight up and down."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(count, 3))
    directions[:2] = [[0, 0, 1], [0, 0, -1]]
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    distances = rng.uniform(1, 5, count)
    places = rng.uniform(-3, 3, (count, 3))
    fitted = fit_tensors(places + distances[:, None] * directions, places, 0.3 * distances, degree)
    return replace(fitted, coefficients=fitted.coefficients.astype(np.float64))  # for differences to have a limit


def _visible_pose(rng: np.random.Generator, densities: TensorDensities, k: int) -> tuple[FloatArray, FloatArray]:
    """A pose (4, 4) of any roll in the domain of density ``k``, and where it sees the landmark, (2,) on z = 1."""
    while True:
        position = densities.places[k] + densities.radii[k] * rng.uniform(-1, 1, 3) / np.sqrt(3)
        heading = densities.directions[k] + rng.uniform(-0.9, 0.9, 3)
        pose = Pose.from_heading(position, heading / np.linalg.norm(heading), rng.uniform(-3, 3))
        x, y, z = (densities.landmarks[k] - position) @ pose.R_map_camera
        inside = z > 0.1 and abs(x / z) < 0.61 and abs(y / z) < 0.46
        if inside and densities.valid_at(position, pose.heading, np.array([k]))[0]:
            return pose.T_map_camera, np.array([x / z, y / z])


def _peak_offsets_px(degree: int, count: int = 40, poses: int = 6) -> FloatArray:
    rng = np.random.default_rng(5)
    densities = _some(count, degree)
    offsets = []
    for k in range(count):
        for _ in range(poses):
            T_map_camera, pixel = _visible_pose(rng, densities, k)
            offsets.append(densities.take(np.array([k])).at(pixel[None], T_map_camera).offset[0])
    return _FOCAL_PX * np.linalg.norm(offsets, axis=1)


@pytest.mark.parametrize(("degree", "median_px", "p90_px"), [(2, 0.4, 0.8), (3, 0.05, 0.15)])
def test_it_peaks_where_the_landmark_is_seen(degree: int, median_px: float, p90_px: float):
    offsets_px = _peak_offsets_px(degree)
    assert np.median(offsets_px) < median_px
    assert np.percentile(offsets_px, 90) < p90_px


def test_degree_1_has_no_peak():
    densities = _some(10, 1)
    rng = np.random.default_rng(2)
    T_map_camera, pixel = _visible_pose(rng, densities, 3)
    peaks = densities.at(np.tile(pixel, (10, 1)), T_map_camera)
    assert not peaks.peaked.any()
    assert np.isfinite(peaks.value).all()


def test_it_falls_from_where_the_feature_is_seen_to_where_it_is_not():
    densities = _some(12, 2)
    rng = np.random.default_rng(3)
    for k in range(12):
        T_map_camera, pixel = _visible_pose(rng, densities, k)
        one = densities.take(np.array([k]))
        around = pixel + TARGET_RADIUS * np.array([[0, 0], [0.5, 0], [0, -0.5], [1.6, 0], [0, 1.6]])
        value = [one.at(p[None], T_map_camera).value[0] for p in around]
        assert value[0] == pytest.approx(1, abs=0.06)
        assert 0.3 < min(value[1:3]) <= max(value[1:3]) < 0.97
        assert max(value[3:]) < 0.4


def test_it_is_equation_3_with_all_its_coefficients():
    densities = _some(6, 2)
    T_map_camera, pixel = _visible_pose(np.random.default_rng(4), densities, 2)
    plane = np.tile(pixel, (6, 1))
    s = variables_at(densities, plane, T_map_camera)
    full = densities.all_coefficients(np.arange(6)).astype(np.float64)
    value = [polynomial_values(full[k : k + 1], 2, s[k])[0][0] for k in range(6)]
    np.testing.assert_allclose(densities.take(np.arange(6)).at(plane, T_map_camera).value, value, atol=1e-9)


def test_it_is_the_least_squares_fit_of_all_6561_coefficients():
    """Equation (5) solved without leaving any coefficient out, on other samples, with the target written out."""
    one = _some(3, 2).take(np.array([2]))
    line = np.array([-1, -0.4, 0.4, 1])
    rng = np.random.default_rng(6)
    headings = one.directions[0] + rng.uniform(-0.6, 0.6, (150, 3))
    headings /= np.linalg.norm(headings, axis=1)[:, None]
    positions = one.places[0] + one.radii[0] * np.stack(np.meshgrid(line, line, line, indexing="ij"), -1).reshape(-1, 3)
    u, v = 0.5 * np.stack(np.meshgrid(line, line, indexing="ij"), -1).reshape(-1, 2).T
    target = np.empty((len(u), len(positions), len(headings)))
    variables = np.empty((len(headings), 3))
    for h, heading in enumerate(headings):
        local = one.R_local_map[0] @ heading
        upright = one.R_local_map[0].T @ rotation_from_heading(local)
        x, y, z = ((one.landmarks[0] - positions) @ upright).T
        metres = (z * u[:, None] - x) ** 2 + (z * v[:, None] - y) ** 2
        target[:, :, h] = 1 - metres / (one.distances[0] * TARGET_RADIUS) ** 2
        variables[h] = variables_at(one, np.zeros((1, 2)), pose_matrix(upright, one.places[0]))[0, 5:]
    plane = np.linalg.pinv(monomials(tensor_powers(2, 2), np.column_stack([u, v])))
    place = np.linalg.pinv(monomials(tensor_powers(3, 2), (positions - one.places[0]) / one.radii[0]))
    heading_ = np.linalg.pinv(monomials(tensor_powers(3, 2), variables), rcond=1e-6)
    full = np.einsum("ua,xb,hc,abc->uxh", plane, place, heading_, target, optimize=True).ravel()
    left_out = np.setdiff1d(np.arange(6561), coefficient_columns(2))
    assert np.abs(full[left_out]).max() < 1e-9 * np.abs(full).max()
    T_map_camera, pixel = _visible_pose(rng, one, 0)
    s = variables_at(one, pixel[None], T_map_camera)[0]
    value, gradient = polynomial_values(full[None], 2, s)
    ours, our_gradient = polynomial_values(one.all_coefficients(np.array([0])).astype(np.float64), 2, s)
    assert ours[0] == pytest.approx(value[0], abs=0.05)
    np.testing.assert_allclose(our_gradient[0, :5], gradient[0, :5], atol=0.1 * np.abs(gradient).max())


def test_the_cameras_roll_changes_nothing():
    densities = _some(5, 2)
    T_map_camera, pixel = _visible_pose(np.random.default_rng(7), densities, 3)
    one = densities.take(np.array([3]))
    values = []
    for roll in (0.0, 0.7, -2.0):
        c, s = np.cos(roll), np.sin(roll)
        turned = T_map_camera.copy()
        turned[:3, :3] = T_map_camera[:3, :3] @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        seen = np.array([[c, s], [-s, c]]) @ pixel
        values.append(one.at(seen[None] + 0.0, turned).value[0])
    np.testing.assert_allclose(values, values[0], atol=1e-9)


@settings(max_examples=15)
@given(seed=st.integers(0, 10_000), degree=st.sampled_from([2, 3]))
def test_gradients_by_the_cameras_motion_are_limits_of_differences(seed: int, degree: int):
    rng = np.random.default_rng(seed)
    densities = _some(6, degree)
    k = int(rng.integers(len(densities)))
    T_map_camera, pixel = _visible_pose(rng, densities, k)
    one, plane = densities.take(np.array([k])), pixel[None] + rng.uniform(-0.05, 0.05, (1, 2))
    here, step = one.at(plane, T_map_camera), 1e-5

    def after(motion: FloatArray) -> FloatArray:
        R = Rotation.from_rotvec(motion[3:]).as_matrix() @ T_map_camera[:3, :3]
        there = one.at(plane, pose_matrix(R, T_map_camera[:3, 3] + motion[:3]))
        return np.r_[there.value[0], there.offset[0], there.drop[0]]

    differences = np.array([after(step * unit) - after(-step * unit) for unit in np.eye(6)]).T / (2 * step)
    analytic = np.vstack([here.gradient[0], here.offset_jacobian[0], here.drop_gradient[0]])
    np.testing.assert_allclose(analytic, differences, atol=1e-5 * max(1, np.abs(differences).max()))


def test_it_is_valid_only_around_its_place_and_direction():
    densities = _some(4, 2)
    row = np.array([3])
    place, direction, radius = densities.places[3], densities.directions[3], densities.radii[3]
    aside = np.cross(direction, [0.3, 0.5, 0.8])
    aside /= np.linalg.norm(aside)
    turned = np.cos(HEADING_LIMIT_RAD + 0.01) * direction + np.sin(HEADING_LIMIT_RAD + 0.01) * aside
    assert densities.valid_at(place + 0.99 * radius * aside, direction, row)[0]
    assert not densities.valid_at(place + 1.01 * radius * aside, direction, row)[0]
    assert not densities.valid_at(place, turned, row)[0]


def test_local_frames_are_upright_and_turn_the_direction_to_the_diagonal():
    rng = np.random.default_rng(8)
    directions = rng.normal(size=(20, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    directions[0] = [0, 0, 1]
    frames = local_frames(directions)
    np.testing.assert_allclose(np.linalg.det(frames), 1, atol=1e-9)
    turned = np.einsum("tij,tj->ti", frames, directions)
    np.testing.assert_allclose(turned, np.tile([np.sqrt(0.5), np.sqrt(0.5), 0], (20, 1)), atol=1e-9)
    right = rotation_from_heading(directions[3])[:, 0]
    np.testing.assert_allclose(frames[3] @ right, [np.sqrt(0.5), -np.sqrt(0.5), 0], atol=1e-9)


def test_sizes_follow_the_degree():
    for degree, kept in ((1, 4 * 7 * 8), (2, 6 * 10 * 27), (3, 6 * 10 * 64)):
        assert np.prod([len(powers) for powers in kept_powers(degree)]) == kept
        assert _some(3, degree).all_coefficients(np.arange(3)).shape == (3, (degree + 1) ** 8)
