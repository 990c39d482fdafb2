"""Parts of a recording without poses, and the probable cause."""

import itertools

import numpy as np

from rholoc.geometry import BoolArray, IntArray
from rholoc.reports import MissingSpan
from rholoc.trajectory.visual.flow import Flow

_SHORTEST_S = 0.4
_DARK = 25.0  # grey value
_BLURRED = 0.25  # of the walk's median sharpness
_PLAIN = 10.0  # contrast in grey values, of a wall lit from one side
_FEW_CORNERS = 60
_MAX_NAMED = 4  # spans in a message
_DISPUTED = "is not confirmed by a second reconstruction"


def missing_spans(
    flow: Flow, rows: IntArray, placed: BoolArray, disputed: BoolArray | None = None
) -> tuple[MissingSpan, ...]:
    """Spans of frames without poses: before, between and after the keyframes ``rows`` (K,) that are ``placed`` (K,).

    A span has at least one keyframe, and comes with its probable cause. ``disputed`` (K,) keyframes, left out because
    no second reconstruction confirms them, have spans of their own. Empty if no keyframe is placed. With measured
    times, spans shorter than 0.4 s are omitted.
    """
    if not placed.any():
        return ()
    kinds = np.where(placed, 0, 1 if disputed is None else 1 + disputed)
    starts = [0, *(np.flatnonzero(np.diff(kinds)) + 1).tolist(), len(rows)]
    spans = []
    for start, end in itertools.pairwise(starts):
        if placed[start]:
            continue
        first = 0 if start == 0 else int(rows[start - 1]) + 1 if placed[start - 1] else int(rows[start])
        last = len(flow.times) if end == len(rows) else int(rows[end])
        why = _reason(flow, np.arange(first, last)) if kinds[start] == 1 else _DISPUTED
        span = _span(flow, first, last, why)
        if span is not None:
            spans.append(span)
    return tuple(spans)


def _span(flow: Flow, first: int, last: int, why: str) -> MissingSpan | None:
    """Span of rows ``first`` to ``last`` - 1; None if times are measured and it is shorter than 0.4 s."""
    numbers = int(flow.numbers[first]), int(flow.numbers[last - 1])
    if not flow.timed:
        return MissingSpan(None, None, why, *numbers)
    from_s = float(flow.times[first] - flow.times[0])
    seconds = float(flow.times[min(last, len(flow.times) - 1)] - flow.times[first])
    return MissingSpan(from_s, from_s + seconds, why, *numbers) if seconds >= _SHORTEST_S else None


def describe(spans: tuple[MissingSpan, ...]) -> str:
    """The first four spans in plain words; empty without spans.

    "0:12–0:15 shows a blank wall." with times, "Each of the pictures 12 to 18 is blurred." without.
    """
    named = [f"{_place(span)} {span.why}." for span in spans[:_MAX_NAMED]]
    rest = len(spans) - len(named)
    more = "1 more part" if rest == 1 else f"{rest} more parts"
    return " ".join([*named, f"{more} could not be placed."] if rest > 0 else named)


def _place(span: MissingSpan) -> str:
    """A span's times since the first frame, or its picture numbers, as a sentence's subject."""
    if span.start_s is not None and span.end_s is not None:
        return f"{_clock(span.start_s)}–{_clock(span.end_s)}"
    if span.first_number == span.last_number:
        return f"Picture {span.first_number}"
    return f"Each of the pictures {span.first_number} to {span.last_number}"


def _reason(flow: Flow, frames: IntArray) -> str:
    """Probable cause why ``frames`` (rows) have no pose, as a predicate: "is too dark"."""
    corners = np.diff(flow.starts)[frames]
    level = np.median if flow.timed else np.max  # without times the message is about each picture, not about most
    if level(flow.brightness[frames]) < _DARK:
        return "is too dark"
    if level(flow.contrast[frames]) < _PLAIN:
        return "shows a blank wall"  # where corners of noise come and go
    if level(flow.sharpness[frames]) < _BLURRED * np.median(flow.sharpness):
        return "is blurred"
    if level(corners) < _FEW_CORNERS:
        return "shows a blank wall"
    return f"shows nothing that links it to {'the rest of the walk' if flow.timed else 'the other pictures'}"


def _clock(seconds: float) -> str:
    """Minutes and seconds, such as 1:05."""
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes}:{rest:02d}"
