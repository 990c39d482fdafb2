"""``observed`` densities that go on from where they stand are those that were fitted to everything at once."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rholoc.density import DensityKind, ObservedDensities
from rholoc.density.localities import Places
from rholoc.density.observed import RIDGE, observation_coefficients
from rholoc.density.recursive_least_squares import batch_fit
from rholoc.errors import InvalidInput
from rholoc.localization import Dof, Localizer, Query
from rholoc.mapping.build.density_fitting import fit_densities, ray_form, sightings_of
from rholoc.mapping.build.recursive_densities import check_forgetting, with_learned_densities
from rholoc.maps import Map, validate_map

_FIRST_VIEWS = 16


@pytest.fixture(scope="module")
def after(point_room: Any) -> Map:
    map_: Map = point_room.map_of(point_room.walk(150)[:24], "walk")
    return map_


@pytest.fixture(scope="module")
def before(after: Map) -> Map:
    """The map as its first views alone make it."""
    count = int(after.view_offsets[_FIRST_VIEWS])
    views = after.views.take(np.arange(_FIRST_VIEWS))
    first = replace(after, views=views, observations=after.observations.take(np.arange(count)))
    return fit_densities(first, DensityKind.OBSERVED)


@pytest.mark.parametrize("forgetting", [1.0, 0.9])
def test_one_at_a_time_is_one_batch_of_all(before: Map, after: Map, forgetting: float) -> None:
    learned = with_learned_densities(before, ray_form(after), forgetting).densities
    known = before.densities
    assert isinstance(known, ObservedDensities)
    assert isinstance(learned, ObservedDensities)
    sightings, members = sightings_of(after), Places.of(sightings_of(before)).members
    assert sightings.bearings is not None
    compared = 0
    for t in np.flatnonzero(known.counts >= 5)[:40].tolist():
        (row,) = np.flatnonzero((learned.features == known.features[t]) & (learned.places == known.places[t]).all(1))
        more = int(learned.counts[row] - known.counts[t])
        later = np.flatnonzero(sightings.features == known.features[t])
        later = later[later >= len(before.observations)]
        if more != len(later):
            continue  # some of them were of another place
        rows = np.concatenate([members[t], later])
        phi = known.position_monomials(t, sightings.positions[rows])
        values = observation_coefficients(sightings.bearings[rows] @ known.R_local_map[t].T, 2)
        weight = np.where(np.arange(len(rows)) < len(members[t]), forgetting**more, 1.0)
        weight[len(members[t]) :] = forgetting ** np.arange(more - 1, -1, -1.0)
        root = np.sqrt(weight)[:, None]
        batch = batch_fit(root * phi, root * values, RIDGE * forgetting**more)
        u, x, h = learned.coefficients.shape[1:]
        expected = batch.coefficients.reshape(x, u, h).transpose(1, 0, 2)
        assert np.allclose(learned.coefficients[row], expected, atol=2e-3 * np.abs(expected).max())
        compared += more > 0
    assert compared > 5


def test_the_map_is_whole_and_localizes(before: Map, after: Map, point_room: Any) -> None:
    map_ = with_learned_densities(before, ray_form(after), 0.98)
    validate_map(map_)
    assert set(np.unique(map_.densities.arrays()["features"]).tolist()) == set(range(len(map_)))
    pose = point_room.walk(150)[20]
    answer = Localizer(map_).localize(Query(point_room.see(pose, 5), point_room.camera, Dof.FREE))
    assert answer.pose is not None
    assert np.linalg.norm(answer.pose.position - pose.position) < 0.05


@pytest.mark.parametrize("forgetting", [0.0, -1.0, 1.5, float("nan")])
def test_an_impossible_forgetting_is_refused(before: Map, forgetting: float) -> None:
    with pytest.raises(InvalidInput, match="not a valid forgetting factor"):
        check_forgetting(before, forgetting)


def test_other_densities_do_not_forget(after: Map) -> None:
    with pytest.raises(InvalidInput, match="'ray'"):
        check_forgetting(after, 0.9)
