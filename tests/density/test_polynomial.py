"""Equation (3) and its gradient, equation (4)."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rholoc.density.polynomial import monomial_derivatives, monomials, polynomial_values, tensor_powers
from rholoc.density.ray import ray_coefficients, ray_density, squared_ray_distance


def test_coefficients_stand_in_the_order_of_table_5():
    powers = tensor_powers(8, 2)
    assert powers.shape == (6561, 8)
    assert powers[0].tolist() == [0] * 8
    assert powers[1].tolist() == [0] * 7 + [1]
    assert powers[-1].tolist() == [2] * 8
    assert [tuple(row) for row in powers] == list(itertools.product(range(3), repeat=8))


def test_a_known_polynomial_has_its_known_value_and_gradient():
    coefficients = np.zeros((2, 9))
    coefficients[0, [0, 5]] = 3, 2  # 3 + 2 s0 s1²
    coefficients[1, [6, 8]] = 1, -1  # s0² − s0² s1²
    values, gradients = polynomial_values(coefficients, 2, np.array([2.0, 5.0]))
    np.testing.assert_allclose(values, [103, -96])
    np.testing.assert_allclose(gradients, [[50, 40], [4 - 100, -40]])


@given(degree=st.integers(1, 3), variables=st.integers(1, 4), seed=st.integers(0, 10_000))
def test_the_gradient_is_the_limit_of_differences(degree: int, variables: int, seed: int):
    rng = np.random.default_rng(seed)
    coefficients = rng.normal(size=(3, (degree + 1) ** variables))
    s, step = rng.uniform(-1, 1, variables), 1e-5
    _, gradients = polynomial_values(coefficients, degree, s)
    for d, unit in enumerate(np.eye(variables)):
        after, _ = polynomial_values(coefficients, degree, s + step * unit)
        before, _ = polynomial_values(coefficients, degree, s - step * unit)
        np.testing.assert_allclose(gradients[:, d], (after - before) / (2 * step), atol=1e-6, rtol=1e-6)


def test_many_points_at_once_are_the_points_one_by_one():
    rng = np.random.default_rng(1)
    powers, points = tensor_powers(3, 2), rng.normal(size=(4, 5, 3))
    together = monomial_derivatives(powers, points)
    np.testing.assert_allclose(together[2, 3], monomial_derivatives(powers, points[2, 3]))
    np.testing.assert_allclose(together[..., 0], monomials(powers, points))


@pytest.mark.parametrize("seed", range(3))
def test_the_ray_density_is_the_polynomial_of_its_coefficients(seed: int):
    rng = np.random.default_rng(seed)
    landmarks, tolerances = rng.normal(size=(40, 3)) * 2, rng.uniform(0.5, 3, 40)
    bearing, position = rng.normal(size=3), rng.normal(size=3)
    bearing /= np.linalg.norm(bearing)
    values, gradients = polynomial_values(ray_coefficients(landmarks, tolerances), 2, np.r_[bearing, position])
    unclipped = 1 - squared_ray_distance(landmarks, bearing, position) / tolerances**2
    np.testing.assert_allclose(values, unclipped, atol=1e-9, rtol=0)
    ahead = (landmarks - position) @ bearing > 0
    clipped = ray_density(landmarks, bearing, position, tolerances)
    np.testing.assert_allclose(clipped, np.where(ahead, np.maximum(values, 0), 0), atol=1e-9)
    along = (landmarks - position) @ bearing
    across = (landmarks - position) - along[:, None] * bearing
    np.testing.assert_allclose(gradients[:, 3:], 2 * across / tolerances[:, None] ** 2, atol=1e-9)
