"""Relative poses, and what agrees with a rotation that is known."""

from __future__ import annotations

import numpy as np
from scene import CAMERA, arc, cloud, descriptors_of, on_plane, sift_like
from scipy.spatial.transform import Rotation

from rholoc.geometry import FloatArray, rotation_angles
from rholoc.trajectory.visual.two_view import (
    inliers_of_rotation,
    ratio_matches,
    relative_pose,
    unit_descriptors,
)

_TOLERANCE = 2 / CAMERA.focal
_WRONG = 40


def _matches(points: FloatArray, seed: int = 0) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Points on the planes of two cameras, the last forty matched wrongly, and R_second_first."""
    rng = np.random.default_rng(seed)
    a, b = arc(2, 0.3)
    first, second = (on_plane(points, T) + rng.normal(0, 0.3 / CAMERA.focal, (len(points), 2)) for T in (a, b))
    second[-_WRONG:] = rng.permutation(second[-_WRONG:]) + rng.uniform(-0.2, 0.2, (_WRONG, 2))
    return first, second, b[:3, :3].T @ a[:3, :3]


def test_a_relative_pose_outvotes_wrong_matches() -> None:
    first, second, R = _matches(cloud(160))
    view = relative_pose(first, second, _TOLERANCE)
    assert np.degrees(rotation_angles(view.R_second_first, R)) < 0.5
    assert view.inliers[:-_WRONG].mean() > 0.97
    assert view.inliers[-_WRONG:].mean() < 0.3


def test_the_same_matches_give_the_same_pose() -> None:
    first, second, _ = _matches(cloud(160))
    one, other = (relative_pose(first, second, _TOLERANCE) for _ in range(2))
    np.testing.assert_array_equal(one.R_second_first, other.R_second_first)


def test_a_known_rotation_settles_what_a_plane_leaves_open() -> None:
    """All points on one wall: more than one pose explains them. With the rotation known, right matches agree."""
    wall = cloud(160)
    wall[:, 2] = 0.0
    first, second, R = _matches(wall)
    agree = inliers_of_rotation(first, second, R, _TOLERANCE)
    assert agree[:-_WRONG].mean() > 0.97
    assert agree[-_WRONG:].mean() < 0.3
    wrong = Rotation.from_euler("z", 15, degrees=True).as_matrix() @ R
    assert inliers_of_rotation(first, second, wrong, _TOLERANCE)[:-_WRONG].mean() < 0.5


def test_a_camera_that_only_turned_agrees_with_its_rotation() -> None:
    a = arc(1)[0]
    b = a.copy()
    b[:3, :3] = a[:3, :3] @ Rotation.from_euler("xyz", [3, 8, 2], degrees=True).as_matrix()
    points = cloud(60)
    agree = inliers_of_rotation(on_plane(points, a), on_plane(points, b), b[:3, :3].T @ a[:3, :3], _TOLERANCE)
    assert agree.all()


def test_a_single_match_fixes_no_translation() -> None:
    apart = inliers_of_rotation(np.zeros((1, 2)), np.array([[0.3, 0.0]]), np.eye(3), _TOLERANCE)
    assert apart.tolist() == [False]


def test_matches_are_mutual_and_distinct() -> None:
    descriptors = descriptors_of(50)
    shuffled = np.random.default_rng(0).permutation(50)
    a, b = (unit_descriptors(sift_like(np.zeros((50, 2)), some)) for some in (descriptors, descriptors[shuffled]))
    np.testing.assert_allclose(np.linalg.norm(a, axis=1), 1, rtol=1e-6)
    found = ratio_matches(a, b)
    assert len(found) == 50
    np.testing.assert_array_equal(shuffled[found[:, 1]], found[:, 0])
    assert len(ratio_matches(a, np.tile(a, (2, 1)))) == 0  # every window of a front is alike
    assert ratio_matches(a, a[:1]).shape == (0, 2)
