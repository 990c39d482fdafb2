"""Densities fitted by loss (5) to observations, and the same coefficients estimated one observation at a time."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from rholoc.density import ObservedDensities, Sightings
from rholoc.density.density import TARGET_RADIUS
from rholoc.density.observed import (
    RIDGE,
    fit_observed,
    observation_coefficients,
    sample_counts,
)
from rholoc.density.recursive_least_squares import RecursiveFit
from rholoc.density.tensor import Layout
from rholoc.geometry import FloatArray, Pose, Similarity, rotation_from_heading
from rholoc_lab.paper.equations import batch_fit
from rholoc_lab.paper.printed_loss import Loss, SeenPoints, fit_seen, observed_loss, seen_loss

_FOCAL_PX = 525.0
_LANDMARK = np.array([3.0, 0.4, 1.7])


def _sightings(positions: FloatArray, landmark: FloatArray = _LANDMARK) -> Sightings:
    """One feature, seen from positions (N, 3) without noise."""
    away = landmark - positions
    bearings = away / np.linalg.norm(away, axis=1, keepdims=True)
    return Sightings(landmark[None], np.zeros(len(positions), dtype=np.int64), positions, bearings)


def _around(count: int, seed: int = 3) -> FloatArray:
    """Positions (count, 3) in a box a metre wide: as no walk has them, but as a polynomial wants them."""
    return np.random.default_rng(seed).uniform(-0.5, 0.5, (count, 3)) + np.array([0.0, 0.0, 1.5])


def _peak_off_px(densities: ObservedDensities, position: FloatArray, seen: FloatArray = _LANDMARK) -> float:
    """How far a density's peak is from where an upright camera at ``position`` sees the feature, pixels."""
    heading = densities.middles[0] + np.array([0.1, -0.05, 0.1])
    pose = Pose.from_heading(position, heading / np.linalg.norm(heading))
    x, y, z = (seen - position) @ pose.R_map_camera
    peaks = densities.at(np.array([[x / z, y / z]]), pose.T_map_camera)
    return _FOCAL_PX * float(np.linalg.norm(peaks.offset[0])) if peaks.peaked[0] else np.inf


def test_it_peaks_where_the_feature_was_seen() -> None:
    densities = fit_observed(_sightings(_around(60)), 2)
    off_px = [_peak_off_px(densities, position) for position in _around(30, seed=4)]
    assert np.median(off_px) < 2.0
    assert max(off_px) < 8.0


def test_beside_the_walk_it_says_what_the_walk_said() -> None:
    line = np.column_stack([np.zeros(40), np.linspace(-0.5, 0.5, 40), np.full(40, 1.5)])
    densities = fit_observed(_sightings(line), 2)
    assert max(_peak_off_px(densities, position) for position in line) < 3.0
    assert _peak_off_px(densities, np.array([0.0, 0.0, 1.9])) > 20.0  # nothing says how it looks from 40 cm above


def test_a_constant_minimises_the_loss_as_it_is_printed() -> None:
    apart = 0.6 * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]) + np.array([0, 0, 1.5])
    counts = SeenPoints.of(_sightings(apart).bearings @ np.eye(3), apart, 2).counts(1.0)
    assert np.all(counts == counts[0])  # the observations are further apart than w is wide
    loss = Loss.of(counts, np.full(len(counts), counts[0]))
    assert loss.fitted == 0.0
    assert loss.zero > 0.0


def test_fitted_as_printed_it_has_no_peak_to_climb() -> None:
    sightings = _sightings(_around(40))
    seen, observed = fit_seen(sightings, 2), fit_observed(sightings, 2)
    everywhere = np.arange(40)
    loss = seen_loss(seen, 0, sightings.bearings[everywhere], sightings.positions)
    assert loss.fitted < 0.3 * loss.constant  # it fits what it was asked to fit …
    assert np.median([_peak_off_px(seen, position) for position in _around(20, 5)]) > 20.0  # … which is not where it is
    assert np.median([_peak_off_px(observed, position) for position in _around(20, 5)]) < 2.0


def test_the_fit_explains_what_a_constant_cannot() -> None:
    sightings = _sightings(_around(40))
    densities = fit_observed(sightings, 2)
    loss = observed_loss(densities, 0, sightings.bearings, sightings.positions)
    assert loss.fitted < 0.01 * loss.constant <= loss.zero


def test_the_gradient_is_the_slope() -> None:
    densities = fit_observed(_sightings(_around(40)), 2)
    pose = Pose.from_heading(np.array([0.1, 0.0, 1.5]), densities.middles[0])
    plane = np.array([[0.05, -0.03]])
    step = 1e-3  # coefficients have single precision
    found = densities.at(plane, pose.T_map_camera)
    for axis in range(3):
        moved = pose.T_map_camera.copy()
        moved[axis, 3] += step
        slope = (densities.at(plane, moved).value[0] - found.value[0]) / step
        assert slope == pytest.approx(found.gradient[0, axis], rel=0.03, abs=0.03)


@settings(max_examples=25)
@given(
    count=st.integers(1, 40),
    monomials=st.integers(1, 10),
    forgetting=st.sampled_from([1.0, 0.99, 0.9]),
    seed=st.integers(0, 2**16),
)
def test_one_at_a_time_is_all_at_once(count: int, monomials: int, forgetting: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    phi, values = rng.normal(size=(count, monomials)), rng.normal(size=(count, 5))
    fit = RecursiveFit.empty(monomials, 5, RIDGE)
    for one, value in zip(phi, values, strict=True):
        fit = fit.observe(one, value, forgetting)
    batch = batch_fit(phi, values, RIDGE, forgetting)
    scale = max(1.0, float(np.abs(batch.coefficients).max()))
    condition = np.linalg.cond(batch.covariance)
    assert np.allclose(fit.coefficients, batch.coefficients, atol=1e-13 * condition * scale + 1e-9 * scale)


def test_a_density_that_learns_on_is_the_one_that_learned_all_at_once() -> None:
    positions = _around(40)
    whole, first = fit_observed(_sightings(positions), 2), fit_observed(_sightings(positions[:20]), 2)
    same_place = replace(first, places=whole.places, radii=whole.radii, middles=whole.middles)
    sightings = _sightings(positions)
    phi = same_place.position_monomials(0, positions)
    values = observation_coefficients(sightings.bearings @ same_place.R_local_map[0].T, 2)
    half = batch_fit(phi[:20], values[:20], RIDGE)
    u, x, h = whole.coefficients.shape[1:]
    begun = replace(
        same_place,
        coefficients=half.coefficients.reshape(1, x, u, h).transpose(0, 2, 1, 3),
        moments=np.linalg.inv(half.covariance)[None],
    )
    fit = begun.learned(0, sightings.bearings[20:], positions[20:], forgetting=1.0)
    coefficients, moments, count = begun.with_fit(0, fit, 20)
    assert count == 40
    assert np.allclose(coefficients, whole.coefficients[0], atol=1e-4 * np.abs(whole.coefficients).max())
    assert np.allclose(moments, whole.moments[0], rtol=1e-6, atol=1e-9)


def test_forgetting_follows_a_feature_that_moved() -> None:
    before, after = _sightings(_around(60)), _sightings(_around(60, 8), _LANDMARK + np.array([0.0, 0.3, 0.0]))
    densities = fit_observed(before, 2)

    def off_px(forgetting: float) -> float:
        fit = densities.learned(0, after.bearings, after.positions, forgetting)
        coefficients, moments, _ = densities.with_fit(0, fit, 60)
        learned = replace(densities, coefficients=coefficients[None].astype(np.float32), moments=moments[None])
        return _peak_off_px(learned, np.array([0.0, 0.0, 1.5]), after.landmarks[0])

    assert off_px(0.9) < 5.0 < 15.0 < off_px(1.0)


def test_counts_fall_with_the_square_of_the_distance_to_nothing_at_the_radius() -> None:
    """n = 1 − |z Δ|² / r² around a pixel of the layout, in a camera of the layout; z is the bearing's part ahead."""
    layout = Layout.of(2)
    pixel, camera = layout.plane[1], layout.axes[5]
    seen = np.append(pixel, 1.0) / np.linalg.norm(np.append(pixel, 1.0))
    counts = sample_counts((seen @ camera)[None], 2)[:, 0, 5]
    off = seen[2] * np.linalg.norm(layout.plane - pixel, axis=1)
    np.testing.assert_allclose(counts, 1 - (off / TARGET_RADIUS) ** 2, atol=1e-9)


def test_the_loss_of_each_explanation() -> None:
    loss = Loss.of(np.array([[1.0, 2.0], [6.0, 3.0]]), np.array([[1.0, 2.0], [4.0, 3.0]]))
    assert (loss.points, loss.zero, loss.constant, loss.fitted) == (4, 50.0, 14.0, 4.0)


def test_table_5_keeps_all_but_the_moments() -> None:
    densities = fit_observed(_sightings(_around(20)), 2)
    rows = densities.rows(_sightings(_around(20)), np.zeros(1))
    assert rows.domain.shape == (1, len(ObservedDensities.domain_columns))
    kept = [
        ObservedDensities.kept_coefficients(densities.all_coefficients(np.array([0]))[0].astype(float), 2, None, None)
    ]
    again = ObservedDensities.from_rows(2, rows, _LANDMARK[None], kept)
    assert again.problem(1) == ""
    np.testing.assert_array_equal(again.counts, [20])
    np.testing.assert_allclose(again.middles, densities.middles, atol=1e-6)
    np.testing.assert_allclose(again.coefficients, densities.coefficients)
    np.testing.assert_array_equal(again.moments, [RIDGE * np.eye(densities.moments.shape[1])])
    rows.domain[0, 5] += 0.1
    with pytest.raises(ValueError, match="unit vector"):
        ObservedDensities.from_rows(2, rows, _LANDMARK[None], kept)


@pytest.mark.parametrize(
    "change",
    [
        {"middles": np.zeros((1, 3))},
        {"middles": np.full((1, 3), np.nan)},
        {"middles": np.eye(3)[:2]},
        {"counts": np.array([-1])},
        {"counts": np.array([1, 2])},
        {"moments": np.zeros((1, 3, 3))},
        {"moments": np.full((1, 10, 10), np.inf)},
        {"radii": np.array([0.0])},
    ],
)
def test_arrays_that_can_be_no_densities_are_found(change: dict[str, FloatArray]) -> None:
    densities = fit_observed(_sightings(_around(20)), 2)
    assert densities.problem(1) == ""
    assert replace(densities, **change).problem(1)


@pytest.mark.parametrize(
    ("name", "array"),
    [
        ("counts", np.zeros(1, np.int64)),
        ("counts", np.zeros(2, np.int32)),
        ("directions", np.zeros((1, 2), np.float32)),
        ("moments", np.zeros((1, 54))),
    ],
)
def test_a_file_whose_arrays_differ_in_type_or_shape_is_refused(name: str, array: FloatArray) -> None:
    arrays = {**fit_observed(_sightings(_around(20)), 2).arrays(), name: array}
    with pytest.raises(ValueError, match=f"observed_{name} is not of the right"):
        ObservedDensities.from_arrays(arrays, _LANDMARK[None])


def test_an_observation_counts_one_at_its_pixel_and_nothing_a_radius_away() -> None:
    counts = sample_counts(np.array([[1.0, 1.0, 0.0]]) / np.sqrt(2), 2)
    assert counts.max() <= 1.0
    assert counts.min() < 0.0


@pytest.mark.parametrize("turn_deg", [0.0, 40.0, -110.0])
def test_turned_about_the_vertical_it_is_the_same_density(turn_deg: float) -> None:
    densities = fit_observed(_sightings(_around(40)), 2)
    angle = np.radians(turn_deg)
    R = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    similarity = Similarity(1.0, R, np.array([1.0, -2.0, 0.5]))
    moved = densities.moved(similarity)
    pose = Pose.from_heading(np.array([0.1, 0.2, 1.4]), densities.middles[0] + [0.1, 0.2, 0.0])
    there = similarity.poses(pose.T_map_camera[None])[0]
    plane = np.array([[0.1, -0.05]])
    assert moved.at(plane, there).value == pytest.approx(densities.at(plane, pose.T_map_camera).value, abs=1e-3)
    back = moved.moved(Similarity(1.0, R.T, -R.T @ similarity.translation))
    assert np.allclose(back.moments, densities.moments, atol=1e-6)


def test_a_tilt_keeps_the_peak() -> None:
    densities = fit_observed(_sightings(_around(40)), 2)
    R = rotation_from_heading(np.array([0.0, 1.0, 0.03]))
    R = R @ rotation_from_heading(np.array([0.0, 1.0, 0.0])).T  # nearly upright: a map levelled
    similarity = Similarity(1.0, R, np.zeros(3))
    moved = densities.moved(similarity)
    seen = similarity.points(_LANDMARK[None])[0]
    assert _peak_off_px(moved, similarity.points(np.array([[0.0, 0.1, 1.5]]))[0], seen) < 3.0


@pytest.mark.parametrize("axis", [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.7, 0.3, 0.6]])
def test_tilted_the_peaks_are_where_the_feature_is(axis: list[float]) -> None:
    """By 9°, which turns every camera's picture about its own axis too."""
    densities = fit_observed(_sightings(_around(40)), 2)
    R = Rotation.from_rotvec(0.16 * np.array(axis) / np.linalg.norm(axis)).as_matrix()
    similarity = Similarity(1.5, R, np.array([0.5, -1.0, 0.2]))
    moved = densities.moved(similarity)
    seen = similarity.points(_LANDMARK[None])[0]
    off_px = [_peak_off_px(moved, position, seen) for position in similarity.points(_around(6, seed=4))]
    assert np.median(off_px) < 4.0
    assert max(off_px) < 10.0


def test_what_a_file_keeps_is_what_it_was() -> None:
    densities = fit_observed(_sightings(_around(20)), 2)
    landmarks = _LANDMARK[None].astype(np.float32)
    again = ObservedDensities.from_arrays(densities.arrays(), landmarks)
    assert again.problem(1) == ""
    for name, array in densities.arrays().items():
        assert np.array_equal(array, again.arrays()[name])
    with pytest.raises(ValueError, match="observed_moments"):
        ObservedDensities.from_arrays({k: v for k, v in densities.arrays().items() if k != "moments"}, landmarks)


def test_one_observation_makes_a_density() -> None:
    densities = fit_observed(_sightings(np.array([[0.0, 0.0, 1.5]])), 2)
    assert densities.counts.tolist() == [1]
    assert _peak_off_px(densities, np.array([0.0, 0.0, 1.5])) < 2.0


def test_without_bearings_there_is_nothing_to_fit() -> None:
    with pytest.raises(ValueError, match="bearings"):
        fit_observed(replace(_sightings(_around(3)), bearings=None), 2)
