"""The baselines find the pose that they should, and say so where there is none."""

from __future__ import annotations

import numpy as np
import pytest

from rholoc.evaluation.errors import trajectory_errors
from rholoc.geometry import Camera, FloatArray, Pose
from rholoc.localization.index.matches import Matches
from rholoc_lab.evaluation.pnp_baselines import MatchSet, Solver, distinct, solve

CAMERA = Camera(640, 480, 520.0, 510.0, 318.0, 242.0, (-0.1, 0.02, 0.001, -0.002))
POSE = Pose.from_heading(np.array([1.0, -2.0, 1.5]), np.array([0.6, 0.8, -0.1]), roll=0.2)


def scene(wrong: int, noise_px: float = 0.3) -> tuple[FloatArray, FloatArray]:
    """Sixty right matches and some wrong ones: pixels and points."""
    rng = np.random.default_rng(5)
    pixels = rng.uniform((20, 20), (620, 460), (60 + wrong, 2))
    points = POSE.position + (CAMERA.rays(pixels) @ POSE.R_map_camera.T) * rng.uniform(1, 5, (60 + wrong, 1))
    points[60:] = points[rng.permutation(wrong) + 60]
    return pixels + rng.normal(0, noise_px, pixels.shape), points


@pytest.mark.parametrize("solver", Solver)
@pytest.mark.parametrize("wrong", [0, 140])
def test_a_pose_is_found_among_wrong_matches_and_through_distortion(solver: Solver, wrong: int) -> None:
    T = solve(solver, *scene(wrong), CAMERA)
    assert T is not None
    errors = trajectory_errors(T[None], POSE.T_map_camera[None])
    assert errors.position_m[0] < 0.01
    assert np.degrees(errors.rotation_rad[0]) < 0.2


@pytest.mark.parametrize("solver", Solver)
@pytest.mark.parametrize("count", [0, 3])
def test_too_few_matches_give_no_pose(solver: Solver, count: int) -> None:
    pixels, points = scene(0)
    assert solve(solver, pixels[:count], points[:count], CAMERA) is None


@pytest.mark.parametrize("solver", Solver)
def test_points_that_all_coincide_give_no_pose(solver: Solver) -> None:
    pixels, points = scene(0)
    assert solve(solver, np.repeat(pixels[:1], 20, axis=0), np.repeat(points[:1], 20, axis=0), CAMERA) is None


def test_matches_are_sorted_and_thinned_by_their_chances() -> None:
    matches = Matches(np.arange(4), np.arange(4), np.array([0.2, 0.9, 0.3, 0.9]))
    assert matches.likeliest_first().detections.tolist() == [1, 3, 2, 0]
    assert distinct(matches).detections.tolist() == [1, 2, 3]


def test_the_names_that_tables_show() -> None:
    assert [*Solver] == ["cv2", "poselib"]
    assert [*MatchSet] == ["everywhere", "distinct", "place"]
