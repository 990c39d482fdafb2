"""The places that features were seen from: where they are, how far around them a density is to be valid, how many."""

from __future__ import annotations

import numpy as np
import pytest

from rholoc.density import localities as places
from rholoc.density.density import Sightings
from rholoc.density.localities import Places, gather_places

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
