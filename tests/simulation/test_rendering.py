"""Pictures agree with the geometry they are drawn from."""

import cv2
import numpy as np
import pytest

from rholoc.geometry import ByteArray, FloatArray, Pose
from rholoc.simulation import (
    PHONE_CAMERA,
    Light,
    Renderer,
    make_blank_wall,
    make_test_site,
    make_walk,
    render_view,
)
from rholoc.simulation.light import GAMMA, light_scene, white_point
from rholoc.simulation.scene import Box, Paint, Scene, Source
from rholoc.simulation.sensor import LONGEST_EXPOSURE_S, Exposure, develop, expose, meter

CAMERA = PHONE_CAMERA.resized(320, 240)


@pytest.fixture(scope="module")
def renderer(site: Scene) -> Renderer:
    return Renderer(site, [face.paint.albedo for face in site.faces])


def poses_at(*times: float, walk: int = 1) -> list[Pose]:
    return make_walk(walk).poses(np.array(times))


def project(pose: Pose, points: FloatArray) -> FloatArray:
    T = pose.inverse()
    return CAMERA.project(points @ T[:3, :3].T + T[:3, 3])


def cast_rays(scene: Scene, pose: Pose, pixels: FloatArray) -> FloatArray:
    """The depth (N,) along the optical axis of what pixels see, by intersecting their rays with every face."""
    rays = CAMERA.rays(pixels)
    directions = rays @ pose.R_map_camera.T
    nearest = np.full(len(pixels), np.inf)
    for face in scene.faces:
        cosine = directions @ face.normal
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = (face.origin - pose.position) @ face.normal / cosine
            points = pose.position + distance[:, None] * directions - face.origin
            a, b = points @ face.right / face.width_m**2, points @ face.down / face.height_m**2
            hit = (cosine < 0) & (distance > 0) & (a >= 0) & (a <= 1) & (b >= 0) & (b <= 1)
        nearest = np.where(hit, np.minimum(nearest, distance), nearest)
    return np.asarray(nearest * rays[:, 2])


def test_what_hides_what_agrees_with_ray_casting(site: Scene, renderer: Renderer) -> None:
    pixels = np.random.default_rng(0).integers(0, (CAMERA.width, CAMERA.height), (3000, 2))
    for pose in [*poses_at(6.0, 18.0), *poses_at(9.0, walk=2)]:
        drawn = renderer.surface(CAMERA, pose).depth[pixels[:, 1], pixels[:, 0]]
        cast = cast_rays(site, pose, pixels.astype(np.float64))
        assert np.mean(np.abs(drawn - cast) < 1e-6) > 0.998  # the rest are pixels right on an edge


def test_surface_points_project_to_their_pixels(renderer: Renderer) -> None:
    (pose,) = poses_at(13.0)
    surface = renderer.surface(CAMERA, pose)
    u, v = np.meshgrid(np.arange(CAMERA.width), np.arange(CAMERA.height))
    np.testing.assert_allclose(
        project(pose, surface.points.reshape(-1, 3)), np.column_stack([u.ravel(), v.ravel()]), atol=1e-6
    )


def test_a_point_has_the_same_colour_in_two_views(renderer: Renderer) -> None:
    first, second = poses_at(13.0, 13.6)
    surface, other = renderer.surface(CAMERA, first), renderer.surface(CAMERA, second)
    image, target = (renderer.radiance(CAMERA, [pose] * 3).astype(np.float32) for pose in (first, second))
    pixels = project(second, surface.points.reshape(-1, 3)).reshape(*surface.depth.shape, 2).astype(np.float32)
    seen = cv2.remap(target, pixels[..., 0], pixels[..., 1], cv2.INTER_LINEAR)
    T = second.inverse()
    depth = surface.points @ T[2, :3] + T[2, 3]
    visible = cv2.remap(other.depth.astype(np.float32), pixels[..., 0], pixels[..., 1], cv2.INTER_LINEAR)
    both = CAMERA.contains(pixels.reshape(-1, 2)).reshape(depth.shape) & (np.abs(visible - depth) < 0.01)
    assert both.mean() > 0.5
    difference = np.abs(seen - image).mean(axis=2)[both]
    assert np.median(difference) < 3
    shifted = np.abs(np.roll(seen, 3, axis=1) - image).mean(axis=2)[both]
    assert difference.mean() < 0.5 * shifted.mean()  # three pixels off would be noticed


def test_features_move_as_the_truth_says(renderer: Renderer) -> None:
    first, second = poses_at(13.0, 13.3)
    sift = cv2.SIFT_create(600)
    (points_a, found_a), (points_b, found_b) = (
        sift.detectAndCompute(cv2.cvtColor(renderer.radiance(CAMERA, [pose] * 3), cv2.COLOR_BGR2GRAY), None)
        for pose in (first, second)
    )
    matches = cv2.BFMatcher(cv2.NORM_L2, crossCheck=True).match(found_a, found_b)
    a = np.array([points_a[m.queryIdx].pt for m in matches])
    b = np.array([points_b[m.trainIdx].pt for m in matches])
    points = renderer.surface(CAMERA, first).points[np.round(a[:, 1]).astype(int), np.round(a[:, 0]).astype(int)]
    expected = project(second, points) + (a - np.round(a))  # the surface is known at pixel centres
    error = b - expected
    true = np.linalg.norm(error, axis=1) < 3
    assert true.sum() > 100
    assert np.median(np.linalg.norm(error[true], axis=1)) < 0.5
    assert np.abs(np.median(error[true], axis=0)).max() < 0.1  # no bias to a side


def test_the_camera_may_look_anywhere(renderer: Renderer) -> None:
    for heading in ((0, 0.01, 1), (0.01, 0, -1), (-1, 0, 0), (0, -1, -0.2)):
        surface = renderer.surface(CAMERA, Pose.from_heading(np.zeros(3), np.array(heading, dtype=float)))
        assert (surface.depth > 0.02).all()


def test_textured_rooms_give_features_and_blank_walls_do_not(sparse_site: Scene) -> None:
    orb = cv2.ORB_create(1000)
    (pose,) = poses_at(8.0)
    counts = [
        len(orb.detect(cv2.cvtColor(render_view(s, PHONE_CAMERA, pose), cv2.COLOR_BGR2GRAY)))
        for s in (sparse_site, make_blank_wall())
    ]
    assert counts[0] > 400
    assert counts[1] < 0.25 * counts[0]


def test_rooms_follow_from_their_seed(site: Scene) -> None:
    again, other = make_test_site.__wrapped__(0), make_test_site(3)
    assert all(np.array_equal(a.paint.albedo, b.paint.albedo) for a, b in zip(site.faces, again.faces, strict=True))
    assert any(
        a.paint.albedo.shape != b.paint.albedo.shape or not np.array_equal(a.paint.albedo, b.paint.albedo)
        for a, b in zip(site.faces, other.faces, strict=False)
    )


def test_noise_follows_from_its_seed() -> None:
    (pose,) = poses_at(2.0)
    pictures = [render_view(make_blank_wall(), CAMERA, pose, Light.DIM, seed) for seed in (1, 1, 2)]
    assert np.array_equal(pictures[0], pictures[1])
    assert not np.array_equal(pictures[0], pictures[2])


def test_some_rows_are_those_of_the_whole_picture(renderer: Renderer) -> None:
    pose = Pose.from_heading(np.array([1.2, 0.8, 1.4]), np.array([0.7, 0.6, -0.1]))
    whole = renderer.radiance(PHONE_CAMERA, [pose])
    np.testing.assert_array_equal(renderer.radiance(PHONE_CAMERA, [pose], (100, 124)), whole[100:124])


SIDE_M = 3.0


def make_room(source: Source | None = Source.LAMP) -> Scene:
    """A grey cube of a room with a table in its middle, a lamp above it and a window in the wall y+."""
    gray = np.full((60, 60, 3), 150, np.uint8)
    glow = np.zeros((60, 60), bool)
    glow[25:35, 25:35] = True
    paints = {name: Paint(gray) for name in ("x+", "x-", "y-", "z-")}
    paints["z+"] = Paint(gray, glow, Source.LAMP)
    paints["y+"] = Paint(gray, glow, Source.WINDOW)
    table = Box(np.array([0.0, 0.0, -0.5]), np.array([1.0, 1.0, 0.1]), 0.0, {n: Paint(gray) for n in ("z+", "z-")})
    return Scene(Box(np.zeros(3), np.full(3, SIDE_M), 0.0, paints), (table,))


def luminances(light: Light) -> dict[str, FloatArray]:
    """Each face's linear luminance (H, W, 3) in cd/m²."""
    scene = make_room()
    lit = light_scene(scene, light)
    names = [*scene.room.paints, "table top", "table bottom"]
    return {n: (p / 255.0) ** GAMMA * lit.white_luminance for n, p in zip(names, lit.paints, strict=True)}


def test_white_points_go_from_warm_to_cool() -> None:
    red_over_blue = [white_point(kelvin)[2] / white_point(kelvin)[0] for kelvin in (4500.0, 6500.0, 9000.0)]
    assert red_over_blue[0] > red_over_blue[1] > red_over_blue[2]
    np.testing.assert_allclose(white_point(6504.0), 1.0, atol=0.02)  # D65 is the white of sRGB


def test_daylight_and_lamps_differ_in_colour_and_direction() -> None:
    day, night = luminances(Light.DAYLIGHT), luminances(Light.ARTIFICIAL)
    wall = "x-"
    colour = [picture[wall].mean(axis=(0, 1)) for picture in (day, night)]
    assert colour[0][0] / colour[0][2] > 1.15 * colour[1][0] / colour[1][2]  # blue over red
    # Seen from inside, the right end of the wall x- is the nearer one to the window.
    near, far = day[wall][20:40, 45:].mean(), day[wall][20:40, :15].mean()
    assert near > 1.2 * far
    left, right = night[wall][20:40, :15].mean(), night[wall][20:40, 45:].mean()
    assert left == pytest.approx(right, rel=0.1)


def test_a_table_casts_a_shadow() -> None:
    night = luminances(Light.ARTIFICIAL)
    under, beside = night["z-"][28:32, 28:32].mean(), night["z-"][28:32, 4:8].mean()
    assert under < 0.6 * beside
    assert night["table bottom"].mean() < 0.5 * night["table top"].mean()


def test_dim_light_is_half_the_light() -> None:
    full, half = luminances(Light.ARTIFICIAL), luminances(Light.DIM)
    assert half["z-"].mean() == pytest.approx(0.5 * full["z-"].mean(), rel=0.02)


def gray_card(level: int) -> ByteArray:
    return np.full((60, 80, 3), level, np.uint8)


def test_exposure_brings_any_light_to_the_same_level_and_balances_colour() -> None:
    rng = np.random.default_rng(0)
    tinted = np.clip(rng.integers(20, 90, (60, 80, 1)) * np.array([1.4, 1.0, 0.8]), 0, 255).astype(np.uint8)
    means = []
    for picture in (tinted, (tinted * 0.6).astype(np.uint8)):
        developed = develop(picture, expose(meter(picture), 100.0), np.random.default_rng(0))
        means.append(developed.mean())
        before, after = picture.mean(axis=(0, 1)), developed.mean(axis=(0, 1))
        assert after[0] / after[2] < 0.75 * before[0] / before[2]
    assert means[0] == pytest.approx(means[1], abs=4)
    assert 110 < means[0] < 145


def test_the_dark_is_noisier() -> None:
    picture = gray_card(100)
    noise = []
    for white_luminance in (400.0, 100.0, 50.0):
        exposure = expose(meter(picture), white_luminance)
        assert exposure.seconds <= LONGEST_EXPOSURE_S
        noise.append(develop(picture, exposure, np.random.default_rng(1)).std())
    assert noise[0] < noise[1] < noise[2]
    # Shot noise: half the light in the same time is √2 times the noise.
    short, long = (
        develop(picture, Exposure(seconds, np.ones(3), 400.0), np.random.default_rng(1)).std()
        for seconds in (0.002, 0.008)
    )
    assert short == pytest.approx(2 * long, rel=0.2)
