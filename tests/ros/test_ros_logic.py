"""The node's plain logic: frames, odometry, corrections, cameras, pictures."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from played_robot import transform
from ros_messages import message_class
from scipy.spatial.transform import Rotation, Slerp

from rholoc.geometry import Camera, Lens
from rholoc_ros.correction import Correction, CorrectionLimits
from rholoc_ros.geometry import base_covariance, interpolated, map_to_odom, planar
from rholoc_ros.messages import pose_of, set_stamp, stamp_ns
from rholoc_ros.odometry import OdometryBuffer
from rholoc_ros.pictures import camera_of, compressed_picture_of, picture_of
from rholoc_ros.settings import DEFAULTS, Settings

LIMITS = CorrectionLimits(speed_m_s=0.2, turn_deg_s=10.0, lag_m=0.5, lag_deg=15.0, pause_s=0.3)
numbers = st.floats(-10, 10)
transforms = st.builds(
    lambda xyz, turn: transform(xyz, Rotation.from_rotvec(turn)),
    st.tuples(numbers, numbers, numbers),
    st.tuples(*[st.floats(-1.7, 1.7)] * 3),
)


@given(transforms, transforms)
def test_map_to_odom_with_odometry_is_the_base_in_the_map(T_map_base, T_odom_base):
    np.testing.assert_allclose(map_to_odom(T_map_base, T_odom_base) @ T_odom_base, T_map_base, atol=1e-9)


@given(transforms)
def test_planar_keeps_place_and_yaw(T):
    flat = planar(T)
    np.testing.assert_allclose(flat[:3, 3], [T[0, 3], T[1, 3], 0])
    np.testing.assert_allclose(planar(flat), flat, atol=1e-12)
    assert flat[2, 2] == pytest.approx(1)


@given(transforms, transforms, st.floats(0, 1))
def test_poses_in_between_turn_as_scipys(before, after, share):
    turns = Slerp([0, 1], Rotation.from_matrix([before[:3, :3], after[:3, :3]]))
    apart = Rotation.from_matrix(before[:3, :3].T @ after[:3, :3]).magnitude()
    found = interpolated(before, after, share)
    if apart < 3.1:  # beyond half a turn there are two ways
        np.testing.assert_allclose(found[:3, :3], turns(share).as_matrix(), atol=1e-6)
    np.testing.assert_allclose(found[:3, 3], (1 - share) * before[:3, 3] + share * after[:3, 3], atol=1e-9)


def test_a_bases_covariance_is_that_of_samples():
    """Finite differences: small motions of the camera about the map's axes, as the base has them."""
    rng = np.random.default_rng(0)
    A = rng.normal(size=(6, 6)) * [[0.02]] * 3 + rng.normal(size=(6, 6)) * 0.1
    degrees = A @ A.T
    T_map_camera = transform([1, 2, 3], Rotation.random(random_state=1))
    T_camera_base = transform([0.3, -0.5, 0.2], Rotation.random(random_state=2))
    T_map_base = T_map_camera @ T_camera_base
    scale = np.diag([1, 1, 1, *[np.pi / 180] * 3])
    J = np.zeros((6, 6))
    for i, step in enumerate(np.eye(6) * 1e-6):
        moved = transform(T_map_camera[:3, 3] + step[:3], Rotation.from_rotvec(step[3:])) @ np.eye(4)
        moved[:3, :3] = moved[:3, :3] @ T_map_camera[:3, :3]
        base = moved @ T_camera_base
        J[:3, i] = (base - T_map_base)[:3, 3] / 1e-6
        J[3:, i] = Rotation.from_matrix(base[:3, :3] @ T_map_base[:3, :3].T).as_rotvec() / 1e-6
    expected = J @ scale @ degrees @ scale @ J.T
    found = base_covariance(tuple(map(tuple, degrees)), T_map_camera, T_map_base)
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_odometry_is_known_between_messages_and_not_beyond():
    buffer = OdometryBuffer()
    assert buffer.at(0) is None
    for i in range(3):
        buffer.add(i * 100_000_000, transform([i, 0, 0], Rotation.identity()))
    assert buffer.at(50_000_000)[0, 3] == pytest.approx(0.5)
    assert buffer.at(200_000_000)[0, 3] == 2
    assert buffer.at(-1) is None
    assert buffer.at(200_000_001) is None
    buffer.add(900_000_000, np.eye(4))
    assert buffer.at(500_000_000) is None  # in a gap
    buffer.add(0, np.eye(4))
    assert buffer.at(900_000_000) is None  # the clock went back


@given(st.lists(transforms, min_size=2, max_size=8), transforms)
def test_the_broadcast_moves_the_robot_no_faster_than_the_bound(targets, T_odom_base):
    correction, before = Correction(LIMITS), None
    for i, target in enumerate(targets):
        for k in range(20):
            sent = correction.step(i + k / 20, target, T_odom_base)
            if sent is not None and before is not None:
                motion = sent @ T_odom_base @ np.linalg.inv(before @ T_odom_base)
                moved = np.linalg.norm((sent @ T_odom_base - before @ T_odom_base)[:3, 3])
                assert moved <= 0.2 / 20 + 1e-9
                assert np.degrees(Rotation.from_matrix(motion[:3, :3]).magnitude()) <= 10 / 20 + 1e-6
            before = sent


def test_a_correction_arrives_and_a_large_one_is_a_pause():
    correction = Correction(LIMITS)
    near, far = transform([0.1, 0, 0], Rotation.identity()), transform([5, 0, 0], Rotation.identity())
    assert correction.step(0.0, np.eye(4), np.eye(4)) is not None
    assert correction.step(0.1, near, np.eye(4))[0, 3] == pytest.approx(0.02)
    assert correction.step(1.0, near, np.eye(4))[0, 3] == pytest.approx(0.1)
    assert correction.step(1.1, far, np.eye(4)) is None
    assert correction.step(1.2, far, np.eye(4)) is None  # what was sent is still valid
    assert correction.step(1.4, far, np.eye(4))[0, 3] == 5
    assert correction.step(1.5, None, np.eye(4)) is None


def info(**fields):
    message = message_class("sensor_msgs/msg/CameraInfo")()
    message.k = [520.0, 0, 322.0, 0, 510.0, 238.0, 0, 0, 1]
    message.width, message.height, message.distortion_model = 640, 480, "plumb_bob"
    vars(message).update(fields)
    return message


@pytest.mark.parametrize(
    ("model", "d"),
    [
        ("plumb_bob", [0.1, -0.05, 0.001, -0.002, 0.01]),
        ("rational_polynomial", [0.1, -0.05, 0.001, -0.002, 0.01, 0.02, 0.003, 0.001]),
        ("equidistant", [0.02, -0.01, 0.003, -0.001]),
    ],
)
def test_cameras_see_points_where_opencv_does(model, d):
    """By the service's own camera model, from the values that are sent to it."""
    message = info(distortion_model=model, d=d)
    sent = camera_of(message)
    camera = Camera(640, 480, sent.fx, sent.fy, sent.cx, sent.cy, sent.distortion, Lens(sent.lens))
    pixels = np.array([[100.0, 80.0], [320.0, 240.0], [560.0, 400.0]])
    points = 3 * camera.rays(pixels)
    K, zero = np.reshape(message.k, (3, 3)), np.zeros(3)
    if model == "equidistant":
        found, _ = cv2.fisheye.projectPoints(points[:, None], zero, zero, K, np.array(d))
    else:
        found, _ = cv2.projectPoints(points, zero, zero, K, np.array(d))
    np.testing.assert_allclose(found[:, 0] if found.shape[1] == 1 else found[0], pixels, atol=1e-3)


def test_binning_and_region_of_interest_are_applied():
    roi = SimpleNamespace(x_offset=100, y_offset=40, width=320, height=240)
    camera = camera_of(info(binning_x=2, binning_y=2, roi=roi))
    assert (camera.width, camera.height, camera.fx, camera.distortion) == (160, 120, 260, ())
    # The centre of the region's first 2×2 pixels, at (100.5, 40.5), is the centre of pixel (0, 0).
    assert (0 - camera.cx) / camera.fx == pytest.approx((100.5 - 322) / 520)


def test_rectified_pictures_have_the_camera_of_p():
    p = [500.0, 0, 320.0, 0, 0, 500.0, 240.0, 0, 0, 0, 1, 0]
    camera = camera_of(info(p=p, d=[0.1] * 5), rectified=True)
    assert (camera.fx, camera.cx, camera.distortion) == (500, 320, ())


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"k": [0.0] * 9}, "not calibrated"),
        ({"k": [520.0, 3.0, 322.0, 0, 510.0, 238.0, 0, 0, 1]}, "skew"),
        ({"distortion_model": "division", "d": [0.1]}, "not supported"),
        ({"d": [0.1] * 3}, "3 coefficients"),
        ({"distortion_model": "equidistant", "d": [0.1] * 5}, "5 coefficients"),
        ({"distortion_model": "rational_polynomial", "d": [0.1] * 12}, "at most 8"),
    ],
)
def test_cameras_that_are_not_known_are_refused(fields, message):
    with pytest.raises(ValueError, match=message):
        camera_of(info(**fields))


def image(encoding, pixels, padding=3):
    """A message whose rows are padded."""
    rows = pixels.reshape(len(pixels), -1)
    data = np.pad(rows, ((0, 0), (0, padding))).tobytes()
    height, width = pixels.shape[:2]
    return SimpleNamespace(encoding=encoding, height=height, width=width, step=rows.shape[1] + padding, data=data)


def test_pictures_of_every_encoding_are_the_same():
    bgr = np.full((8, 10, 3), (40, 120, 200), np.uint8)
    grey = cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY)
    np.testing.assert_array_equal(picture_of(image("bgr8", bgr)), bgr)
    np.testing.assert_array_equal(picture_of(image("rgb8", bgr[:, :, ::-1])), bgr)
    np.testing.assert_array_equal(picture_of(image("mono8", grey)), grey)
    np.testing.assert_array_equal(picture_of(image("rgba8", cv2.cvtColor(bgr, cv2.COLOR_BGR2RGBA))), bgr)
    mosaic = bgr[:, :, 1].copy()
    mosaic[::2, ::2], mosaic[1::2, 1::2] = 200, 40  # red first
    np.testing.assert_array_equal(picture_of(image("bayer_rggb8", mosaic)), bgr)
    half = np.full((8, 10), 16 + 219 / 2, np.uint8)  # video's range
    for encoding, planes in (
        ("uyvy", (np.full_like(half, 128), half)),
        ("yuv422_yuy2", (half, np.full_like(half, 128))),
    ):
        np.testing.assert_allclose(picture_of(image(encoding, np.stack(planes, axis=2))), 127, atol=2)


def test_pictures_that_are_none_are_refused():
    grey = np.zeros((8, 10), np.uint8)
    with pytest.raises(ValueError, match="not supported"):
        picture_of(image("32FC1", grey))
    short = image("mono8", grey)
    short.data = short.data[:-20]
    with pytest.raises(ValueError, match="only"):
        picture_of(short)
    with pytest.raises(ValueError, match="JPEG or PNG"):
        compressed_picture_of(SimpleNamespace(format="compressedDepth", data=b"\0" * 20))


@given(st.integers(0, 2**31 * 10**9 - 1))
def test_stamps_keep_their_nanoseconds(nanoseconds):
    stamp = message_class("builtin_interfaces/msg/Time")()
    set_stamp(stamp, nanoseconds)
    assert stamp_ns(stamp) == nanoseconds


def test_a_pose_without_rotation_is_refused():
    with pytest.raises(ValueError, match="quaternion"):
        pose_of(message_class("geometry_msgs/msg/Pose")())


def test_whole_numbers_are_taken_for_floats():
    settings = Settings.of({**DEFAULTS, "map_name": "room", "tf_rate_hz": 30})
    assert settings.tf_rate_hz == 30.0
    assert settings.limits.pause_s == settings.transform_tolerance_s
    assert settings.track_options.lost_m == settings.lost_m
