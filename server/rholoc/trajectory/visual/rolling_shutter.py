"""A rolling shutter reads one row after the other: pixels → where they would be, had all rows been read at once."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rholoc.features import FeatureSet
from rholoc.geometry import FloatArray, IntArray
from rholoc.trajectory.visual.flow import Flow

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

    def pixels_at_once(self, frame: int, pixels: FloatArray) -> FloatArray:
        """Pixels (N, 2) of frame 0..K-1 → where they were when the middle row was read."""
        late_s = ((pixels[:, 1:] + 0.5) / self.height - 0.5) * self.readout_s
        velocity = pixels @ self.velocities[frame][:, :2].T + self.velocities[frame][:, 2]
        return np.asarray(pixels - late_s * velocity)

    def at_once(self, frame: int, features: FeatureSet) -> FeatureSet:
        """The features of frame 0..K-1 where they were when the middle row was read."""
        pixels = self.pixels_at_once(frame, features.pixels.astype(np.float64))
        return replace(features, pixels=pixels.astype(np.float32))


def measure_rolling_shutter(flow: Flow, rows: IntArray, readout_s: float) -> RollingShutter:
    """How the image moves in the frames ``rows`` (K,), from corners followed from the frame before to the one after.

    Where too few can be followed, not at all.
    """
    last = len(flow.times) - 1
    velocities = np.zeros((len(rows), 2, 3))
    for k, row in enumerate(rows.tolist()):
        before, after = max(row - 1, 0), min(row + 1, last)
        seconds = flow.times[after] - flow.times[before]
        if seconds > 0:
            velocities[k] = _affine(*flow.shared(before, after)[1:]) / seconds
    return RollingShutter(readout_s, flow.size[1], velocities)


def _affine(start: FloatArray, end: FloatArray) -> FloatArray:
    """How far points move: (2, 3) of (u, v, 1), from where they were (N, 2) and where they come to (N, 2)."""
    middle, moved = (start + end) / 2, end - start
    A = np.column_stack([middle, np.ones(len(middle))])
    good = np.ones(len(middle), dtype=np.bool_)
    affine = np.zeros((2, 3))
    for _ in range(_ROUNDS):
        if good.sum() < _FEWEST_CORNERS:
            return np.zeros((2, 3))
        affine = np.asarray(np.linalg.lstsq(A[good], moved[good], rcond=None)[0].T)
        residuals = np.linalg.norm(A @ affine.T - moved, axis=1)
        good = good & (residuals <= _OUTLIER * max(float(np.median(residuals[good])), 0.1))
    return affine
