"""Keyframes: the sharp frames of a recording at even steps of image motion."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from rholoc.geometry import FloatArray, IntArray

_STEP = 0.05  # of the image's longer side: how far it moves from keyframe to keyframe …
_FINEST_STEP = 0.01  # … and in recordings that would have too few
_FEW_KEYFRAMES = 60
_LONGEST_S = 1.4  # between keyframes of a camera at rest
_SHORTEST_S = 0.08  # between any two


def choose_keyframes(times: FloatArray, motion: FloatArray, sharpness: FloatArray) -> IntArray:
    """The sharpest frame of every step of image motion: rows (K,), increasing. A longer walk has more of them.

    Args:
        times: (N,) seconds.
        motion: (N,) image motion before each frame, as a share of the image's longer side.
        sharpness: (N,) any measure that grows with sharpness.
    """
    if len(times) == 0:
        return np.zeros(0, dtype=np.int64)
    step = float(np.clip(motion.sum() / _FEW_KEYFRAMES, _FINEST_STEP, _STEP))
    path = np.cumsum(motion) / step + (times - times[0]) / _LONGEST_S
    edges = np.flatnonzero(np.diff(np.floor(path), prepend=-1, append=np.inf))
    rows: list[int] = []
    for first, last in pairwise(edges):
        row = int(first + np.argmax(sharpness[first:last]))
        if not rows or times[row] - times[rows[-1]] >= _SHORTEST_S:
            rows.append(row)
    return np.array(rows, dtype=np.int64)
