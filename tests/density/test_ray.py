"""The ray density: information sums add, and the gradient is the density's own."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rholoc.density.ray import (
    landmarks_from_information,
    observation_information,
    range_information,
    ray_density,
    squared_ray_distance,
)

seeds = st.integers(0, 2**31)


def _rays(seed: int, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A landmark (3,), positions (N, 3) around it and exact bearings (N, 3)."""
    rng = np.random.default_rng(seed)
    landmark = rng.uniform(-2, 2, 3)
    positions = landmark + rng.normal(size=(count, 3)) * 2
    offset = landmark - positions
    return landmark, positions, offset / np.linalg.norm(offset, axis=1, keepdims=True)


@given(seed=seeds, count=st.integers(3, 12))
def test_exact_rays_meet_in_the_landmark(seed: int, count: int) -> None:
    landmark, positions, bearings = _rays(seed, count)
    information, eta = observation_information(bearings, positions, np.ones(count))
    found, _ = landmarks_from_information(information.sum(axis=0)[None], eta.sum(axis=0)[None])
    np.testing.assert_allclose(found[0], landmark, atol=1e-5)


@given(seed=seeds)
def test_sums_do_not_depend_on_the_order(seed: int) -> None:
    _, positions, bearings = _rays(seed, 9)
    bearings = bearings + np.random.default_rng(seed).normal(size=(9, 3)) * 1e-3
    bearings /= np.linalg.norm(bearings, axis=1, keepdims=True)
    information, eta = observation_information(bearings, positions, np.linspace(1, 2, 9))
    at_once, _ = landmarks_from_information(information.sum(axis=0)[None], eta.sum(axis=0)[None])
    later = information[4:].sum(axis=0) + information[:4].sum(axis=0)
    in_parts, _ = landmarks_from_information(later[None], (eta[4:].sum(axis=0) + eta[:4].sum(axis=0))[None])
    np.testing.assert_allclose(in_parts, at_once, atol=1e-6)


def test_parallel_rays_determine_nothing() -> None:
    bearings = np.repeat([[0.0, 0.0, 1.0]], 3, axis=0)
    information, eta = observation_information(bearings, np.eye(3), np.ones(3))
    found, covariance = landmarks_from_information(information.sum(axis=0)[None], eta.sum(axis=0)[None])
    assert np.isnan(found).all()
    assert np.isnan(covariance).all()


@given(seed=seeds)
def test_one_ray_whose_length_is_known_ends_in_its_landmark(seed: int) -> None:
    landmark, positions, bearings = _rays(seed, 2)
    ranges_m = np.array([np.linalg.norm(landmark - positions[0]), np.nan])
    across, eta = observation_information(bearings, positions, np.full(2, 100.0))
    along, eta_along = range_information(bearings, positions, ranges_m, np.full(2, 25.0))
    found, covariance = landmarks_from_information(across + along, eta + eta_along)
    np.testing.assert_allclose(found[0], landmark, atol=1e-6)
    assert bearings[0] @ covariance[0] @ bearings[0] == pytest.approx(1 / 25)
    assert np.isnan(found[1]).all()  # nothing is known along the other


@given(seed=seeds)
def test_the_squared_distance_is_that_of_the_perpendicular(seed: int) -> None:
    rng = np.random.default_rng(seed)
    m, x, b = rng.normal(size=3), rng.normal(size=3), rng.normal(size=3)
    b /= np.linalg.norm(b)
    assert squared_ray_distance(m, b, x) == pytest.approx(np.linalg.norm(np.cross(b, m - x)) ** 2, abs=1e-9)


def test_landmarks_behind_the_camera_have_no_density() -> None:
    assert ray_density(np.array([0, 0, -1.0]), np.array([0, 0, 1.0]), np.zeros(3), np.array(1.0)) == 0
