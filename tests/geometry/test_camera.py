"""Cameras: round trips, and what is refused; lenses: rays and pixels of each model, against OpenCV's and COLMAP's."""

import json

import cv2
import numpy as np
import pycolmap
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rholoc.errors import InvalidCamera
from rholoc.geometry import Camera, FloatArray, Lens, angles_between, is_rotation
from rholoc.geometry.lenses import widest_angle

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


T265 = Camera(848, 800, 284.468, 285.51, 424.355, 393.742, (0.0008, 0.031, -0.03, 0.005), Lens.FISHEYE)
PANORAMA = Camera.panorama(2000, 1000)
WIDE = (T265, Camera(800, 800, 254.0, 254.0, 399.5, 399.5, lens=Lens.FISHEYE), PANORAMA)


def _ids(camera: Camera) -> str:
    return f"{camera.lens}-{len(camera.distortion)}"


@pytest.mark.parametrize("camera", WIDE, ids=_ids)
@settings(deadline=None)
@given(u=st.floats(0, 1), v=st.floats(0, 1), distance=st.floats(0.1, 50))
def test_rays_of_any_lens_project_back_to_their_pixels(camera: Camera, u: float, v: float, distance: float) -> None:
    pixel = np.array([[u * (camera.width - 1), v * (camera.height - 1)]])
    rays = camera.rays(pixel)
    assert np.linalg.norm(rays) == pytest.approx(1)
    np.testing.assert_allclose(camera.project(rays * distance), pixel, atol=1e-6)


def test_a_fisheye_is_opencvs() -> None:
    points = np.random.default_rng(0).uniform((-3, -3, 0.2), (3, 3, 4), (200, 3))
    expected, _ = cv2.fisheye.projectPoints(
        points[:, None], np.zeros(3), np.zeros(3), T265.matrix, np.array(T265.distortion)
    )
    np.testing.assert_allclose(T265.project(points), expected[:, 0], atol=1e-9)


def test_a_panorama_is_colmaps() -> None:
    theirs = pycolmap.Camera.create_from_model_name(1, "EQUIRECTANGULAR", PANORAMA.focal, 2000, 1000)
    pixels = np.random.default_rng(0).uniform((0, 0), (1999, 999), (500, 2))
    np.testing.assert_allclose(PANORAMA.rays(pixels), theirs.cam_ray_from_img(pixels + 0.5), atol=1e-12)
    np.testing.assert_allclose(
        PANORAMA.rays(np.array([[999.5, 499.5], [1499.5, 499.5]])), [[0, 0, 1], [1, 0, 0]], atol=1e-12
    )


@pytest.mark.parametrize("camera", [*WIDE, Camera(640, 480, 500.0, 510.0, 320.0, 240.0)], ids=_ids)
def test_slopes_are_those_of_the_projection(camera: Camera) -> None:
    points = np.random.default_rng(1).normal(size=(400, 3))
    points = points[(np.linalg.norm(points, axis=1) > 0.3) & (points[:, 2] > -0.9 * np.linalg.norm(points, axis=1))]
    if camera.lens is Lens.PINHOLE:
        points = points[points[:, 2] > 0.1]
    steps = 1e-6 * np.eye(3)
    numeric = np.stack(
        [(camera.project(points + step) - camera.project(points - step)) / 2e-6 for step in steps], axis=2
    )
    near_seam = np.abs(numeric).max(axis=(1, 2)) > 1e6  # of a panorama, whose left edge is its right
    scale = np.abs(numeric).max(axis=(1, 2), keepdims=True)
    np.testing.assert_allclose((camera.slopes(points) / scale)[~near_seam], (numeric / scale)[~near_seam], atol=1e-6)
    assert near_seam.sum() < 3


def test_on_the_axis_a_pixel_is_a_radian_by_the_focal_length() -> None:
    ahead = np.array([[0.0, 0.0, 2.0]])
    for camera in WIDE:
        np.testing.assert_allclose(camera.project(ahead), [[camera.cx, camera.cy]])
        np.testing.assert_allclose(2 * camera.slopes(ahead)[0], [[camera.fx, 0, 0], [0, camera.fy, 0]], atol=1e-9)


def test_what_a_lens_does_not_show_has_no_pixel() -> None:
    behind, nowhere, aside = np.array([[0.0, 0.0, -1.0]]), np.zeros((1, 3)), np.array([[1.0, 0.2, -0.4]])
    assert np.isnan(T265.project(np.concatenate([behind, nowhere]))).all()
    assert np.isnan(PANORAMA.project(nowhere)).all()
    assert np.isfinite(T265.project(aside)).all()  # 112° off the axis
    assert PANORAMA.contains(PANORAMA.project(np.concatenate([behind, aside]))).all()
    narrowing = Camera(800, 800, 300.0, 300.0, 400.0, 400.0, (-0.1, 0.0, 0.0, 0.0), Lens.FISHEYE)
    assert widest_angle(narrowing.distortion) == pytest.approx(np.sqrt(1 / 0.3))
    assert np.isnan(narrowing.project(aside)).all()
    outside = narrowing.rays(np.array([[0.0, 0.0]]))
    off_axis = angles_between(outside, np.array([0.0, 0.0, 1.0]))[0]
    assert off_axis == pytest.approx(widest_angle(narrowing.distortion), abs=1e-4)


def test_depth_is_what_a_size_in_pixels_is_divided_by() -> None:
    point, step = np.array([[0.6, 0.3, 1.5]]), 1e-4
    for camera in WIDE[1:]:
        up = point + step * np.array([[0.0, 1.0, 0.0]])
        size_px = float(np.linalg.norm(camera.project(up) - camera.project(point)))
        assert size_px == pytest.approx(camera.focal * step / camera.depths(point)[0], rel=0.2)
    assert Camera(640, 480, 500.0, 500.0, 320.0, 240.0).depths(point)[0] == 1.5


@pytest.mark.parametrize("camera", [*WIDE, Camera(640, 480, 500.0, 510.0, 320.0, 240.0)], ids=_ids)
def test_pixels_lie_on_the_planes_that_they_are_measured_in(camera: Camera) -> None:
    pixels = np.random.default_rng(2).uniform((0, 0), (camera.width - 1, camera.height - 1), (50, 2))
    R_plane_camera, places = camera.planes(pixels)
    rays = np.column_stack([places, np.ones(50)])
    seen = np.einsum("nji,nj->ni", R_plane_camera, rays / np.linalg.norm(rays, axis=1, keepdims=True))
    np.testing.assert_allclose(seen, camera.rays(pixels), atol=1e-12)
    assert all(is_rotation(R, 1e-9) for R in R_plane_camera)


@pytest.mark.parametrize("camera", WIDE, ids=_ids)
def test_what_is_written_of_a_lens_reads_back_the_same(camera: Camera) -> None:
    assert Camera.from_line(camera.to_line()) == camera
    assert Camera.from_dict(json.loads(json.dumps(camera.to_dict()))) == camera
    assert Camera.parse(camera.to_text(), camera.width, camera.height) == camera


def test_a_pinhole_is_written_as_ever() -> None:
    camera = Camera(640, 480, 500.0, 510.0, 320.0, 240.0)
    assert "lens" not in camera.to_dict()
    assert camera.to_line() == "640 480 500.0 510.0 320.0 240.0"


def test_of_a_whole_panorama_its_size_is_enough() -> None:
    assert Camera.parse("equirectangular", 2000, 1000) == PANORAMA
    assert Camera.from_dict({"width": 2000, "height": 1000, "lens": "equirectangular"}) == PANORAMA


@pytest.mark.parametrize(
    ("width", "parameters", "lens"),
    [
        (800, (100.0, 100.0, 400.0, 400.0), Lens.FISHEYE),  # 458° across
        (800, (300.0, 300.0, 400.0, 400.0, 0.1), Lens.FISHEYE),
        (800, (300.0, 300.0, 400.0, 400.0, -50.0, 0.0, 0.0, 0.0), Lens.FISHEYE),
        (800, (100.0, 300.0, 400.0, 400.0), Lens.EQUIRECTANGULAR),
        (800, (300.0, 300.0, 400.0, 400.0, 0.1, 0.1, 0.1, 0.1), Lens.EQUIRECTANGULAR),
    ],
)
def test_impossible_lenses_are_refused_with_advice(width: int, parameters: tuple[float, ...], lens: Lens) -> None:
    with pytest.raises(InvalidCamera) as refused:
        Camera(width, 800, *parameters[:4], parameters[4:], lens)
    assert refused.value.hint


def test_points_in_the_field_of_view_are_shown() -> None:
    points = np.random.default_rng(3).normal(size=(4, 100, 3))
    shown = T265.shows(points)
    assert shown.shape == (4, 100)
    expected: FloatArray = T265.contains(T265.project(points.reshape(-1, 3)))
    np.testing.assert_array_equal(shown.ravel(), expected)
    assert PANORAMA.shows(points).all()


@pytest.mark.parametrize("quarters", [0, 1, 2, 3])
@pytest.mark.parametrize("lens", [Lens.PINHOLE, Lens.FISHEYE])
def test_the_camera_of_a_turned_image(lens: Lens, quarters: int) -> None:
    camera = Camera(64, 48, 60, 61, 30, 20, (0.1, -0.05, 0.01, 0.02), lens)
    points = np.array([[0.3, 0.1, 1.0], [-0.2, 0.2, 1.5]])
    turned = camera.turned(quarters)
    c, s = [(1, 0), (0, 1), (-1, 0), (0, -1)][quarters]  # clockwise in the image, whose v points down
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    centre, turned_centre = np.array([31.5, 23.5]), np.array([turned.width - 1, turned.height - 1]) / 2
    expected = (camera.project(points) - centre) @ R[:2, :2].T + turned_centre
    np.testing.assert_allclose(turned.project(points @ R.T), expected, atol=1e-9)
    assert turned.turned(4 - quarters) == camera
