"""Poses: heading, roll and quaternion say the same as the matrix."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from rholoc.geometry import (
    UP,
    Camera,
    Pose,
    angles_between,
    direction_angles,
    is_rotation,
    mean_patches,
    patch_appearance,
    patch_vectors,
    pose_distances,
    pose_matrix,
    rotation_angles,
    rotation_from_heading,
)

angles = st.floats(-3.1, 3.1)
pitches = st.floats(-1.4, 1.4)


@given(yaw=angles, pitch=pitches, roll=angles)
def test_heading_and_roll_round_trip(yaw: float, pitch: float, roll: float) -> None:
    heading = np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)])
    pose = Pose.from_heading(np.array([1.0, 2.0, 3.0]), heading, roll)
    np.testing.assert_allclose(pose.heading, heading, atol=1e-12)
    assert pose.roll == pytest.approx(roll, abs=1e-9)
    np.testing.assert_allclose(pose.R_map_camera.T @ pose.R_map_camera, np.eye(3), atol=1e-12)


@given(yaw=angles, pitch=pitches)
def test_upright_cameras_have_a_horizontal_x_axis_and_look_down_with_y(yaw: float, pitch: float) -> None:
    heading = np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)])
    R = rotation_from_heading(heading)
    assert R[2, 0] == pytest.approx(0, abs=1e-12)
    assert R[2, 1] < 0


@given(yaw=angles, pitch=pitches, roll=angles)
def test_quaternions_round_trip(yaw: float, pitch: float, roll: float) -> None:
    heading = np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)])
    pose = Pose.from_heading(np.zeros(3), heading, roll)
    again = Pose.from_quaternion(pose.position, pose.quaternion_xyzw)
    np.testing.assert_allclose(again.T_map_camera, pose.T_map_camera, atol=1e-12)
    assert pose.quaternion_xyzw[3] >= 0


def test_inverse_takes_the_position_to_the_origin() -> None:
    pose = Pose.from_heading(np.array([1.0, -2.0, 0.5]), np.array([1.0, 1.0, 0.2]), 0.3)
    np.testing.assert_allclose(pose.inverse() @ pose.T_map_camera, np.eye(4), atol=1e-12)


def test_a_vertical_heading_still_gives_a_rotation() -> None:
    R = rotation_from_heading(np.array([0.0, 0.0, 1.0]))
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)


def test_what_is_a_rotation() -> None:
    turned = Pose.from_heading(np.zeros(3), np.array([1.0, 2.0, 0.3]), roll=0.4).R_map_camera
    assert is_rotation(turned)
    assert is_rotation(turned + 1e-4)
    assert not is_rotation(turned + 0.1)
    assert is_rotation(turned + 1e-3, tolerance=1e-2)
    for wrong in (np.diag([1.0, 1, -1]), 2 * turned, 1e200 * turned, np.full((3, 3), np.nan), np.eye(4), np.zeros(0)):
        assert not is_rotation(wrong)


@given(angle=st.floats(0, np.pi), seed=st.integers(0, 1000))
def test_a_rotation_is_its_own_angle_from_what_it_turned(angle: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    R = Rotation.random(rng=rng)
    axis = rng.normal(size=3)
    turned = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)) * R
    assert rotation_angles(R.as_matrix(), turned.as_matrix()) == pytest.approx(angle, abs=1e-6)


def test_angles_of_many_rotations_keep_their_shape() -> None:
    R = Rotation.from_rotvec(np.arange(6)[:, None] * [0.0, 0.0, 0.5]).as_matrix().reshape(2, 3, 3, 3)
    np.testing.assert_allclose(rotation_angles(np.eye(3), R)[0], [0, 0.5, 1], atol=1e-9)
    assert rotation_angles(np.zeros((0, 3, 3)), np.zeros((0, 3, 3))).shape == (0,)


def test_directions_are_compared_each_with_each() -> None:
    axes = np.eye(3)
    np.testing.assert_allclose(direction_angles(axes, axes[:2])[2], [np.pi / 2, np.pi / 2])
    np.testing.assert_allclose(direction_angles(axes[:1], -axes[:1]), [[np.pi]])


def test_directions_are_compared_pair_by_pair() -> None:
    rng = np.random.default_rng(0)
    a, b = (some / np.linalg.norm(some, axis=1, keepdims=True) for some in rng.normal(size=(2, 20, 3)))
    np.testing.assert_allclose(angles_between(a, b), np.diag(direction_angles(a, b)))
    assert np.cos(angles_between(a[0], UP)) == pytest.approx(a[0, 2])
    assert angles_between(UP * (1 + 1e-9), UP) == 0
    assert angles_between(7.0 * a[0], 0.1 * b[0]) == pytest.approx(angles_between(a[0], b[0]))


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-9, 1e-4, np.pi / 2, np.pi - 1e-9])
def test_small_and_straight_angles_are_as_exact_as_others(angle: float) -> None:
    axes = Rotation.random(50, rng=np.random.default_rng(1)).as_matrix()
    a, across = axes[:, 0], axes[:, 1]
    b = np.cos(angle) * a + np.sin(angle) * across
    np.testing.assert_allclose(angles_between(a, b), angle, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(np.diag(direction_angles(a, b)), angle, rtol=1e-9, atol=1e-15)


def test_poses_are_metres_and_radians_apart() -> None:
    a = pose_matrix(np.eye(3), np.zeros(3))
    b = pose_matrix(Rotation.from_euler("y", 0.3).as_matrix(), np.array([3.0, 4.0, 0.0]))
    apart_m, turned_rad = pose_distances(a, b)
    assert (float(apart_m), float(turned_rad)) == pytest.approx((5.0, 0.3))


CAMERA = Camera(640, 480, 500.0, 540.0, 319.5, 239.5)
SQUARE = Camera(640, 480, 500.0, 500.0, 319.5, 239.5)

radians = st.floats(-np.pi, np.pi)
lengths = st.floats(0.1, 10)
offsets = st.floats(-0.5, 0.5)


def looking_down(height: float, roll: float = 0.0, at: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    """A camera at a height over the floor that looks straight down, turned by ``roll`` about its axis."""
    T = np.eye(4)
    T[:3, :3] = np.diag([1.0, -1.0, -1.0]) @ Rotation.from_euler("z", roll).as_matrix()
    T[:3, 3] = *at, height
    return T


def turned(a: float, b: float) -> float:
    return float(np.abs(np.angle(np.exp(1j * (a - b)))))


@given(
    yaw=radians,
    pitch=st.floats(-1, 1),
    roll=radians,
    angle=radians,
    size_px=st.floats(1, 200),
    depth=lengths,
)
def test_the_camera_that_saw_a_patch_sees_it_as_it_did(
    yaw: float, pitch: float, roll: float, angle: float, size_px: float, depth: float
) -> None:
    heading = np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)])
    T = Pose.from_heading(np.array([1.0, -2.0, 1.5]), heading, roll).T_map_camera
    in_camera = np.array([[0.4, -0.3, 1.0], [-0.5, 0.2, 1.0]]) * depth
    landmarks = in_camera @ T[:3, :3].T + T[:3, 3]
    vectors = patch_vectors(CAMERA, T, landmarks, np.full(2, angle), np.full(2, size_px))
    np.testing.assert_allclose(np.sum(vectors * (landmarks - T[:3, 3]), axis=1), 0, atol=1e-9 * size_px * depth)
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), size_px * depth / CAMERA.focal)
    seen, sizes_px = patch_appearance(CAMERA, T, landmarks, vectors)
    assert max(turned(one, angle) for one in seen) < 1e-7
    np.testing.assert_allclose(sizes_px, size_px)


def test_an_angle_is_the_one_of_the_projected_vector() -> None:
    T, landmark = looking_down(2.0, roll=0.3), np.array([[0.3, -0.2, 0.5]])
    step = 1e-6 * patch_vectors(CAMERA, T, landmark, np.array([1.1]), np.array([10.0]))
    ends = CAMERA.project((np.concatenate([landmark, landmark + step]) - T[:3, 3]) @ T[:3, :3])
    du, dv = ends[1] - ends[0]
    assert np.arctan2(dv, du) == pytest.approx(1.1, abs=1e-4)


@given(roll=radians, angle=radians)
def test_a_camera_rolled_clockwise_sees_a_patch_turned_the_other_way(roll: float, angle: float) -> None:
    landmark, size_px = np.array([[0.2, 0.1, 0.0]]), np.array([12.0])
    vector = patch_vectors(SQUARE, looking_down(1.5), landmark, np.array([angle]), size_px)
    seen, sizes_px = patch_appearance(SQUARE, looking_down(1.5, roll), landmark, vector)
    assert turned(seen[0], angle - roll) < 1e-7
    np.testing.assert_allclose(sizes_px, size_px)


@given(x=offsets, y=offsets, height=lengths, angle=radians)
def test_on_a_plane_that_faces_the_camera_a_patch_looks_the_same_from_elsewhere(
    x: float, y: float, height: float, angle: float
) -> None:
    landmark = np.zeros((1, 3))
    on_axis = patch_vectors(CAMERA, looking_down(1.0), landmark, np.array([angle]), np.array([20.0]))
    seen, sizes_px = patch_appearance(CAMERA, looking_down(height, at=(x, y)), landmark, on_axis)
    assert turned(seen[0], angle) < 1e-7
    np.testing.assert_allclose(sizes_px, 20.0 / height)


def test_what_is_not_known_is_nan() -> None:
    landmarks = np.array([[0, 0, 0], [0, 0, 0], [0, 0, 0], [0, 0, 5.0], [0, 0, 2.0]])
    angles_known, sizes = np.array([0.5, np.nan, 0.5, 0.5, 0.5]), np.array([9.0, 9.0, 0.0, 9.0, 9.0])
    vectors = patch_vectors(CAMERA, looking_down(2.0), landmarks, angles_known, sizes)
    np.testing.assert_array_equal(np.isfinite(vectors).all(axis=1), [True, False, False, False, False])
    np.testing.assert_array_equal(np.isnan(vectors).all(axis=1), [False, True, True, True, True])
    patches = np.array([[0.1, 0, 0], [np.nan] * 3, [0.1, 0, 0], [0.1, 0, 0], [0.1, 0, 0]])
    for seen in patch_appearance(CAMERA, looking_down(2.0), landmarks, patches):
        np.testing.assert_array_equal(np.isfinite(seen), [True, False, True, False, False])


def test_a_mean_is_of_directions_and_of_ratios() -> None:
    vectors = np.array([[0.1, 0, 0], [0, 0.4, 0], [np.nan] * 3, [0, 0, 3.0], [1.0, 0, 0], [-1.0, 0, 0]])
    means = mean_patches(vectors, np.array([0, 0, 0, 2, 3, 3]), 5)
    np.testing.assert_allclose(means[0], np.array([0.2, 0.2, 0]) / np.sqrt(2))
    np.testing.assert_allclose(means[2], [0, 0, 3])
    assert np.isnan(means[[1, 3, 4]]).all()  # never seen, seen in opposite directions, never seen
