"""How uncertain a map's views are, through all that is done with maps."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rholoc.geometry import Similarity
from rholoc.mapping.build.self_report import map_statistics
from rholoc.mapping.build.view_covariance import (
    expected_error,
    storable_covariances,
    uncertainty_in,
)
from rholoc.mapping.edit.sources import forget_recording, join, without_source
from rholoc.mapping.learn.merging import merge_maps
from rholoc.maps import Map


def spreads(count: int, sigma_m: float, seed: int = 0) -> np.ndarray:
    factors = np.random.default_rng(seed).normal(0, sigma_m / np.sqrt(6), (count, 6, 6))
    return storable_covariances(factors @ factors.transpose(0, 2, 1))


@pytest.fixture(scope="module")
def first(point_room: Any) -> Map:
    map_ = point_room.map_of(point_room.walk(30), "first")
    return replace(map_, views=replace(map_.views, covariances=spreads(30, 0.01)))


@pytest.fixture(scope="module")
def second(point_room: Any) -> Map:
    return point_room.map_of(point_room.walk(20, sideways_m=0.1)[:10], "second")


def test_views_keep_theirs_when_maps_are_joined_and_parted(first: Map, second: Map) -> None:
    joined = join(first, second, np.full(len(second), -1))
    np.testing.assert_array_equal(joined.views.covariances[:30], first.views.covariances)
    assert np.isnan(joined.views.covariances[30:]).all()
    parted = without_source(joined, 1)
    np.testing.assert_array_equal(parted.views.covariances, first.views.covariances)
    assert without_source(join(second, second, np.arange(len(second))), 1).views.covariances is None


@pytest.fixture(scope="module")
def uncertain(second: Map) -> Map:
    return replace(second, views=replace(second.views, covariances=spreads(10, 0.02, seed=1)))


@pytest.fixture(scope="module")
def merged(first: Map, uncertain: Map) -> Map:
    return merge_maps(first, uncertain)


def test_a_merged_map_is_as_uncertain_as_both(first: Map, uncertain: Map, merged: Map) -> None:
    np.testing.assert_array_equal(merged.views.covariances[:30], first.views.covariances)
    own = uncertain.views.expected_errors_m
    assert (merged.views.expected_errors_m[30:] > own).all()
    assert (merged.views.expected_errors_m[30:] < np.hypot(own, 2 * first.views.expected_errors_m.max())).all()
    assert merged.info.report.expected_error.rms_m > first.views.expected_errors_m.mean()


@pytest.mark.slow
def test_what_is_forgotten_is_not_expected_to_err(first: Map, second: Map, merged: Map) -> None:
    report = forget_recording(merged, "second").info.report
    assert len(report.expected_error.views_m) == 30
    assert forget_recording(merge_maps(first, second), "first").info.report.expected_error is None


@pytest.mark.slow
def test_in_the_frame_of_a_map_that_does_not_know_nothing_is_known(first: Map, second: Map) -> None:
    assert np.isnan(merge_maps(second, first).views.expected_errors_m).all()


def test_covariances_turn_with_the_frame() -> None:
    turn = Similarity(2.0, Rotation.from_euler("z", 90, degrees=True).as_matrix(), np.array([1.0, 2.0, 3.0]))
    moved = turn.covariances(np.diag([1.0, 4.0, 9.0, 0.1, 0.2, 0.3])[None])[0]
    np.testing.assert_allclose(np.diag(moved), [16, 4, 36, 0.2, 0.1, 0.3], rtol=1e-6)


def test_a_pose_found_in_a_map_knows_no_more_than_the_map(first: Map) -> None:
    here = first.views.T_map_camera[10]
    found = uncertainty_in(first, here[None], residual_m=0.005)[0]
    assert np.trace(found[:3, :3]) > first.views.expected_errors_m[5:15].min() ** 2
    assert np.isnan(uncertainty_in(replace(first, views=replace(first.views, covariances=None)), here[None])).all()


def test_the_report_has_the_expected_error_of_the_whole_and_over_the_walk(first: Map) -> None:
    spread = first.views.covariances.copy()
    spread[4] = np.nan
    section = expected_error(replace(first, views=replace(first.views, covariances=spread)))
    errors_m = np.delete(first.views.expected_errors_m, 4)
    assert section.rms_m == pytest.approx(np.sqrt(np.mean(errors_m**2)))
    assert section.worst_m == pytest.approx(errors_m.max())
    assert (
        section.worst_time_s
        == first.views.times[np.argmax(np.where(np.arange(30) == 4, 0, first.views.expected_errors_m))]
    )
    assert section.views_m[4] is None
    assert map_statistics(first).expected_error.views_m[0] == pytest.approx(first.views.expected_errors_m[0], abs=1e-5)
    assert map_statistics(replace(first, views=replace(first.views, covariances=None))).expected_error is None
