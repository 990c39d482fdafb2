"""What a picture shows of why it was not localized."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from rholoc.geometry import ByteArray
from rholoc.localization.diagnosis import Cause, diagnose_picture, sight_of
from rholoc.maps import Map


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
    return diagnose_picture(picture, map_, features, 40).cause


def test_a_good_picture_of_elsewhere_is_an_unknown_place(room_map: Map, room_picture: ByteArray) -> None:
    assert _cause(room_picture, room_map) is Cause.UNKNOWN_PLACE
    assert _cause(None, room_map) is Cause.UNKNOWN_PLACE
    assert _cause(cv2.cvtColor(room_picture, cv2.COLOR_BGR2GRAY), room_map) is Cause.UNKNOWN_PLACE  # type: ignore[arg-type]


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


@pytest.mark.parametrize("shape", [(1, 1, 3), (5, 700, 3), (9, 9), (3000, 20, 3)])
def test_any_size_of_picture_can_be_looked_at(shape: tuple[int, ...]) -> None:
    assert np.isfinite(sight_of(np.full(shape, 128, np.uint8)).sharpness)
