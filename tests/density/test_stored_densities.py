"""What a file keeps of densities, what Table 5 says of them, and which of them can be no densities."""

from dataclasses import replace

import numpy as np
import pytest

from rholoc.density.density import DensityRows, Sightings
from rholoc.density.evidence import Evidence
from rholoc.density.ray import TARGET_RADIUS, RayDensities, ray_coefficients
from rholoc.density.tensor import TensorDensities, coefficient_columns, fit_tensors
from rholoc.geometry import Pose, Similarity

FOCAL_PX = 525.0
LANDMARKS = np.array([[2.0, 0.0, 1.0], [0.0, 3.0, 1.0], [-2.0, 0.5, 1.2]])
PLACES = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [-2.0, 2.5, 1.2]])
FEATURES = np.array([0, 1, 2, 2])
RADII = np.array([0.4, 0.5, 0.6, 0.7])
FITTED = fit_tensors(LANDMARKS[FEATURES], PLACES, RADII, 2)
TENSORS = replace(FITTED, features=FEATURES)


def looking_at(landmark, place=(0.0, 0.0, 1.0)):
    heading = np.asarray(landmark) - place
    return Pose.from_heading(np.asarray(place, dtype=float), heading / np.linalg.norm(heading), 0.0)


def evidence(pixels, features=FEATURES[:3], chance=0.5):
    rays = np.column_stack([np.asarray(pixels) / FOCAL_PX, np.ones(len(pixels))])
    rays /= np.linalg.norm(rays, axis=1)[:, None]
    count = len(pixels)
    covariances = np.zeros((count, 3, 3))
    return Evidence.of(features, rays, LANDMARKS[features], covariances, np.full(count, chance), FOCAL_PX)


def same(a: TensorDensities, b: TensorDensities) -> bool:
    names = ("coefficients", "features", "landmarks", "places", "radii")
    return a.degree == b.degree and all(np.allclose(getattr(a, name), getattr(b, name), atol=1e-6) for name in names)


@pytest.mark.parametrize("count", [4, 0])
@pytest.mark.parametrize("degree", [1, 2, 3])
def test_a_file_keeps_tensors(degree, count):
    fitted = fit_tensors(LANDMARKS[FEATURES[:count]], PLACES[:count], RADII[:count], degree)
    densities = replace(fitted, features=FEATURES[:count])
    assert densities.problem(len(LANDMARKS)) == ""
    assert same(TensorDensities.from_arrays(densities.arrays(), LANDMARKS), densities)


@pytest.mark.parametrize(
    ("name", "array", "says"),
    [
        ("radii", None, "tensor_radii"),
        ("radii", RADII, "tensor_radii is not of the right type"),
        ("places", PLACES[0].astype(np.float32), "tensor_places is not of the right type"),
        ("degree", np.array(4, np.int32), "impossible degree"),
        ("features", np.array([0, 1, 2, 3], np.int32), "not there"),
        ("features", np.array([-1, 1, 2, 2], np.int32), "not there"),
    ],
)
def test_a_file_that_contradicts_itself_is_refused(name, array, says):
    arrays = {key: value for key, value in {**TENSORS.arrays(), name: array}.items() if value is not None}
    with pytest.raises(ValueError, match=says):
        TensorDensities.from_arrays(arrays, LANDMARKS)


@pytest.mark.parametrize(
    "change",
    [
        {"features": np.array([0, 2, 1, 2])},
        {"features": np.array([0, 1, 2, 3])},
        {"features": np.array([-1, 1, 2, 2])},
        {"radii": np.array([0.4, 0.0, 0.6, 0.7])},
        {"radii": RADII[:3]},
        {"radii": np.array([0.4, np.nan, 0.6, 0.7])},
        {"places": np.where(np.eye(4, 3) > 0, np.inf, PLACES)},
        {"places": PLACES[:3]},
        {"coefficients": TENSORS.coefficients[:3]},
        {"coefficients": np.where(np.arange(27) == 3, np.nan, TENSORS.coefficients)},
        {"degree": 3},
        {"landmarks": PLACES},
    ],
)
def test_arrays_that_can_be_no_densities_are_found(change):
    assert replace(TENSORS, **change).problem(len(LANDMARKS))


def test_a_landmark_may_be_near_its_place():
    near = PLACES + 0.1 * (LANDMARKS[FEATURES] - PLACES)
    assert replace(TENSORS, landmarks=near).problem(len(LANDMARKS)) == ""


def test_table_5_has_rows_for_tensors_and_they_are_read_back():
    rows = TENSORS.rows(None, None)
    columns = coefficient_columns(2)
    full = TENSORS.all_coefficients(np.arange(4)).astype(np.float64)
    kept = [TensorDensities.kept_coefficients(of_one, 2, None, None) for of_one in full]
    assert all(len(of_one) == len(columns) for of_one in kept)
    assert same(TensorDensities.from_rows(2, rows, LANDMARKS, kept), TENSORS)
    for domain, says in (((0, 0, 1, 0.0), "radius"), ((*LANDMARKS[0], 0.4), "place")):
        wrong = DensityRows(rows.features, np.vstack([domain, rows.domain[1:]]).astype(np.float32))
        with pytest.raises(ValueError, match=says):
            TensorDensities.from_rows(2, wrong, LANDMARKS, kept)


def test_table_5_may_have_no_powers_that_no_fit_gives():
    full = TENSORS.all_coefficients(np.array([0]))[0].astype(np.float64)
    beyond = np.setdiff1d(np.arange(len(full)), coefficient_columns(2))[7]
    full[beyond] = 1e-8 * np.abs(full).max()  # as a sum's rounding leaves it
    TensorDensities.kept_coefficients(full, 2, LANDMARKS[0], None)
    full[beyond] = 1e-3 * np.abs(full).max()
    with pytest.raises(ValueError, match="powers beyond"):
        TensorDensities.kept_coefficients(full, 2, LANDMARKS[0], None)


def test_table_5_has_a_row_for_each_ray_density():
    positions = LANDMARKS[[0, 0, 1]] + [[0, 0, 3.0], [0, 1.0, 0], [5.0, 0, 0]]
    rows = RayDensities().rows(Sightings(LANDMARKS, np.array([0, 0, 1]), positions), np.array([0.0, 0.04, 0.0]))
    expected = np.hypot(
        TARGET_RADIUS * np.array([2.0, 5.0, 1.0]), [0.0, 0.2, 0.0]
    )  # 1 m where it was seen from nowhere
    np.testing.assert_allclose(rows.domain[:, 0], expected, rtol=1e-6)
    assert rows.features.tolist() == [0, 1, 2]


def test_ray_coefficients_follow_from_the_landmark_and_the_tolerance():
    landmark, tolerance = LANDMARKS[0], np.array([0.5])
    full = ray_coefficients(landmark[None], tolerance)[0]
    assert len(RayDensities.kept_coefficients(full, 2, landmark, tolerance)) == 0
    np.testing.assert_allclose(RayDensities().coefficients_of(0, landmark, tolerance), full)
    rounded = full + 1e-8 * np.abs(full).max()  # as a table's digits leave them
    assert len(RayDensities.kept_coefficients(rounded, 2, landmark, tolerance)) == 0
    with pytest.raises(ValueError, match="not positive"):
        RayDensities.kept_coefficients(full, 2, landmark, np.array([0.0]))
    with pytest.raises(ValueError, match="contradict"):
        RayDensities.kept_coefficients(full, 2, landmark, np.array([0.6]))


def test_of_several_places_that_one_is_asked_whose_direction_is_ahead():
    both = replace(TENSORS, places=PLACES[[0, 0, 0, 0]] + [[0, 0, 0], [0, 0, 0], [0, 0, 0], [0.3, 0.9, 0]])
    for row in (2, 3):
        pose = looking_at(LANDMARKS[2], both.places[2])
        pose = Pose.from_heading(both.places[[2, 3]].mean(axis=0), both.directions[row], pose.roll)
        chosen, found = replace(both, radii=np.full(4, 2.0)).choose(np.array([2, 2]), pose.T_map_camera)
        assert (chosen.tolist(), found.tolist()) == ([0, 1], [row, row])
    assert len(both.choose(np.array([0, 1, 2]), looking_at([9.0, 0, 1], [8.0, 0, 1]).T_map_camera)[0]) == 0


@pytest.mark.parametrize("offset_px", [0.0, 10.0, 19.0])
def test_a_tensor_falls_with_the_square_of_its_pixels_offset_to_the_tolerance(offset_px):
    pose = looking_at(LANDMARKS[0])
    near = TENSORS.near(evidence([[offset_px, 0.0]], FEATURES[:1]), pose.T_map_camera, 20.0)
    assert near.matches.tolist() == [0]
    np.testing.assert_allclose(near.plane, [[offset_px / FOCAL_PX, 0.0]], atol=1e-12)
    density = near.at(pose.T_map_camera, 20.0).density[0]
    assert density == pytest.approx(1 - (offset_px / 20.0) ** 2, abs=0.06)


def test_tensors_far_from_their_pixel_behind_or_out_of_place_are_not_asked():
    pose = looking_at(LANDMARKS[0])
    assert TENSORS.near(evidence([[39.0, 0.0]], FEATURES[:1]), pose.T_map_camera, 20.0).matches.tolist() == [0]
    assert len(TENSORS.near(evidence([[41.0, 0.0]], FEATURES[:1]), pose.T_map_camera, 20.0).matches) == 0
    behind = looking_at([-2.0, 0.0, 1.0])
    assert len(TENSORS.near(evidence([[0.0, 0.0]], FEATURES[:1]), behind.T_map_camera, 20.0).matches) == 0
    away = looking_at(LANDMARKS[0], [0.0, -0.5, 1.0])  # 0.4 m is the radius
    assert len(TENSORS.near(evidence([[0.0, 0.0]], FEATURES[:1]), away.T_map_camera, 20.0).matches) == 0


def test_an_uncertain_landmark_is_asked_from_farther_off():
    pose = looking_at(LANDMARKS[0])
    sure = evidence([[60.0, 0.0]], FEATURES[:1])
    unsure = replace(sure, covariances=np.full((1, 3, 3), 0.0) + 0.15**2 * np.eye(3))
    assert len(TENSORS.near(sure, pose.T_map_camera, 20.0).matches) == 0
    assert len(TENSORS.near(unsure, pose.T_map_camera, 20.0).matches) == 1


def test_densities_of_a_map_that_is_moved_are_those_of_its_moved_landmarks():
    shift = Similarity(2.0, np.eye(3), np.array([1.0, -2.0, 0.5]))
    moved = TENSORS.moved(shift)
    np.testing.assert_array_equal(moved.coefficients, TENSORS.coefficients)
    np.testing.assert_allclose(moved.landmarks, 2 * TENSORS.landmarks + [1.0, -2.0, 0.5])
    np.testing.assert_allclose(moved.radii, 2 * RADII)
    quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    turned = TENSORS.moved(Similarity(1.0, quarter, np.zeros(3)))
    fresh = fit_tensors(TENSORS.landmarks @ quarter.T, PLACES @ quarter.T, RADII, 2)
    np.testing.assert_allclose(turned.coefficients, fresh.coefficients, atol=1e-6)


def test_odds_of_a_false_match_follow_from_its_chance_of_being_true():
    np.testing.assert_allclose(evidence([[0.0, 0.0]] * 3, chance=0.5).epsilon, 0.1)
    np.testing.assert_allclose(evidence([[0.0, 0.0]] * 3, chance=0.2).epsilon, 0.4)
