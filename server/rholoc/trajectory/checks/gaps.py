"""Which seconds of a walk have no place of their own in it, and what they show instead."""

from __future__ import annotations

import itertools

import numpy as np

from rholoc.geometry import BoolArray, IntArray
from rholoc.reports import MissingSpan
from rholoc.trajectory.visual.flow import Flow

_SHORTEST_S = 0.4
_DARK = 25.0  # grey value
_BLURRED = 0.25  # of the walk's usual sharpness
_PLAIN = 10.0  # grey values, the contrast of a wall that is lit from one side
_FEW_CORNERS = 60


def missing_spans(flow: Flow, rows: IntArray, placed: BoolArray) -> tuple[MissingSpan, ...]:
    """The spans between keyframes ``rows`` (K,) that are ``placed`` (K,), where others lie between, and why.

    Times are seconds from the start of the recording.
    """
    if not placed.any():
        return ()
    start_s = float(flow.times[0])
    edges = np.concatenate([[-1], np.flatnonzero(placed), [len(rows)]])
    spans = []
    for before, after in itertools.pairwise(edges):
        if after - before < 2:
            continue
        first = 0 if before < 0 else int(rows[before]) + 1
        last = len(flow.times) if after == len(rows) else int(rows[after])
        seconds = float(flow.times[min(last, len(flow.times) - 1)] - flow.times[first])
        if seconds >= _SHORTEST_S:
            from_s = float(flow.times[first]) - start_s
            spans.append(MissingSpan(from_s, from_s + seconds, _reason(flow, np.arange(first, last))))
    return tuple(spans)


def describe(spans: tuple[MissingSpan, ...]) -> str:
    """The spans in plain words, or an empty text: "0:12–0:15 shows a blank wall."."""
    return " ".join(f"{_clock(span.start_s)}–{_clock(span.end_s)} {span.why}." for span in spans)


def _reason(flow: Flow, frames: IntArray) -> str:
    corners = np.diff(flow.starts)[frames]
    if float(np.median(flow.brightness[frames])) < _DARK:
        return "is too dark"
    if float(np.median(flow.contrast[frames])) < _PLAIN:
        return "shows a blank wall"  # where corners of noise come and go
    if float(np.median(flow.sharpness[frames])) < _BLURRED * float(np.median(flow.sharpness)):
        return "is blurred"
    if float(np.median(corners)) < _FEW_CORNERS:
        return "shows a blank wall"
    return "shows nothing that links it to the rest of the walk"


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes}:{rest:02d}"
