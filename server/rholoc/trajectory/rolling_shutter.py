"""A rolling shutter reads one row after the other: pixels → where they would be, had all rows been read at once."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from rholoc.features import FeatureSet
from rholoc.geometry import BoolArray, ByteArray, FloatArray, IntArray
from rholoc.recordings import FrameSource

_TRACKING_WIDTH_PX = 480
_TRACKED_CORNERS = 200
_FEWEST_CORNERS = 12
_ROUNDS = 3
_OUTLIER = 3.0  # times the median residual


@dataclass(frozen=True, eq=False)
class RollingShutter:
    """How the image moves in K frames while they are read.

    Attributes:
        readout_s: from the first row to the last; the frame's time is that of the middle row.
        height: of the images, in pixels.
        velocities: (K, 2, 3) pixels a second: affine functions of (u, v, 1).
    """

    readout_s: float
    height: int
    velocities: FloatArray

    def take(self, rows: IntArray) -> RollingShutter:
        """The same for some of the frames."""
        return replace(self, velocities=self.velocities[rows])

    def at_once(self, frame: int, features: FeatureSet) -> FeatureSet:
        """The features of frame 0..K-1 where they were when the middle row was read."""
        pixels = features.pixels.astype(np.float64)
        late_s = ((pixels[:, 1:] + 0.5) / self.height - 0.5) * self.readout_s
        velocity = pixels @ self.velocities[frame][:, :2].T + self.velocities[frame][:, 2]
        return replace(features, pixels=(pixels - late_s * velocity).astype(np.float32))


def measure_rolling_shutter(frames: FrameSource, rows: IntArray, readout_s: float) -> RollingShutter:
    """How the image moves in the frames ``rows`` (K,), increasing, from corners tracked to the frames beside.

    Where too few can be tracked, not at all.
    """
    last = len(frames.times) - 1
    before, after = np.maximum(rows - 1, 0), np.minimum(rows + 1, last)
    velocities = np.zeros((len(rows), 2, 3))
    kept: dict[int, ByteArray] = {}
    wanted = np.unique(np.concatenate([before, rows, after])).tolist()
    images = zip(wanted, frames.images(wanted), strict=True)
    for k, row in enumerate(rows):
        while int(after[k]) not in kept:
            number, image = next(images)
            kept[number] = _small(image)
        kept = {number: image for number, image in kept.items() if number >= before[k]}
        seconds = frames.times[after[k]] - frames.times[before[k]]
        if seconds > 0:
            affine = _flow(kept[int(row)], kept[int(before[k])], kept[int(after[k])]) / seconds
            scale = frames.size[0] / kept[int(row)].shape[1]
            velocities[k] = affine * (1, 1, scale)
    return RollingShutter(readout_s, frames.size[1], velocities)


def _flow(image: ByteArray, before: ByteArray, after: ByteArray) -> FloatArray:
    """How far points of ``image`` move from the frame before it to the one after it: (2, 3) affine, in its pixels."""
    corners = cv2.goodFeaturesToTrack(image, _TRACKED_CORNERS, 0.01, 8)
    if corners is None or len(corners) < _FEWEST_CORNERS:
        return np.zeros((2, 3))
    (start, is_start), (end, is_end) = (_tracked(image, other, corners) for other in (before, after))
    good = is_start & is_end
    A, moved = np.column_stack([corners.reshape(-1, 2), np.ones(len(corners))]), end - start
    affine = np.zeros((2, 3))
    for _ in range(_ROUNDS):
        if good.sum() < _FEWEST_CORNERS:
            return np.zeros((2, 3))
        affine = np.asarray(np.linalg.lstsq(A[good], moved[good], rcond=None)[0].T)
        residuals = np.linalg.norm(A @ affine.T - moved, axis=1)
        good = good & (residuals <= _OUTLIER * max(float(np.median(residuals[good])), 0.1))
    return affine


def _tracked(image: ByteArray, other: ByteArray, corners: Any) -> tuple[FloatArray, BoolArray]:
    moved, status, _ = cv2.calcOpticalFlowPyrLK(image, other, corners, None, winSize=(15, 15), maxLevel=3)  # type: ignore[call-overload]
    return moved.reshape(-1, 2), status.ravel() == 1


def _small(image: ByteArray) -> ByteArray:
    gray = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
    height, width = gray.shape
    size = (_TRACKING_WIDTH_PX, round(height * _TRACKING_WIDTH_PX / width))
    return np.asarray(cv2.resize(gray, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
