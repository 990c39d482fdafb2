"""Relative poses, and what agrees with a rotation that is known."""

from dataclasses import replace

import numpy as np
import pytest
from scene import CAMERA, arc, cloud, descriptors_of, on_plane, rays, sift_like
from scipy.spatial.transform import Rotation

from rholoc.geometry import Camera, FloatArray, pose_matrix, rotation_angles
from rholoc.trajectory.visual.matching import VerifiedPair
from rholoc.trajectory.visual.parallax import only_turned, shifts
from rholoc.trajectory.visual.two_view import (
    absolute_pose,
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
    return rays(first), rays(second), b[:3, :3].T @ a[:3, :3]


def test_a_relative_pose_outvotes_wrong_matches() -> None:
    first, second, R = _matches(cloud(160))
    view = relative_pose(first, second, _TOLERANCE)
    assert np.degrees(rotation_angles(view.R_second_first, R)) < 0.5
    assert view.inliers[:-_WRONG].mean() > 0.97
    assert view.inliers[-_WRONG:].mean() < 0.3


def test_a_pose_with_just_enough_inliers_is_found_by_fewer_samples() -> None:
    """Fifteen right matches and as many wrong ones."""
    for seed in range(20):
        first, second, _ = _matches(cloud(15 + _WRONG, seed), seed)
        some = np.r_[:15, -15:0]
        assert relative_pose(first[some], second[some], _TOLERANCE, 15).inliers[:15].all()


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
    agree = inliers_of_rotation(
        rays(on_plane(points, a)), rays(on_plane(points, b)), b[:3, :3].T @ a[:3, :3], _TOLERANCE
    )
    assert agree.all()


def test_a_single_match_fixes_no_translation() -> None:
    apart = inliers_of_rotation(rays(np.zeros((1, 2))), rays(np.array([[0.3, 0.0]])), np.eye(3), _TOLERANCE)
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


@pytest.mark.parametrize(("off", "agrees"), [(0.9, True), (1.1, False)])
@pytest.mark.parametrize("depth_m", [3.0, 12.0])
def test_a_match_agrees_within_the_tolerance_of_its_epipolar_plane(off: float, agrees: bool, depth_m: float) -> None:
    """Fifty perfect matches fix a way sideways; one more is off upward by an angle of its own."""
    way = np.array([0.3, 0.0, 0.0])
    points = np.append(np.random.default_rng(0).uniform([-1, -1, 2], [1, 1, 4], (50, 3)), [[0.0, 0.0, depth_m]], axis=0)
    first, second = points[:, :2] / points[:, 2:], (points - way)[:, :2] / points[:, 2:]
    second[-1] = [-0.3 / depth_m, 0.0]
    ray = np.array([-0.3 / depth_m, np.tan(off * _TOLERANCE) * np.hypot(1, 0.3 / depth_m)])
    second[-1] = ray
    found = inliers_of_rotation(rays(first), rays(second), np.eye(3), _TOLERANCE)
    assert found[:-1].all()
    assert found[-1] == agrees


@pytest.mark.parametrize(("from_way", "off", "agrees"), [(0.02, 2.3, True), (0.2, 0.9, True), (0.2, 1.1, False)])
def test_near_the_way_itself_a_ray_says_little(from_way: float, off: float, agrees: bool) -> None:
    """Nearer than a twentieth of a radian, a match may be as far off its plane as there."""
    ahead = np.random.default_rng(0).uniform([-1, -1, 2], [1, 1, 4], (50, 3))
    moved = ahead - [0.0, 0.0, 0.3]
    first = np.append(ahead[:, :2] / ahead[:, 2:], [[from_way, 0.0]], axis=0)
    second = np.append(moved[:, :2] / moved[:, 2:], [[from_way, off * _TOLERANCE]], axis=0)
    assert inliers_of_rotation(rays(first), rays(second), np.eye(3), _TOLERANCE)[-1] == agrees


@pytest.mark.parametrize(("nearer", "kept"), [(0.78, True), (0.82, False)])
def test_a_match_is_clearly_nearer_than_the_next_best(nearer: float, kept: bool) -> None:
    """By four fifths of the distance, as Lowe has it."""

    def at(distance: float, axis: int) -> FloatArray:
        alike = 1 - distance**2 / 2
        return alike * np.eye(4)[0] + np.sqrt(1 - alike**2) * np.eye(4)[axis]

    a = np.stack([np.eye(4)[0], np.eye(4)[3]])
    b = np.stack([at(0.4, 2), at(0.4 * nearer, 1), np.eye(4)[3]])
    found = ratio_matches(a, b)
    assert ([0, 1] in found.tolist()) is kept
    assert [1, 2] in found.tolist()


def test_only_mutual_neighbours_match() -> None:
    """Two of the first are nearest to one of the second, which is nearest to the better of them."""
    a = np.array([[1.0, 0.0, 0.0], [0.98, np.sqrt(1 - 0.98**2), 0.0], [0.0, 0.0, 1.0]])
    b = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    assert ratio_matches(a, b).tolist() == [[0, 0], [2, 1]]
    assert ratio_matches(a[:1], b).shape == (0, 2)
    assert ratio_matches(a[[0, 2]], b).tolist() == [[0, 0], [1, 1]]


def test_descriptors_without_a_length_stay_without_one() -> None:
    found = unit_descriptors(sift_like(np.zeros((2, 2)), np.array([np.zeros(128), np.full(128, 3.0)])))
    assert not found[0].any()
    np.testing.assert_allclose(found[1], 1 / np.sqrt(128), rtol=1e-6)
    assert found.dtype == np.float32


def test_a_camera_is_placed_by_points_that_are_known() -> None:
    points = cloud(80)
    T = pose_matrix(Rotation.from_euler("xyz", [4, -7, 3], degrees=True).as_matrix(), np.array([0.4, -0.2, -4.0]))
    plane = on_plane(points, T)
    plane[:20] += 0.1
    found, agreeing = absolute_pose(rays(plane), points, _TOLERANCE)
    np.testing.assert_allclose(found, T, atol=1e-6)
    assert agreeing == 60


def test_of_few_matches_nothing_is_claimed() -> None:
    view = relative_pose(rays(np.zeros((3, 2))), rays(np.zeros((3, 2))), _TOLERANCE)
    assert view.inliers.tolist() == [False] * 3


def test_two_matches_fix_a_translation_that_both_agree_with() -> None:
    points, way = np.array([[0.5, 0.2, 3.0], [-0.6, 0.4, 4.0]]), np.array([0.3, 0.1, 0.05])
    seen = [points, points - way]
    first, second = (one[:, :2] / one[:, 2:] for one in seen)
    assert inliers_of_rotation(rays(first), rays(second), np.eye(3), _TOLERANCE).all()


_STRAIGHT = Camera(640, 480, 500.0, 500.0, 319.5, 239.5)
_LENSES = [_STRAIGHT, CAMERA, replace(_STRAIGHT, fx=380.0, fy=380.0), replace(_STRAIGHT, fx=700.0, fy=700.0)]
_BARREL = (-0.45, 0.0, 0.0, 0.0)
_NOISE_PX = 0.5


def _seen(points: FloatArray, R: FloatArray, position: FloatArray, rng: np.random.Generator) -> FloatArray:
    return _STRAIGHT.project((points - position) @ R) + rng.normal(0, _NOISE_PX, (len(points), 2))


def _walk(step_m: float, wrong: float = 0.0) -> tuple[list[VerifiedPair], list[FloatArray]]:
    """Ten keyframes 5° and ``step_m`` apart, things 1 to 4 m away, of which a share is matched wrongly."""
    rng = np.random.default_rng(0)
    points = rng.uniform([-2, -1, 1], [2, 1, 4], (120, 3))
    turns = Rotation.from_euler("y", 5 * (np.arange(10)[:, None] - 5), degrees=True).as_matrix()
    seen = [_seen(points, R, np.array([step_m * k, 0, -0.5]), rng) for k, R in enumerate(turns)]
    numbers = np.arange(120)
    others = numbers.copy()
    some = rng.choice(120, int(120 * wrong), replace=False)
    others[some] = rng.permutation(others[some])
    matches = np.column_stack([numbers, others])
    return [VerifiedPair(k, k + 1, matches, turns[k + 1].T @ turns[k]) for k in range(9)], seen


@pytest.mark.parametrize("wrong", [0.0, 0.2])
def test_a_camera_that_turns_where_it_stands_leaves_noise(wrong: float) -> None:
    pairs, seen = _walk(0.0, wrong)
    assert only_turned(pairs, seen, _STRAIGHT, is_given=False)
    assert np.all(shifts(pairs, seen, _STRAIGHT) < 2.5 * _NOISE_PX / _STRAIGHT.focal)


@pytest.mark.parametrize(
    "assumed", [*_LENSES[1:], replace(_STRAIGHT, distortion=_BARREL)], ids=["distorted", "wide", "long", "barrel"]
)
def test_a_wrong_camera_does_not_make_a_turn_a_motion(assumed: Camera) -> None:
    """Pictures of a turning camera whose distortion was left out became a map, on which two reconstructions agreed."""
    pairs, seen = _walk(0.0, wrong=0.2)
    assert np.median(shifts(pairs, seen, assumed)) > 0.003
    assert only_turned(pairs, seen, assumed, is_given=False)


@pytest.mark.parametrize("wrong", [0.0, 0.2])
@pytest.mark.parametrize("assumed", _LENSES, ids=["right", "distorted", "wide", "long"])
def test_one_that_walks_does_not(assumed: Camera, wrong: float) -> None:
    pairs, seen = _walk(0.1, wrong)
    assert not only_turned(pairs, seen, assumed, is_given=False)
    assert np.median(shifts(pairs, seen, _STRAIGHT)) > 0.005


@pytest.mark.parametrize("camera", [_STRAIGHT, replace(_STRAIGHT, distortion=(-0.2, 0.05, 0.0, 0.0))])
def test_a_given_camera_that_passes_a_flat_wall_does_not(camera: Camera) -> None:
    """By a longer lens with distortion its motion looks like a turn: such a walk was refused."""
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform([-2, -2], [4, 2], (600, 2)), np.full(600, 3.0)])
    seen = [camera.project(points - [0.19 * k, 0, 0]) + rng.normal(0, 0.3, (600, 2)) for k in range(10)]
    shown = [camera.contains(one) for one in seen]
    both = {(k, k + gap): np.flatnonzero(shown[k] & shown[k + gap]) for gap in (1, 2, 3) for k in range(10 - gap)}
    pairs = [VerifiedPair(*pair, np.column_stack([some, some]), np.eye(3)) for pair, some in both.items()]
    assert not only_turned(pairs, seen, camera, is_given=True)
    assert only_turned(pairs, seen, _STRAIGHT, is_given=False) == (camera is _STRAIGHT)


def test_a_step_is_enough() -> None:
    """Standing for most of a walk is not standing."""
    standing, seen = _walk(0.0)
    walking, more = _walk(0.2)
    later = [VerifiedPair(pair.first + 10, pair.second + 10, pair.matches, pair.R_second_first) for pair in walking]
    assert not only_turned([*standing, *later], [*seen, *more], _STRAIGHT, is_given=False)


def test_a_lens_of_the_narrowest_view_is_judged_too() -> None:
    """A focal length that is longer yet is no camera's."""
    pairs, seen = _walk(0.1)
    narrow = replace(_STRAIGHT, fx=5000.0, fy=5000.0)
    assert not only_turned(
        pairs, [5000 / 500 * (one - [319.5, 239.5]) + [319.5, 239.5] for one in seen], narrow, is_given=False
    )


def test_no_pairs_say_nothing() -> None:
    assert not only_turned([], [], _STRAIGHT, is_given=False)


def test_a_shift_is_the_angle_left_by_the_best_rotation() -> None:
    """Of far things and a few near ones, that of the near ones is what does not fit."""
    rng = np.random.default_rng(0)
    points = rng.uniform([-200, -100, 900], [200, 100, 1000], (101, 3))
    points[:60] = rng.uniform([-1, -1, 4.9], [1, 1, 5.1], (60, 3))
    R = Rotation.from_euler("y", [[0], [5]], degrees=True).as_matrix()
    for sideways_m in (0.0, 0.05):
        seen = [_STRAIGHT.project((points - [sideways_m * k, 0, 0]) @ R[k]) for k in range(2)]
        pair = VerifiedPair(0, 1, np.tile(np.arange(101)[:, None], 2), R[1].T @ R[0])
        (found,) = shifts([pair], seen, _STRAIGHT)
        assert found < 2e-3 if sideways_m == 0 else 0 < found < 0.05 / 5
    few = VerifiedPair(0, 1, np.tile(np.arange(40, 101)[:, None], 2), R[1].T @ R[0])
    assert shifts([few], seen, _STRAIGHT)[0] < 5e-4  # forty-one of sixty-one are far
