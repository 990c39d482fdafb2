"""The report as a picture."""

from __future__ import annotations

import io
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from PIL import Image

from rholoc.maps import Map
from rholoc.maps.report_picture import report_png

HELD_OUT = {"errors_m": [0.01, 0.02, None, 0.3], "confidences": [0.9, 0.8, 0.1, 0.4]}


def picture(map_: Map, report: dict[str, Any]) -> np.ndarray:
    png = report_png(replace(map_, info=replace(map_.info, report=report)), "room")
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)


def test_errors_of_held_out_frames_are_plotted(room_map: Map) -> None:
    without, drawn = picture(room_map, {}), picture(room_map, {"held_out": HELD_OUT})
    assert drawn.shape == (1080, 1800, 3)
    upper_right = (slice(0, 540), slice(900, 1800))
    green = (0x1A, 0x7F, 0x5A)
    assert (np.abs(drawn[upper_right] - green).sum(axis=2) < 12).sum() > 500
    assert (np.abs(without[upper_right] - green).sum(axis=2) < 12).sum() == 0


def test_coverage_is_coloured(make_map) -> None:
    """Of 900 landmarks many are in view; of 3, never enough."""
    share = {}
    for features in (3, 900):
        left = picture(make_map(features=features), {})[:, :900]
        share[features] = (np.abs(left - (0x78, 0xC0, 0x8C)).sum(axis=2) < 12).sum()
    assert share[3] < 0.2 * share[900]


@pytest.mark.parametrize(
    "report",
    [
        {"held_out": {"frames": 4, "localized": 0, "median_m": None, "p90_m": None}},
        {"held_out": {"frames": 4, "localized": 4, "median_m": 0.01, "p90_m": 0.02}},
        {"held_out": {"errors_m": ["far"], "confidences": [1]}},
        {"held_out": {"errors_m": [None, None], "confidences": [0, 0.2]}},
        {"held_out": {"errors_m": [0.0], "confidences": [1.0]}},
    ],
)
def test_whatever_the_report_says_there_is_a_picture(room_map: Map, report: dict[str, Any]) -> None:
    assert picture(room_map, report).std() > 5


@pytest.mark.parametrize(("features", "views"), [(0, 0), (3, 1)])
def test_small_maps_have_a_picture(make_map, features: int, views: int) -> None:
    assert picture(make_map(features=features, views=views), {}).min() < 100
