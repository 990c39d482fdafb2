"""Seconds without a place, and what they show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rholoc.geometry import BoolArray
from rholoc.reports import MissingSpan
from rholoc.trajectory.checks.gaps import describe, missing_spans
from rholoc.trajectory.visual.flow import Flow

_SECONDS, _HZ, _START_S = 20, 10, 100.0


def _flow(
    gap: BoolArray, corners: int = 200, sharpness: float = 100.0, brightness: float = 120.0, contrast: float = 50.0
) -> Flow:
    """Twenty seconds of a room, and within ``gap`` so many corners of that sharpness, brightness and contrast."""
    count = _SECONDS * _HZ
    counts = np.where(gap, corners, 200)
    return Flow(
        _START_S + np.arange(count) / _HZ,
        (640, 480),
        np.concatenate([[0], np.cumsum(counts)]),
        np.concatenate([np.arange(n) for n in counts]),
        np.zeros((int(counts.sum()), 2)),
        np.full(count, 0.01),
        np.where(gap, sharpness, 100.0),
        np.where(gap, brightness, 120.0),
        np.where(gap, contrast, 50.0),
    )


_ROWS = np.arange(0, _SECONDS * _HZ, 2)
_GAP = (np.arange(_SECONDS * _HZ) >= 120) & (np.arange(_SECONDS * _HZ) < 150)


@pytest.mark.parametrize(
    ("gap", "why"),
    [
        ({"corners": 5}, "shows a blank wall"),
        ({"corners": 5, "sharpness": 3.0, "contrast": 4.0}, "shows a blank wall"),
        ({"corners": 300, "sharpness": 20.0, "contrast": 1.0}, "shows a blank wall"),  # the corners are noise
        ({"corners": 80, "sharpness": 10.0}, "is blurred"),
        ({"corners": 3, "sharpness": 1.0, "brightness": 8.0}, "is too dark"),
        ({}, "shows nothing that links it to the rest of the walk"),
    ],
)
def test_missing_seconds_say_what_they_show(gap: dict[str, float], why: str) -> None:
    (span,) = missing_spans(_flow(_GAP, **gap), _ROWS, ~_GAP[_ROWS])
    assert span.start_s == pytest.approx(12.0, abs=0.3)  # from the start of the recording, not of its clock
    assert span.end_s == pytest.approx(15.0, abs=0.3)
    assert span.why == why
    assert describe((span,)) == f"0:12–0:15 {why}."


def test_the_start_and_the_end_can_be_missing() -> None:
    ends = (np.arange(200) < 30) | (np.arange(200) >= 170)
    first, last = missing_spans(_flow(ends), _ROWS, ~ends[_ROWS])
    assert (first.start_s, last.end_s) == pytest.approx((0.0, 19.9))


def test_of_many_spans_some_are_named() -> None:
    spans = tuple(MissingSpan(None, None, "is blurred", number, number) for number in range(0, 18, 2))
    assert (
        describe(spans)
        == " ".join(f"Picture {n} is blurred." for n in (0, 2, 4, 6)) + " 5 more parts could not be placed."
    )


def test_a_moment_is_not_missing() -> None:
    flow = _flow(np.zeros(200, np.bool_))
    placed = np.ones(len(_ROWS), np.bool_)
    assert missing_spans(flow, _ROWS, placed) == ()
    placed[50] = False
    assert missing_spans(replace(flow, times=_START_S + np.arange(200) / 30), _ROWS, placed) == ()
    assert describe(()) == ""


def test_of_a_walk_without_any_place_nothing_is_listed() -> None:
    assert missing_spans(_flow(_GAP), _ROWS, np.zeros(len(_ROWS), np.bool_)) == ()


@pytest.mark.parametrize(
    ("gap", "why"),
    [
        ({"brightness": 24.0}, "is too dark"),
        ({"brightness": 26.0}, "shows nothing that links it to the rest of the walk"),
        ({"contrast": 9.0}, "shows a blank wall"),
        ({"contrast": 11.0}, "shows nothing that links it to the rest of the walk"),
        ({"sharpness": 24.0}, "is blurred"),
        ({"sharpness": 26.0}, "shows nothing that links it to the rest of the walk"),
        ({"corners": 59}, "shows a blank wall"),
        ({"corners": 61}, "shows nothing that links it to the rest of the walk"),
    ],
)
def test_where_a_reason_begins(gap: dict[str, float], why: str) -> None:
    (span,) = missing_spans(_flow(_GAP, **gap), _ROWS, ~_GAP[_ROWS])
    assert span.why == why


def test_a_span_goes_from_the_first_frame_without_a_place_to_the_next_with_one() -> None:
    """Keyframes are every second frame at 10 Hz: the seventh and eighth are missing."""
    placed = np.ones(len(_ROWS), np.bool_)
    placed[[7, 8]] = False
    (span,) = missing_spans(_flow(_GAP), _ROWS, placed)
    assert (span.start_s, span.end_s) == pytest.approx((1.3, 1.8))
    placed[8] = True
    assert missing_spans(_flow(_GAP), _ROWS, placed) == ()  # for three tenths of a second
    placed[:] = True
    placed[-3:] = False
    (span,) = missing_spans(_flow(_GAP), _ROWS, placed)
    assert (span.start_s, span.end_s) == pytest.approx((19.3, 19.9))


def test_the_reason_is_that_of_the_frames_that_are_missing() -> None:
    dark = (np.arange(200) >= 13) & (np.arange(200) < 18)
    placed = np.ones(len(_ROWS), np.bool_)
    placed[[7, 8]] = False
    (span,) = missing_spans(_flow(dark, brightness=5.0), _ROWS, placed)
    assert span.why == "is too dark"


def test_times_are_minutes_and_seconds() -> None:
    spans = (MissingSpan(59.4, 61.6, "is blurred"), MissingSpan(600.0, 725.0, "is too dark"))
    assert describe(spans) == "0:59–1:02 is blurred. 10:00–12:05 is too dark."
