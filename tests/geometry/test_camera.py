"""Cameras: round trips, and what is refused."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rholoc.errors import InvalidCamera
from rholoc.geometry import Camera

DISTORTED = Camera(640, 480, 500.0, 510.0, 322.0, 238.0, (-0.28, 0.07, 0.0002, 0.00002))


@pytest.mark.parametrize("camera", [DISTORTED, Camera(640, 480, 525.0, 525.0, 320.0, 240.0)])
@given(u=st.floats(0, 639), v=st.floats(0, 479), depth=st.floats(0.1, 50))
def test_rays_project_back_to_their_pixels(camera: Camera, u: float, v: float, depth: float) -> None:
    rays = camera.rays(np.array([[u, v]]))
    assert np.linalg.norm(rays) == pytest.approx(1)
    assert camera.project(rays * depth)[0] == pytest.approx((u, v), abs=1e-6)


def test_projection_is_opencvs() -> None:
    points = np.random.default_rng(0).uniform((-1, -1, 1), (1, 1, 4), (50, 3))
    expected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), DISTORTED.matrix, np.array(DISTORTED.distortion))
    np.testing.assert_allclose(DISTORTED.project(points), expected[:, 0], atol=1e-9)


@pytest.mark.parametrize("camera", [DISTORTED, Camera(640, 480, 525.0, 525.0, 320.0, 240.0)])
def test_what_is_written_of_a_camera_reads_back_the_same(camera: Camera) -> None:
    assert Camera.from_line(camera.to_line()) == camera
    assert Camera.from_dict(json.loads(json.dumps(camera.to_dict()))) == camera
    assert Camera.parse(",".join(map(repr, camera.parameters)), camera.width, camera.height) == camera


@pytest.mark.parametrize("text", ["", "640 480 525 525 320", "640.5 480 525 525 320 240", "640 480 525 525 320 x"])
def test_a_line_that_is_not_a_camera_is_refused(text: str) -> None:
    with pytest.raises(ValueError):
        Camera.from_line(text)


def test_points_behind_have_no_pixel() -> None:
    pixels = DISTORTED.project(np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]))
    assert np.isnan(pixels[0]).all()
    assert list(DISTORTED.contains(pixels)) == [False, True]


def test_resizing_keeps_the_rays_of_corresponding_points() -> None:
    camera = Camera(640, 480, 500.0, 510.0, 322.0, 238.0)
    half = camera.resized(320, 240)
    # the centre of a half-size pixel is the common corner of four full-size ones
    np.testing.assert_allclose(half.rays(np.array([[10.0, 20.0]])), camera.rays(np.array([[20.5, 40.5]])), atol=1e-12)


def test_parse_reads_distortion() -> None:
    camera = Camera.parse("525.5,525.5,320,240,-0.1,0.01,0,0", 640, 480)
    assert (camera.fx, camera.cy, camera.distortion) == (525.5, 240, (-0.1, 0.01, 0.0, 0.0))


@pytest.mark.parametrize(
    "text",
    ["", "a,b,c,d", "500,500,320", "nan,500,320,240", "inf,500,320,240", "-500,500,320,240", "1,500,320,240",
     "900000,500,320,240", "500,500,5000,240", "500,500,320,240,0.1"],
)  # fmt: skip
def test_absurd_cameras_are_refused_with_advice(text: str) -> None:
    with pytest.raises(InvalidCamera) as refused:
        Camera.parse(text, 640, 480)
    assert refused.value.hint


def test_a_camera_comes_back_from_its_dict() -> None:
    camera = Camera(640, 480, 520.0, 521.0, 319.5, 239.5, (0.1, -0.05, 0.001, 0.0))
    assert Camera.from_dict(json.loads(json.dumps(camera.to_dict()))) == camera
    assert Camera.parse(",".join(map(repr, camera.parameters)), 640, 480) == camera
    with pytest.raises(KeyError):
        Camera.from_dict({"width": 640, "height": 480})
    with pytest.raises(InvalidCamera):
        Camera.from_dict(camera.to_dict() | {"fx": -1})
