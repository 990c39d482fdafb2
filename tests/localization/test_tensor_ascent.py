"""Localizing on the paper's own densities, in a room of points.

The layers forbid localization to import mapping; its tests may, as only a fitted map shows what the ascent does.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rholoc.density import DensityKind, Evidence, TensorDensities
from rholoc.geometry import FloatArray, Pose
from rholoc.localization import Dof, Localizer, Query
from rholoc.localization.index.map_index import MapIndex
from rholoc.localization.pose.ascent import ascend, moved
from rholoc.localization.pose.rematching import evidence_of
from rholoc.mapping.build.density_fitting import fit_densities
from rholoc.maps import Map
from rholoc_lab.paper.equations import gradient


@pytest.fixture(scope="module")
def tensor_map(room_map: Map) -> Map:
    return fit_densities(room_map, DensityKind.TENSOR)


@pytest.fixture(scope="module")
def tensor_localizer(tensor_map: Map) -> Localizer:
    return Localizer(tensor_map)


def _near(index: MapIndex, point_room: Any, truth: Pose, seed: int) -> tuple[TensorDensities, Evidence]:
    query = Query(point_room.see(truth, seed), point_room.camera, Dof.FREE)
    matches, _ = index.match_near(query.features, query.camera, truth.T_map_camera, 14.0)
    evidence = evidence_of(index, matches, query.camera.rays(query.features.pixels), query.camera)
    assert isinstance(index.map.densities, TensorDensities)
    return index.map.densities, evidence


def _value(densities: TensorDensities, evidence: Evidence, T: FloatArray, tolerance_px: float) -> float:
    """Σ log(ε + ρ) of the matches that are heard at a pose."""
    local = densities.near(evidence, T, tolerance_px)
    return float(np.log(evidence.epsilon[local.matches] + local.at(T, tolerance_px).density).sum())


@pytest.mark.parametrize(
    "dof", [Dof.UPRIGHT, *(pytest.param(dof, marks=pytest.mark.slow) for dof in (Dof.FREE, Dof.AUTO))]
)
def test_frames_between_the_views_are_localized(tensor_localizer: Localizer, point_room: Any, dof: Dof) -> None:
    distances, angles = [], []
    for seed, truth in enumerate(point_room.walk(12, sideways_m=0.12)[::2]):
        answer = tensor_localizer.localize(Query(point_room.see(truth, 1000 + seed), point_room.camera, dof))
        assert answer.pose is not None, answer.reason
        distances.append(np.linalg.norm(answer.pose.position - truth.position))
        turned = answer.pose.R_map_camera.T @ truth.R_map_camera
        angles.append(np.degrees(Rotation.from_matrix(turned).magnitude()))
        if dof is Dof.UPRIGHT:
            assert answer.pose.roll == pytest.approx(0, abs=1e-9)
    assert np.median(distances) < 0.02
    assert max(distances) < 0.04
    assert max(angles) < 0.5


def test_a_rolled_camera_is_localized(tensor_localizer: Localizer, point_room: Any) -> None:
    upright = point_room.walk(7)[3]
    for roll in (0.5, -1.5, 3.0):
        truth = Pose.from_heading(upright.position, upright.heading, roll)
        answer = tensor_localizer.localize(Query(point_room.see(truth, 5), point_room.camera, Dof.FREE))
        assert np.linalg.norm(answer.pose.position - truth.position) < 0.03
        assert answer.pose.roll == pytest.approx(roll, abs=0.01)


def test_the_gradient_is_the_limit_of_differences(tensor_localizer: Localizer, point_room: Any) -> None:
    rng = np.random.default_rng(2)
    step = 1e-4
    for seed, truth in enumerate(point_room.walk(4)):
        densities, evidence = _near(tensor_localizer.index, point_room, truth, seed)
        T = moved(truth.T_map_camera, rng.normal(0, [0.01] * 3 + [0.004] * 3))
        found = gradient(densities, evidence, T, 12.0)
        # along directions that keep each landmark's distance, on which the tolerance depends, a rotation does
        for unit in np.eye(6)[3:]:
            after = _value(densities, evidence, moved(T, step * unit), 12.0)
            before = _value(densities, evidence, moved(T, -step * unit), 12.0)
            assert found @ unit == pytest.approx((after - before) / (2 * step), rel=0.02, abs=1.0)


def test_the_ascent_ends_where_the_gradient_vanishes(tensor_localizer: Localizer, point_room: Any) -> None:
    for seed, truth in enumerate(point_room.walk(4)):
        densities, evidence = _near(tensor_localizer.index, point_room, truth, seed)
        start = moved(truth.T_map_camera, np.array([0.01, -0.01, 0.01, 0.003, -0.002, 0.002]))
        optimum = ascend(densities, evidence, start, (14.0, 7.0, 7.0, 7.0, 7.0), Dof.FREE)
        at_start = gradient(densities, evidence, start, 7.0)
        at_end = gradient(densities, evidence, optimum.T_map_camera, 7.0)
        value = _value(densities, evidence, optimum.T_map_camera, 7.0)
        assert np.linalg.norm(at_end) < 0.02 * np.linalg.norm(at_start)
        for unit in np.eye(6):
            for way in (0.02, -0.02):
                assert _value(densities, evidence, moved(optimum.T_map_camera, way * unit), 7.0) < value


def test_false_matches_do_not_draw_the_pose(tensor_localizer: Localizer, point_room: Any) -> None:
    truth = point_room.walk(5)[2]
    densities, evidence = _near(tensor_localizer.index, point_room, truth, 1)
    rng = np.random.default_rng(0)
    false = rng.random(len(evidence)) < 0.4
    landmarks = np.where(false, rng.permutation(evidence.features), evidence.features)
    at = tensor_localizer.index
    mixed = replace(
        evidence, features=landmarks, landmarks=at.landmarks[landmarks], covariances=at.covariances[landmarks]
    )
    start = moved(truth.T_map_camera, np.array([0.03, 0.03, -0.02, 0.01, 0.0, -0.01]))
    optimum = ascend(densities, mixed, start, (14.0, 7.0, 4.0), Dof.FREE)
    assert np.linalg.norm(optimum.T_map_camera[:3, 3] - truth.position) < 0.02
    assert not np.any(optimum.density[false & (landmarks != evidence.features)] > 0.9)


def test_features_speak_only_where_a_density_is_valid(tensor_localizer: Localizer, point_room: Any) -> None:
    densities = tensor_localizer.map.densities
    assert isinstance(densities, TensorDensities)
    truth = point_room.walk(5)[2]
    every = np.arange(len(tensor_localizer.map))
    chosen, rows = densities.choose(every, truth.T_map_camera)
    assert 0 < len(chosen) < len(every)
    assert densities.valid_at(truth.position, truth.heading, rows).all()
    far = Pose.from_heading(truth.position + 100.0, truth.heading)
    assert len(densities.choose(every, far.T_map_camera)[0]) == 0
    evidence = Evidence.of(
        every[:9],
        np.tile([0.0, 0.0, 1.0], (9, 1)),
        tensor_localizer.index.landmarks[:9],
        tensor_localizer.index.covariances[:9],
        np.full(9, 0.5),
        520.0,
    )
    stayed = ascend(densities, evidence, far.T_map_camera, (14.0, 7.0), Dof.FREE)
    np.testing.assert_allclose(stayed.T_map_camera, far.T_map_camera, atol=1e-9)
    assert stayed.value == 0


def test_it_is_the_densities_that_are_climbed_not_the_landmarks(tensor_localizer: Localizer, point_room: Any) -> None:
    """Densities that peak 1 cm beside their landmarks: the ascent and the whole localizer end 1 cm beside, too."""
    beside = np.array([0.008, -0.006, 0.004])
    map_ = tensor_localizer.map
    fitted = map_.densities
    assert isinstance(fitted, TensorDensities)
    aside = replace(fitted, landmarks=fitted.landmarks + beside, places=fitted.places + beside)
    aside_localizer = Localizer(replace(map_, densities=aside))
    climbed, answered = [], []
    for seed, truth in enumerate(point_room.walk(5, sideways_m=0.1)):
        _, evidence = _near(tensor_localizer.index, point_room, truth, seed)
        ends = [ascend(form, evidence, truth.T_map_camera, (14.0,) * 3, Dof.FREE) for form in (fitted, aside)]
        climbed.append((ends[1].T_map_camera - ends[0].T_map_camera)[:3, 3])
        query = Query(point_room.see(truth, seed), point_room.camera, Dof.FREE)
        poses = [localizer.localize(query).pose for localizer in (tensor_localizer, aside_localizer)]
        assert poses[0] is not None
        assert poses[1] is not None
        answered.append(poses[1].position - poses[0].position)
    np.testing.assert_allclose(np.median(climbed, axis=0), beside, atol=0.003)
    np.testing.assert_allclose(np.median(answered, axis=0), beside, atol=0.003)
