"""Keyframes: the sharp frames of a recording at even steps of image motion."""

from __future__ import annotations

from itertools import pairwise

import cv2
import numpy as np

from rholoc.geometry import ByteArray, FloatArray, IntArray
from rholoc.progress import ProgressListener, Stage, silent
from rholoc.recordings import FrameSource

_SCAN_WIDTH_PX = 320  # motion and sharpness are measured on images of this width
_TRACKED_CORNERS = 150
_FEWEST_CORNERS = 8
_LOST_MOTION = 0.05  # assumed where nothing can be tracked, as a share of the image's width

_FINEST_STEP = 0.01  # keyframes are at least this share of the image's width apart in short recordings,
_FINE_STEP = 0.03  # usually this …
_COARSE_STEP = 0.08  # … or up to this in long recordings
_FEW_KEYFRAMES = 60  # a recording with fewer is short
_USUAL_KEYFRAMES = 120
_MOST_KEYFRAMES = 400
_BLURRED = 0.5  # times the sharpness of the sharpest frame that shows nearly the same
_SAME_VIEW = 0.1  # of the image's width: how far the image may have moved between frames that do
_MOST_GAP = 0.2  # of the image's width: between keyframes, where a blurred one is left out


def measure_motion(frames: FrameSource, progress: ProgressListener = silent) -> tuple[FloatArray, FloatArray]:
    """How far the image moves before each frame and how sharp it is: two (N,) arrays.

    Motion is the median displacement of tracked corners since the frame before, as a share of the image's width;
    sharpness the variance of the Laplacian.
    """
    count = len(frames.times)
    motion, sharpness = np.zeros(count), np.zeros(count)
    previous: ByteArray | None = None
    for row, image in enumerate(frames.images(range(count))):
        small = _scan_image(image)
        sharpness[row] = cv2.Laplacian(small, cv2.CV_32F).var()
        if previous is not None:
            motion[row] = _displacement(previous, small) / small.shape[1]
        previous = small
        progress(Stage.KEYFRAMES, (row + 1) / count, f"{row + 1} of {count} frames looked at")
    return motion, sharpness


def choose_keyframes(motion: FloatArray, sharpness: FloatArray) -> IntArray:
    """The sharpest frame of every step of image motion, unless it is blurred: rows (K,), increasing.

    Args:
        motion: (N,) image motion before each frame, as a share of the image's width.
        sharpness: (N,) any measure that grows with sharpness.
    """
    path = np.cumsum(motion)
    total = path[-1] if len(path) else 0.0
    fine = max(total / _FINE_STEP, min(total / _FINEST_STEP, _FEW_KEYFRAMES))
    steps = min(fine, max(_USUAL_KEYFRAMES, total / _COARSE_STEP), _MOST_KEYFRAMES)
    bins = np.minimum(np.floor(path * (steps / max(total, 1e-12))), np.ceil(steps) - 1)
    edges = np.flatnonzero(np.diff(bins, prepend=-np.inf, append=np.inf))
    rows = [first + int(np.argmax(sharpness[first:last])) for first, last in pairwise(edges)]
    return _without_blurred(np.array(rows, dtype=np.int64), path, sharpness)


def _without_blurred(rows: IntArray, path: FloatArray, sharpness: FloatArray) -> IntArray:
    """The rows (K,) without those that are blurred beside frames of the same view, as long as no wide gap is left."""
    nearby = [sharpness[np.abs(path - path[row]) <= _SAME_VIEW].max() for row in rows]
    relative = sharpness[rows] / np.maximum(nearby, 1e-12)
    kept = rows.tolist()
    for i in np.argsort(relative, kind="stable"):
        place = kept.index(rows[i])
        if relative[i] >= _BLURRED:
            break
        if 0 < place < len(kept) - 1 and path[kept[place + 1]] - path[kept[place - 1]] <= _MOST_GAP:
            kept.pop(place)
    return np.array(kept, dtype=np.int64)


def _scan_image(image: ByteArray) -> ByteArray:
    gray = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
    height, width = gray.shape
    if width <= _SCAN_WIDTH_PX:
        return np.asarray(gray)
    size = (_SCAN_WIDTH_PX, round(height * _SCAN_WIDTH_PX / width))
    return np.asarray(cv2.resize(gray, size, interpolation=cv2.INTER_AREA))


def _displacement(before: ByteArray, after: ByteArray) -> float:
    lost: float = _LOST_MOTION * before.shape[1]
    corners = cv2.goodFeaturesToTrack(before, _TRACKED_CORNERS, 0.01, 8)
    if corners is None or len(corners) < _FEWEST_CORNERS:
        return lost
    moved, status, _ = cv2.calcOpticalFlowPyrLK(before, after, corners, None, winSize=(15, 15), maxLevel=3)  # type: ignore[call-overload]
    tracked = status.ravel() == 1
    if tracked.sum() < _FEWEST_CORNERS:
        return lost
    return float(np.median(np.linalg.norm((moved - corners).reshape(-1, 2)[tracked], axis=1)))
