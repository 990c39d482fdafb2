"""Intrinsics, priors and descriptor sets, as requests give them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rholoc.errors import InvalidCamera, InvalidDescriptors, InvalidInput
from rholoc.features import get_extractor
from rholoc.geometry import Camera
from rholoc.localization import Intrinsics
from rholoc.service.frames.queries import Frame, camera_for, feature_set, gravity_of, prior_of
from rholoc.service.frames.requests import FeaturesIn, LocalizeOptions, PriorIn

MAP_CAMERA = Camera(640, 480, 520.0, 521.0, 318.0, 241.0, (0.1, -0.1, 0.0, 0.0))


def frame_by(**camera) -> Frame:
    return Frame(LocalizeOptions(camera=camera))


def test_the_maps_own_camera_serves_pictures_of_its_shape():
    assert camera_for(frame_by(), (640, 480), MAP_CAMERA) == MAP_CAMERA
    assert camera_for(frame_by(), (1280, 960), MAP_CAMERA) == MAP_CAMERA.resized(1280, 960)
    for size in ((480, 640), (640, 360), (0, 0), (-640, -480)):
        with pytest.raises(InvalidCamera):
            camera_for(frame_by(), size, MAP_CAMERA)


def test_given_intrinsics_win_and_are_scaled_to_the_picture():
    given = frame_by(width=1920, height=1080, fx=1500.0, fy=1510.0, cx=950.0, cy=530.0, distortion=[0.1, 0, 0, 0])
    full = Camera(1920, 1080, 1500.0, 1510.0, 950.0, 530.0, (0.1, 0.0, 0.0, 0.0))
    assert camera_for(given, (1920, 1080), MAP_CAMERA) == full
    assert camera_for(given, (960, 540), MAP_CAMERA) == full.resized(960, 540)
    with pytest.raises(InvalidCamera, match="1920×1080"):
        camera_for(given, (640, 480), MAP_CAMERA)


def test_only_fx_must_be_given():
    assert camera_for(frame_by(fx=500.0), (641, 481), MAP_CAMERA) == Camera(641, 481, 500.0, 500.0, 320.0, 240.0)


def test_unknown_intrinsics_are_a_guess_about_the_images_middle():
    unknown = Frame(LocalizeOptions(intrinsics=Intrinsics.UNKNOWN))
    guess = camera_for(unknown, (640, 480), MAP_CAMERA)
    assert (guess.cx, guess.cy) == (319.5, 239.5)
    assert guess.fx == guess.fy == pytest.approx(512)
    with pytest.raises(InvalidCamera, match="both given and unknown"):
        camera_for(Frame(LocalizeOptions(intrinsics=Intrinsics.UNKNOWN, camera={"fx": 500.0})), (640, 480), MAP_CAMERA)


def test_a_prior_is_a_heading_or_a_quaternion():
    by_heading = prior_of(PriorIn(position=[1, 2, 3], heading=[0, 2, 0], radius_deg=90))
    np.testing.assert_allclose(by_heading.pose.heading, [0, 1, 0], atol=1e-12)
    assert by_heading.radius_rad == pytest.approx(math.pi / 2)
    quaternion = by_heading.pose.quaternion_xyzw.tolist()
    by_quaternion = prior_of(PriorIn(position=[1, 2, 3], quaternion_xyzw=quaternion))
    np.testing.assert_allclose(by_quaternion.pose.T_map_camera, by_heading.pose.T_map_camera, atol=1e-12)
    assert prior_of(None) is None
    with pytest.raises(InvalidInput):
        prior_of(PriorIn(position=[1, 2, 3]))
    with pytest.raises(InvalidInput):
        prior_of(PriorIn(position=[1, 2, 3], heading=[1, 0, 0], quaternion_xyzw=[0, 0, 0, 1]))


def test_gravity_is_a_direction():
    np.testing.assert_allclose(gravity_of([0, 9.81, 0]), [0, 1, 0])
    assert gravity_of(None) is None


def test_channels_are_names_or_numbers():
    extractor = get_extractor("lab3")
    given = FeaturesIn(pixels=[(1, 2)] * 3, descriptors=["00" * 32] * 3, channels=["A", 2, "L"])
    assert feature_set(given, extractor, 10).channels.tolist() == [1, 2, 0]
    with pytest.raises(InvalidDescriptors, match="channels"):
        feature_set(FeaturesIn(pixels=[(1, 2)], descriptors=["00" * 32]), extractor, 10)


def test_what_is_unknown_of_a_feature_is_marked_so():
    found = feature_set(FeaturesIn(pixels=[(1, 2)], descriptors=["0f" * 32]), get_extractor("gray"), 10)
    assert found.sizes.tolist() == [0]
    assert np.isnan(found.angles).all()
    assert found.descriptors.tolist() == [[15] * 32]


def test_sizes_and_angles_that_are_not_known():
    extractor = get_extractor("gray")
    given = {"pixels": [(1.0, 2.0)] * 3, "descriptors": ["ab" * 32] * 3}
    known = feature_set(FeaturesIn(**given, sizes_px=[31.0, 0.0, 5.0], angles_deg=[90.0, None, -45.0]), extractor, 10)
    np.testing.assert_array_equal(known.sizes, [31, 0, 5])
    np.testing.assert_allclose(known.angles, np.radians([90, np.nan, 315]), rtol=1e-6)
    unknown = feature_set(FeaturesIn(**given), extractor, 10)
    assert (unknown.sizes == 0).all()
    assert np.isnan(unknown.angles).all()


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"sizes_px": [1.0]}, "1 sizes_px for 2 pixels"),
        ({"sizes_px": [1.0, math.nan]}, "size is not a finite number"),
        ({"sizes_px": [1.0, -1.0]}, "size is negative"),
        ({"angles_deg": [1.0]}, "1 angles_deg for 2 pixels"),
        ({"angles_deg": [1.0, math.inf]}, "angle is not a finite number"),
    ],
)
def test_sizes_and_angles_without_sense(wrong, message):
    given = FeaturesIn(pixels=[(1.0, 2.0)] * 2, descriptors=["ab" * 32] * 2, **wrong)
    with pytest.raises(InvalidDescriptors, match=message):
        feature_set(given, get_extractor("gray"), 10)
