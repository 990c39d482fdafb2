"""Several frames go in, their poses come out: over a real socket."""

import base64
import json
import math

import httpx
import numpy as np
import pytest

from rholoc.errors import InvalidCamera, InvalidDescriptors, InvalidInput
from rholoc.features import get_extractor
from rholoc.geometry import Camera
from rholoc.localization import Intrinsics
from rholoc.service.frames.queries import Frame, camera_for, feature_set, gravity_of, prior_of
from rholoc.service.frames.request_models import FeaturesIn, LocalizeOptions, PriorIn

_HERE = {"position": [0, 0, 0], "quaternion_xyzw": [0, 0, 0, 1]}
_CAMERA = {"fx": 520, "fy": 520, "cx": 319.5, "cy": 239.5}


def _features(world):
    found = get_extractor("gray").extract(world.image)
    return {
        "pixels": found.pixels.tolist(),
        "channels": ["L"] * len(found),
        "descriptors": base64.b64encode(found.descriptors.tobytes()).decode(),
    }


def _ask(service, body, **files):
    url = service.url + "/v1/maps/room/localize/frames"
    if files:
        parts = {name: (name, content, "image/png") for name, content in files.items()}
        parts["request"] = ("request.json", json.dumps(body).encode(), "application/json")
        return httpx.post(url, files=parts, timeout=30)
    return httpx.post(url, json=body, timeout=30)


def test_the_ways_to_send_them_give_the_same_poses(service, picture_world):
    picture = base64.b64encode(picture_world.png()).decode()
    size = {"width": picture_world.camera.width, "height": picture_world.camera.height}
    by_features = {**_HERE, "features": _features(picture_world), "camera": {**size, **_CAMERA}}
    answers = [
        _ask(service, {"camera": _CAMERA, "frames": [{**_HERE, "image": picture}] * 2}),
        _ask(service, {"frames": [by_features] * 2}),
        _ask(
            service,
            {"camera": _CAMERA, "frames": [_HERE, _HERE]},
            image0=picture_world.png(),
            image1=picture_world.png(),
        ),
        _ask(service, {"camera": _CAMERA, "frames": [_HERE, by_features]}, image0=picture_world.png()),
    ]
    for answer in answers:
        assert answer.status_code == 200, answer.text
        body = answer.json()
        assert body["localized"]
        assert len(body["frames"]) == 2
        assert body["frames"][0]["pose"] == body["pose"]
        assert sum(frame["inliers"] for frame in body["frames"]) == body["inliers"]
        np.testing.assert_allclose(body["pose"]["position"], picture_world.pose.position, atol=0.02)
        np.testing.assert_allclose(body["pose"]["T_map_camera"], answers[0].json()["pose"]["T_map_camera"], atol=1e-6)


def test_one_picture_has_no_frames(service, picture_world):
    answer = httpx.post(
        service.url + "/v1/maps/room/localize",
        content=picture_world.png(),
        headers={"Content-Type": "image/png"},
        timeout=30,
    )
    assert answer.json()["frames"] is None


def test_the_deadline_holds_for_all_frames(service, picture_world):
    picture = base64.b64encode(picture_world.png()).decode()
    body = _ask(service, {"frames": [{**_HERE, "image": picture}] * 2, "deadline_ms": 0.001}).json()
    assert (body["localized"], body["reason"]) == (False, "deadline")


@pytest.mark.parametrize("count", [0, 1, 11])
def test_too_few_or_too_many_frames(service, picture_world, count):
    answer = _ask(service, {"frames": [{**_HERE, "image": "AAAA"}] * count})
    assert answer.status_code == 422
    assert answer.json()["code"] == "invalid_input"
    assert answer.json()["message"].startswith(f"{count} frames")


@pytest.mark.parametrize("quaternion", [[0, 0, 0, 0], [1, 1, 1, 1], [0, 0, 0, 2]])
def test_relative_poses_that_are_no_rotations(service, picture_world, quaternion):
    frame = {**_HERE, "features": _features(picture_world), "camera": {"width": 640, "height": 480}}
    answer = _ask(service, {"frames": [frame, {**frame, "quaternion_xyzw": quaternion}]})
    assert (answer.status_code, answer.json()["code"]) == (422, "invalid_input")
    assert "frame 1" in answer.json()["message"]


@pytest.mark.parametrize(
    ("frame", "code"),
    [
        ({}, "invalid_input"),
        ({"image": "AAAA", "features": {"pixels": [], "descriptors": []}}, "invalid_input"),
        ({"image": "not base64!"}, "invalid_image"),
        ({"image": "AAAA"}, "invalid_image"),
        ({"features": {"pixels": [[1, 2]], "descriptors": ["ab"]}}, "invalid_descriptors"),
    ],
)
def test_a_frame_that_is_none(service, frame, code):
    sized = {**_HERE, "camera": {"width": 640, "height": 480}, **frame}
    answer = _ask(service, {"frames": [sized, sized]})
    assert answer.json()["code"] == code


def test_the_features_of_another_map_are_refused(service, picture_world):
    own = {**_HERE, "features": _features(picture_world), "camera": {"width": 640, "height": 480}}
    other = {**own, "features": {"pixels": [[1, 2]], "channels": ["L"], "descriptors": ["ab" * 48]}}
    answer = _ask(service, {"frames": [own, other]})
    assert answer.json()["code"] == "invalid_descriptors"


@pytest.mark.parametrize("sigma", [{"sigma_m": 0.0}, {"sigma_deg": -1.0}])
def test_an_uncertainty_must_be_positive(service, picture_world, sigma):
    own = {**_HERE, "features": _features(picture_world), "camera": {"width": 640, "height": 480}}
    answer = _ask(service, {"frames": [own, own], **sigma})
    assert answer.json()["code"] == "invalid_input"


def test_a_picture_without_its_frame(service, picture_world):
    answer = _ask(service, {"frames": [_HERE, _HERE]}, image0=picture_world.png(), image7=picture_world.png())
    assert answer.json()["code"] == "invalid_input"
    assert "image7" in answer.json()["message"]


def test_places_are_the_views_that_a_picture_is_like(service, picture_world):
    def find(body=None, **params):
        sent = {"content": picture_world.png()} if body is None else {"content": json.dumps(body).encode()}
        kind = "image/png" if body is None else "application/json"
        return httpx.post(service.url + "/v1/places", params=params, headers={"Content-Type": kind}, timeout=30, **sent)

    found = find(maps="all", limit=100).json()["places"]
    assert {place["map"] for place in found} == {"room", "loose"}
    assert [place["score"] for place in found] == sorted((place["score"] for place in found), reverse=True)
    assert len(find(maps="room", limit=1).json()["places"]) == 1
    own = {"features": _features(picture_world), "camera": {"width": 640, "height": 480}}
    assert find(own, maps="room").json() == find(maps="room").json()
    assert find(maps="attic").json()["code"] == "unknown_map"
    assert find(maps="room", limit=0).status_code == 422
    assert find({"frames": [_HERE, _HERE]}, maps="room").json()["code"] == "invalid_request"


@pytest.mark.parametrize("broken", [b"", b"no picture", "half"])
def test_a_broken_picture_is_named_by_its_frame(service, picture_world, broken):
    png = picture_world.png()
    files = {"image0": png, "image1": png[: len(png) // 2] if broken == "half" else broken}
    answer = _ask(service, {"camera": _CAMERA, "frames": [_HERE, _HERE]}, **files)
    assert answer.status_code == 422
    error = answer.json()
    assert error["code"] == "invalid_image"
    assert error["message"].startswith("Frame 1: ")


def test_a_relative_pose_that_pictures_contradict_has_no_answer(service, picture_world):
    picture = base64.b64encode(picture_world.png()).decode()
    aside = {"position": [0, 1, 0], "quaternion_xyzw": [0, 0, 0, 1]}
    frames = [{**one, "image": picture} for one in (_HERE, _HERE, aside)]
    body = _ask(service, {"camera": _CAMERA, "frames": frames}).json()
    assert (body["localized"], body["reason"]) == (False, "not_recognized")
    assert body["diagnosis"]["cause"] == "wrong_motion"
    assert [frame["pose"] for frame in body["frames"]] == [None] * 3


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
    for alone in ({"fy": 500.0}, {"cx": 310.0}, {"cy": 230.0}):
        with pytest.raises(InvalidCamera, match="no fx"):
            camera_for(frame_by(**alone), (640, 480), MAP_CAMERA)


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
