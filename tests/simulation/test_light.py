"""Light has a colour, a direction and a shadow; the camera has noise."""

from __future__ import annotations

import numpy as np
import pytest

from rholoc.geometry import ByteArray, FloatArray
from rholoc.simulation import Light
from rholoc.simulation.light import GAMMA, light_scene, white_point
from rholoc.simulation.scene import Box, Paint, Scene, Source
from rholoc.simulation.sensor import LONGEST_EXPOSURE_S, Exposure, develop, expose, meter

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
