"""Similarities: round trips."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from rholoc.errors import InvalidWaypoints, MappingFailed
from rholoc.geometry import FloatArray, Similarity, align_poses, pose_matrix, umeyama
from rholoc.recordings import Waypoint
from rholoc.trajectory.frame.waypoint_alignment import UpMeasurement, align_to_waypoints

_TIMES = np.arange(0.0, 10.0, 0.1)


def _similarity(seed: int, scale: float) -> Similarity:
    rng = np.random.default_rng(seed)
    return Similarity(scale, Rotation.random(rng=rng).as_matrix(), rng.uniform(-5, 5, 3))


def _walk() -> FloatArray:
    return np.column_stack([2 * np.sin(_TIMES / 3), _TIMES / 4, 0.2 * np.cos(_TIMES / 2)])


def _waypoints(path: FloatArray, rows: list[int]) -> list[Waypoint]:
    x = path[rows]
    return [Waypoint(f"W{i}", float(_TIMES[row]), tuple(p)) for i, (row, p) in enumerate(zip(rows, x, strict=True))]


@given(seed=st.integers(0, 1000), scale=st.floats(0.05, 20), count=st.integers(4, 30))
def test_umeyama_gives_back_the_similarity(seed: int, scale: float, count: int) -> None:
    truth = _similarity(seed, scale)
    points = np.random.default_rng(seed).uniform(-1, 1, (count, 3))
    found = umeyama(points, truth.points(points))
    np.testing.assert_allclose(found.points(points), truth.points(points), atol=1e-8)
    assert found.scale == pytest.approx(scale, rel=1e-8)
    assert np.linalg.det(found.rotation) == pytest.approx(1)


def test_umeyama_of_mirrored_points_is_a_rotation() -> None:
    points = np.random.default_rng(1).uniform(-1, 1, (10, 3))
    assert np.linalg.det(umeyama(points, points * [1, 1, -1]).rotation) == pytest.approx(1)


def test_a_minority_of_wrong_poses_does_not_move_the_alignment() -> None:
    truth = _similarity(3, 2.0)
    poses = pose_matrix(np.tile(np.eye(3), (100, 1, 1)), _walk())
    target = truth.poses(poses)
    target[:20, :3, 3] += [3.0, 0, 0]
    found = align_poses(poses, target, rounds=20)
    assert found.scale == pytest.approx(2.0, rel=0.01)


@given(seed=st.integers(0, 50), scale=st.floats(0.1, 10))
def test_three_waypoints_fix_the_frame(seed: int, scale: float) -> None:
    path = _walk()
    own = _similarity(seed, scale).points(path)
    found = align_to_waypoints(_TIMES, own, _waypoints(path, [0, 45, 90]))
    np.testing.assert_allclose(found.similarity.points(own), path, atol=1e-5)
    assert found.worst_m < 1e-5


def test_one_mistyped_coordinate_of_five_is_found_and_named() -> None:
    path = _walk()
    own = _similarity(5, 0.3).points(path)
    waypoints = _waypoints(path, [0, 20, 45, 70, 99])
    for wrong in range(5):
        for axis, metres in ((0, 1.0), (1, -0.3), (2, 9.0)):
            said = list(waypoints[wrong].position)
            said[axis] += metres
            x, y, z = said
            mistyped = [*waypoints[:wrong], replace(waypoints[wrong], position=(x, y, z)), *waypoints[wrong + 1 :]]
            found = align_to_waypoints(_TIMES, own, mistyped)
            assert found.mistake == wrong
            assert f"W{wrong} is" in found.explanation
            advice = re.search(r"Check its (.): (\S+) is written, (\S+) would fit", found.explanation)
            assert advice is not None
            assert advice[1] == "xyz"[axis]
            assert float(advice[2]) - float(advice[3]) == pytest.approx(metres, abs=0.011)
            assert np.linalg.norm(found.similarity.points(own) - path, axis=1).max() < 0.01
            assert found.residuals_m[wrong] == pytest.approx(abs(metres), abs=0.01)
            assert found.worst_m < 0.01


def test_waypoints_that_are_merely_imprecise_are_all_used() -> None:
    path = _walk()
    noise = np.random.default_rng(2).normal(0, 0.02, path.shape)
    found = align_to_waypoints(_TIMES, path, _waypoints(path + noise, [0, 20, 45, 70, 99]))
    assert found.mistake is None
    assert np.linalg.norm(found.similarity.points(path) - path, axis=1).max() < 0.08


def test_gravity_mends_what_noisy_waypoints_tilt() -> None:
    path = _walk()
    truth = _similarity(7, 1.0)
    own = truth.points(path)
    waypoints = _waypoints(path, [0, 45, 90])
    middle = waypoints[1]
    waypoints[1] = Waypoint(middle.name, middle.time, (*middle.position[:2], middle.position[2] + 0.05))
    up = UpMeasurement(truth.rotation @ [0.0, 0.0, 1.0], 0.1)
    tilts = []
    for measurement in (None, up):
        found = align_to_waypoints(_TIMES, own, waypoints, measurement).similarity
        tilts.append(np.degrees(np.arccos((found.rotation @ up.direction)[2])))
    assert tilts[1] < 0.3 * tilts[0]


def test_waypoints_on_a_line_are_refused() -> None:
    own = _walk()
    line = [Waypoint(str(i), float(i), (float(i), 2.0 * i, 0.0)) for i in range(5)]
    with pytest.raises(InvalidWaypoints, match="line"):
        align_to_waypoints(_TIMES, own, line)


def test_two_waypoints_are_refused() -> None:
    with pytest.raises(InvalidWaypoints, match="2 waypoints"):
        align_to_waypoints(_TIMES, _walk(), _waypoints(_walk(), [0, 50]))


def test_waypoints_of_another_walk_fail() -> None:
    elsewhere = [Waypoint("a", 0.0, (0, 0, 0)), Waypoint("b", 3.0, (9, 0, 0)), Waypoint("c", 6.0, (0, 9, 0))]
    with pytest.raises(MappingFailed, match="misses the waypoints"):
        align_to_waypoints(_TIMES, _walk(), elsewhere)


def test_waypoints_far_from_any_posed_frame_are_left_out() -> None:
    path = _walk()
    waypoints = [*_waypoints(path, [0, 45, 90]), Waypoint("late", 30.0, (0.0, 0.0, 0.0))]
    found = align_to_waypoints(_TIMES, path, waypoints)
    assert found.similarity.scale == pytest.approx(1, rel=1e-5)
    assert np.isnan(found.residuals_m[3])
    with pytest.raises(MappingFailed, match="late"):
        align_to_waypoints(_TIMES, path, [waypoints[0], waypoints[1], waypoints[3]])
