"""The report as a picture."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from rholoc.maps import Map
from rholoc.pictures.map_report import report_png
from rholoc.reports import HeldOutReport, MapReport

FRAMES = HeldOutReport(4, 3, 0.02, 0.3, errors_m=(0.01, 0.02, None, 0.3), confidences=(0.9, 0.8, 0.1, 0.4))


def picture(map_: Map, held_out: HeldOutReport | None = None) -> np.ndarray:
    png = report_png(replace(map_, info=replace(map_.info, report=MapReport(held_out=held_out))), "room")
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)


def test_errors_of_held_out_frames_are_plotted(room_map: Map) -> None:
    without, drawn = picture(room_map), picture(room_map, FRAMES)
    assert drawn.shape == (1080, 1800, 3)
    upper_right = (slice(0, 540), slice(900, 1800))
    green = (0x1A, 0x7F, 0x5A)
    assert (np.abs(drawn[upper_right] - green).sum(axis=2) < 12).sum() > 500
    assert (np.abs(without[upper_right] - green).sum(axis=2) < 12).sum() == 0


def test_the_expected_error_is_drawn_over_the_walk(room_map: Map) -> None:
    spread = np.tile(np.diag([1e-4] * 3 + [1e-6] * 3).astype(np.float32), (len(room_map.views), 1, 1))
    right = (slice(0, 540), slice(1350, 1800))
    unknown, known = picture(room_map), picture(replace(room_map, views=replace(room_map.views, covariances=spread)))
    pale = (0xE4, 0xF0, 0xEB)  # below the curve
    shares = [(np.abs(drawn[right] - pale).sum(axis=2) < 20).mean() for drawn in (unknown, known)]
    assert shares[1] > 0.2 > 10 * shares[0]


def test_coverage_is_coloured(make_map) -> None:
    """Of 900 landmarks many are in view; of 3, never enough."""
    share = {}
    for features in (3, 900):
        left = picture(make_map(features=features))[:, :900]
        share[features] = (np.abs(left - (0x78, 0xC0, 0x8C)).sum(axis=2) < 12).sum()
    assert share[3] < 0.2 * share[900]


@pytest.mark.parametrize(
    "held_out",
    [
        HeldOutReport(4, 4, 0.01, 0.02, errors_m=(0.01,), confidences=()),
        HeldOutReport(2, 0, None, None, errors_m=(None, None), confidences=(0.0, 0.2)),
    ],
)
def test_whatever_is_known_of_frames_held_out_there_is_a_picture(room_map: Map, held_out: HeldOutReport) -> None:
    assert picture(room_map, held_out).std() > 5


def test_an_empty_map_has_a_picture(make_map) -> None:
    assert picture(make_map(features=0, views=0)).min() < 100
