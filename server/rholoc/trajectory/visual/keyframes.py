"""Keyframes: the sharp frames of a recording at even steps of image motion."""

import numpy as np

from rholoc.geometry import FloatArray, IntArray
from rholoc.recordings import FrameSource
from rholoc.trajectory.visual.flow import Flow

_STEP = 0.05  # image motion between keyframes, as a share of the longer side …
_FINEST_STEP = 0.01  # … and its minimum, for recordings with too few keyframes
_FEW_KEYFRAMES = 60
_LONGEST_S = 1.4  # between keyframes of a camera at rest
_SHORTEST_S = 0.08  # between any two
MAX_PICTURES = 300  # of a set that are all used; of larger ones those least alike
_SPARSE_S = 0.4  # between frames, from which each of up to MAX_PICTURES is used, however little the camera moves
_FILM_SHARE, _FILM_CORNERS = 0.2, 40  # maximum share of a film's frames with fewer shared corners
_FILM_MOTION = 0.02  # from frame to frame in the mean, as a share of the image's longer side


def may_be_film(frames: FrameSource) -> bool:
    """Whether the frames may be a continuous video: they have times, or are more than ``MAX_PICTURES``."""
    return frames.timed or len(frames.times) > MAX_PICTURES


def is_film(flow: Flow) -> bool:
    """Whether the frames form a continuous video: four in five share 40 corners with the next.

    False for a set of pictures and for a thinned-out film. Up to ``MAX_PICTURES`` frames are a set if they have no
    times, if the median time between them is 0.4 s or more, or if the mean motion exceeds 2 % of the longer side.
    """
    shared = flow.shared_with_next
    if len(shared) == 0 or float(np.quantile(shared, _FILM_SHARE)) < _FILM_CORNERS:
        return False
    is_sparse = not flow.timed or float(np.median(np.diff(flow.times))) >= _SPARSE_S
    if is_sparse and len(flow.times) <= MAX_PICTURES:
        return False
    return len(flow.times) > MAX_PICTURES or float(np.mean(flow.motion[1:])) <= _FILM_MOTION


class KeyframeSteps:
    """Selects the sharpest frame of every step of image motion, as soon as the next step begins.

    Attributes:
        sharpest: the row of the sharpest frame of the present step; None before the first frame.
    """

    def __init__(self, step: float = _STEP, timed: bool = True) -> None:
        """Start without frames.

        Args:
            step: image motion, as a share of the longer side.
            timed: whether times are measured; otherwise only motion counts.
        """
        self._step = step
        self._longest_s, self._shortest_s = (_LONGEST_S, _SHORTEST_S) if timed else (np.inf, 0.0)
        self._number = -1
        self._path = 0.0
        self._start_s = 0.0
        self._sharpness = 0.0
        self._time_s = 0.0
        self._last_s = -np.inf
        self.sharpest: int | None = None

    def add(self, row: int, time_s: float, motion: float, sharpness: float) -> int | None:
        """Take the next frame. If it begins a step, return the keyframe of the step before, else (or if too soon) None.

        Args:
            row: of the frame.
            time_s: its time.
            motion: image motion since the frame before, as a share of the longer side.
            sharpness: any measure that grows with sharpness.
        """
        if self.sharpest is None:
            self._start_s = time_s
        self._path += motion
        number = int(np.floor(self._path / self._step + (time_s - self._start_s) / self._longest_s))
        ended = self.end() if number != self._number else None
        if number != self._number or sharpness > self._sharpness:
            self.sharpest, self._sharpness, self._time_s = row, sharpness, time_s
        self._number = number
        return ended

    def end(self) -> int | None:
        """Row of the sharpest frame of the present step, noted as taken as a keyframe; None without frames or, if times
        are measured, less than 0.08 s after the keyframe before.
        """
        if self.sharpest is None or self._time_s - self._last_s < self._shortest_s:
            return None
        self._last_s = self._time_s
        return self.sharpest


def choose_keyframes(times: FloatArray, motion: FloatArray, sharpness: FloatArray, timed: bool = True) -> IntArray:
    """Sharpest frame of every step of image motion: rows (K,), increasing.

    Args:
        times: (N,) seconds, or rows.
        motion: (N,) image motion before each frame, as a share of the image's longer side.
        sharpness: (N,) any measure that grows with sharpness.
        timed: whether times are measured; otherwise only motion counts.
    """
    steps = KeyframeSteps(float(np.clip(motion.sum() / _FEW_KEYFRAMES, _FINEST_STEP, _STEP)), timed)
    found = [steps.add(*frame) for frame in zip(range(len(times)), times, motion, sharpness, strict=True)]
    return np.array([row for row in (*found, steps.end()) if row is not None], dtype=np.int64)
