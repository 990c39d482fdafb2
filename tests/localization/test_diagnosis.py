"""What a picture shows of why it was not localized."""

import cv2
import numpy as np
import pytest

from rholoc.geometry import ByteArray
from rholoc.localization.diagnosis import (
    Agreement,
    Cause,
    diagnose_picture,
    sight_of,
    too_inexact,
    wrong_camera,
)
from rholoc.maps import Map

STRANGE = Agreement(20, 459, 0.02)


@pytest.fixture
def room_picture() -> ByteArray:
    """Something like furniture: rectangles with sharp edges, in muted colours."""
    rng = np.random.default_rng(3)
    picture = np.full((480, 640, 3), 130, np.uint8)
    for _ in range(150):
        corner, size = rng.integers(0, (620, 460)), rng.integers(8, 90, 2)
        grey = int(rng.integers(40, 220))
        colour = tuple(int(c) for c in np.clip(grey + rng.integers(-25, 25, 3), 0, 255))
        cv2.rectangle(picture, corner.tolist(), (corner + size).tolist(), colour, -1)
    return picture


def _cause(picture: ByteArray | None, map_: Map, features: int = 500) -> Cause:
    return diagnose_picture(picture, map_, features, 40, STRANGE).cause


def test_a_good_picture_of_elsewhere_is_an_unknown_place(room_map: Map, room_picture: ByteArray) -> None:
    assert _cause(room_picture, room_map) is Cause.UNKNOWN_PLACE
    assert _cause(None, room_map) is Cause.UNKNOWN_PLACE
    assert _cause(cv2.cvtColor(room_picture, cv2.COLOR_BGR2GRAY), room_map) is Cause.UNKNOWN_PLACE  # type: ignore[arg-type]


def test_a_picture_of_elsewhere_reads_like_one(room_map: Map, room_picture: ByteArray) -> None:
    def message(inliers: int, matches: int, recognized: float) -> str:
        return diagnose_picture(room_picture, room_map, 500, 40, Agreement(inliers, matches, recognized)).message

    strange = "This picture does not show this map: 20 of 459 matches agree, no better than chance."
    assert message(20, 459, 0.02) == strange
    assert message(0, 0, 0.0) == "This picture does not show this map: nothing in it looks like anything there."
    assert message(60, 459, 0.4) == (
        "Too little in this picture shows this map to be sure of the place: 60 of 459 matches agree."
    )


def test_a_pose_that_is_too_inexact_is_named_by_what_it_is_known_to_and_what_was_asked() -> None:
    place = too_inexact(0.123, 0.01, 0.05, np.inf)
    assert place.message == (
        "The place was recognized, but the pose is only known to 0.12 m (1σ); at most 0.05 m was asked for."
    )
    assert "max_sigma_m" in place.hint
    turned = too_inexact(0.01, np.deg2rad(3.0), 0.05, np.deg2rad(1.5))
    assert "known to 3° (1σ); at most 1.5° was asked for" in turned.message
    assert "max_sigma_deg" in turned.hint


@pytest.mark.parametrize("along", [True, False])
def test_motion_blur_is_named(room_map: Map, room_picture: ByteArray, along: bool) -> None:
    size = (25, 1) if along else (1, 25)
    assert _cause(np.asarray(cv2.blur(room_picture, size)), room_map) is Cause.BLURRED


def test_darkness_and_coloured_light_are_named(room_map: Map, room_picture: ByteArray) -> None:
    assert _cause((room_picture * 0.1).astype(np.uint8), room_map) is Cause.TOO_DARK
    assert _cause((room_picture * (1.0, 0.2, 0.2)).astype(np.uint8), room_map) is Cause.OTHER_LIGHT


def test_a_bare_wall_is_named(room_map: Map) -> None:
    rng = np.random.default_rng(0)
    wall = rng.normal(150, 6, (480, 640, 3)).clip(0, 255).astype(np.uint8)
    assert _cause(wall, room_map, features=12) is Cause.TOO_LITTLE_TEXTURE
    assert _cause(np.full_like(wall, 128), room_map, features=0) is Cause.TOO_LITTLE_TEXTURE


@pytest.mark.parametrize("shape", [(1, 1, 3), (5, 700, 3), (9, 9), (3000, 20, 3)])
def test_any_size_of_picture_can_be_looked_at(shape: tuple[int, ...]) -> None:
    assert np.isfinite(sight_of(np.full(shape, 128, np.uint8)).sharpness)


def test_few_features_are_a_bare_wall_and_a_camera_is_named_by_both_lengths(room_map: Map) -> None:
    assert [_cause(None, room_map, features) for features in (39, 40)] == [
        Cause.TOO_LITTLE_TEXTURE,
        Cause.UNKNOWN_PLACE,
    ]
    message = wrong_camera(400.0, 512.4).message
    assert "about 512 px" in message
    assert "than 400 px" in message


@pytest.mark.parametrize("width", [480, 640, 1280])
@pytest.mark.parametrize("period_px", [40, 64])
def test_sharpness_of_a_wave_is_that_of_its_worse_direction(width: int, period_px: int) -> None:
    """Pixels beside each other differ by sin(π/P), those eight apart by sin(8π/P); both are blurred alike."""
    x, y = np.meshgrid(np.arange(width), np.arange(width * 3 // 4))
    scale = max(width / 640, 1)  # larger pictures are looked at 640 wide
    along_x, along_y = period_px * scale, 20 * scale
    wave = 120 + 40 * np.sin(2 * np.pi * x / along_x) + 40 * np.sin(2 * np.pi * y / along_y)
    sight = sight_of(np.repeat(wave.astype(np.uint8)[..., None], 3, axis=2))
    expected = np.sin(np.pi / period_px) / np.sin(8 * np.pi / period_px)
    assert sight.sharpness == pytest.approx(expected, rel=0.06)
    assert sight.sharpness == pytest.approx(sight_of(np.ascontiguousarray(wave.T.astype(np.uint8))).sharpness, rel=0.06)
    assert sight.brightness == pytest.approx(119.5, abs=2)
    assert sight.tint == 0


def test_a_tint_is_the_distance_from_grey() -> None:
    colour = np.full((60, 80, 3), (200, 120, 60), np.uint8)
    _, a, b = cv2.cvtColor(colour[:1, :1], cv2.COLOR_BGR2LAB)[0, 0].astype(float)
    assert sight_of(colour).tint == pytest.approx(np.hypot(a - 128, b - 128))
    assert sight_of(colour).tint > 30
    assert sight_of(colour).brightness == pytest.approx(0.114 * 200 + 0.587 * 120 + 0.299 * 60, abs=1)
    assert sight_of(colour[..., 0]).tint == 0
    half = colour.copy()
    half[:, :40] = colour[:, :40, ::-1]  # mixed with its complement
    assert sight_of(half).tint < 0.5 * sight_of(colour).tint
    small = np.random.default_rng(0).integers(0, 255, (8, 80), np.uint8)
    assert sight_of(small).sharpness == 1.0  # nothing is eight rows apart
    assert sight_of(np.full((9, 9), 77, np.uint8)).sharpness == 1.0  # nothing there to be blurred
    assert sight_of(np.tile(np.arange(0, 180, 20, dtype=np.uint8), (9, 1))).sharpness < 0.5
