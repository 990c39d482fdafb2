"""The ray density: information sums add, and the gradient is the density's own."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rholoc.density import localities as places
from rholoc.density.density import Sightings
from rholoc.density.localities import Places, gather_places
from rholoc.density.polynomial import monomial_derivatives, monomials, tensor_powers
from rholoc.density.presence import Presence, group_sums
from rholoc.density.ray import (
    landmarks_from_information,
    observation_information,
    range_information,
    ray_coefficients,
)
from rholoc_lab.paper.equations import polynomial_values, ray_density, squared_ray_distance

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


LANDMARKS = np.array([[0.0, 0.0, 0.0], [5.0, 0.0, 0.0]])
POSITIONS = np.array([[0.0, -2.0, 0.0], [0.5, -2.0, 0.0], [5.0, 3.0, 0.0]])
PRESENCE = Presence.of(LANDMARKS, POSITIONS, np.array([0, 0, 1]))


def test_where_it_was_seen_from_is_allowed() -> None:
    assert PRESENCE.allows(LANDMARKS, POSITIONS[0])[0]
    assert PRESENCE.allows(LANDMARKS, POSITIONS[1])[0]
    assert PRESENCE.allows(LANDMARKS, POSITIONS[2])[1]


def test_behind_and_too_far_are_not() -> None:
    assert not PRESENCE.allows(LANDMARKS, np.array([0.0, 2.0, 0.0]))[0]
    assert not PRESENCE.allows(LANDMARKS, np.array([0.0, -20.0, 0.0]))[0]
    assert not PRESENCE.allows(LANDMARKS, np.array([0.0, -0.2, 0.0]))[0]


def test_group_sums_add_by_group() -> None:
    sums = group_sums(np.array([0, 2, 0]), np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]), 4)
    np.testing.assert_array_equal(sums, [[6, 8], [0, 0], [3, 4], [0, 0]])


def test_near_and_far_views_count_alike() -> None:
    presence = Presence.of(np.zeros((1, 3)), np.array([[0.0, -1.0, 0.0], [4.0, 0.0, 0.0]]), np.array([0, 0]))
    np.testing.assert_allclose(presence.direction, [[np.sqrt(0.5), -np.sqrt(0.5), 0.0]])
    assert (presence.nearest[0], presence.farthest[0]) == (1.0, 4.0)


def test_it_is_looked_for_from_a_little_beyond_where_it_was_seen() -> None:
    presence = Presence.of(np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0]] * 2), np.array([0, 0]))

    def allowed(angle_deg: float, distance: float) -> bool:
        angle = np.deg2rad(angle_deg)
        return bool(presence.allows(np.zeros((1, 3)), distance * np.array([np.cos(angle), 0.0, np.sin(angle)]))[0])

    assert allowed(34.0, 1.0)
    assert not allowed(36.0, 1.0)
    assert allowed(0.0, 1.99)
    assert not allowed(0.0, 2.01)
    assert allowed(0.0, 0.51)
    assert not allowed(0.0, 0.49)
    taken = presence.take(np.array([0]))
    assert (taken.nearest[0], taken.farthest[0], taken.cosine_limit[0]) == (1.0, 1.0, presence.cosine_limit[0])


AHEAD = np.array([1.0, 0.0, 0.0])


def around(angle_deg, distance=1.0):
    """A position from which a landmark at the origin is seen, so many degrees to the side."""
    angle = np.deg2rad(angle_deg)
    return distance * np.array([np.cos(angle), np.sin(angle), 0.0])


@pytest.mark.parametrize(
    ("other", "same"),
    [(around(19), True), (around(21), False), (1.69 * AHEAD, True), (1.71 * AHEAD, False), (AHEAD / 1.71, False)],
)
def test_a_place_is_of_one_side_and_one_distance(other, same):
    found = gather_places(np.zeros(3), np.array([AHEAD, AHEAD, other, other]))
    assert [len(members) for members in found] == ([4] if same else [2, 2])


def test_a_feature_has_at_most_four_places_and_each_but_its_first_two_views():
    seen_from = np.array([around(30 * k) for k in range(6) for _ in range(2)])
    assert len(gather_places(np.zeros(3), seen_from)) == 4
    assert [len(m) for m in gather_places(np.zeros(3), seen_from[:3])] == [2]


@pytest.mark.parametrize(
    ("spread_deg", "radius"),
    [(5, 0.6), (40, 0.95)],  # shares of the distance: never less, never more
)
def test_a_density_is_valid_a_good_way_around_its_place_but_not_beyond_its_landmark(monkeypatch, spread_deg, radius):
    monkeypatch.setattr(places, "_SAME_PLACE_RAD", np.pi)
    positions = np.array([around(spread_deg, 2.0), around(-spread_deg, 2.0)])
    found = Places.of(Sightings(np.zeros((1, 3)), np.zeros(2, np.int64), positions))
    middle = positions.mean(axis=0)
    np.testing.assert_allclose(found.positions, [middle], atol=1e-6)
    assert found.radii[0] == pytest.approx(radius * np.linalg.norm(middle), abs=1e-5)


def test_its_views_lie_within_the_radius_with_a_margin(monkeypatch):
    monkeypatch.setattr(places, "_SAME_PLACE_RAD", np.pi)
    positions = np.array([around(35, 2.0), around(-35, 2.0)])
    found = Places.of(Sightings(np.zeros((1, 3)), np.zeros(2, np.int64), positions))
    assert found.radii[0] == pytest.approx(1.2 * 2 * np.sin(np.deg2rad(35)), abs=1e-5)


def test_where_there_are_too_many_those_of_few_views_go_but_no_features_first(monkeypatch):
    monkeypatch.setattr(places, "_MAX_DENSITIES", 4)
    first = [around(0)] * 5 + [around(90)] * 2 + [around(180)] * 4
    second = [around(0)] * 2 + [around(90)] * 3
    sightings = Sightings(np.zeros((3, 3)), np.repeat([0, 2, 1], [11, 5, 1]), np.array([*first, *second, AHEAD]))
    found = Places.of(sightings)
    assert found.features.tolist() == [0, 0, 1, 2]
    np.testing.assert_allclose(found.positions, [around(0), around(180), AHEAD, around(90)], atol=1e-6)
    np.testing.assert_array_equal(found.positions, found.positions.astype(np.float32))
    np.testing.assert_array_equal(found.radii, found.radii.astype(np.float32))


@pytest.mark.parametrize(
    ("distances", "radius"),
    [
        ([0.6, 1.0, 1.69], 1.2 * (1.69 - 3.29 / 3)),  # by the furthest view, with a margin
        ([0.6] * 4 + [1.0, 1.69], 0.95 * 5.09 / 6),  # short of the landmark
        ([0.9, 1.0, 1.1], 0.6),  # and never less than this share of the distance
    ],
)
def test_a_density_reaches_to_its_furthest_view(distances, radius):
    seen_from = np.array(distances)[:, None] * AHEAD
    found = Places.of(Sightings(np.zeros((1, 3)), np.zeros(len(distances), np.int64), seen_from))
    np.testing.assert_allclose(found.positions, [np.mean(distances) * AHEAD], rtol=1e-6)
    np.testing.assert_allclose(found.radii, [radius], rtol=1e-6)
    assert [members.tolist() for members in found.members] == [list(range(len(distances)))]
