"""Keyframes: the sharp frames of a recording at even steps of image motion."""

from __future__ import annotations

import numpy as np

from rholoc.geometry import FloatArray, IntArray

_STEP = 0.05  # of the image's longer side: how far it moves from keyframe to keyframe …
_FINEST_STEP = 0.01  # … and in recordings that would have too few
_FEW_KEYFRAMES = 60
_LONGEST_S = 1.4  # between keyframes of a camera at rest
_SHORTEST_S = 0.08  # between any two


class KeyframeSteps:
    """The sharpest frame of every step of image motion, known as soon as the next step begins.

    Attributes:
        sharpest: the row of the sharpest frame of the present step; None before the first frame.
    """

    def __init__(self, step: float = _STEP) -> None:
        self._step = step
        self._number = -1
        self._path = 0.0
        self._start_s = 0.0
        self._sharpness = 0.0
        self._time_s = 0.0
        self._last_s = -np.inf
        self.sharpest: int | None = None

    def add(self, row: int, time_s: float, motion: float, sharpness: float) -> int | None:
        """Take the next frame; the keyframe of the step before where this frame begins another, else None."""
        if self.sharpest is None:
            self._start_s = time_s
        self._path += motion
        number = int(np.floor(self._path / self._step + (time_s - self._start_s) / _LONGEST_S))
        ended = self.end() if number != self._number else None
        if number != self._number or sharpness > self._sharpness:
            self.sharpest, self._sharpness, self._time_s = row, sharpness, time_s
        self._number = number
        return ended

    def end(self) -> int | None:
        """The keyframe of the present step; None where it would be too soon after the one before."""
        if self.sharpest is None or self._time_s - self._last_s < _SHORTEST_S:
            return None
        self._last_s = self._time_s
        return self.sharpest


def choose_keyframes(times: FloatArray, motion: FloatArray, sharpness: FloatArray) -> IntArray:
    """The sharpest frame of every step of image motion: rows (K,), increasing. A longer walk has more of them.

    Args:
        times: (N,) seconds.
        motion: (N,) image motion before each frame, as a share of the image's longer side.
        sharpness: (N,) any measure that grows with sharpness.
    """
    steps = KeyframeSteps(float(np.clip(motion.sum() / _FEW_KEYFRAMES, _FINEST_STEP, _STEP)))
    found = [steps.add(*frame) for frame in zip(range(len(times)), times, motion, sharpness, strict=True)]
    return np.array([row for row in (*found, steps.end()) if row is not None], dtype=np.int64)
