"""Rolling-shutter correction: move pixels to their positions at the read-out of the middle row."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rholoc.features import FeatureSet
from rholoc.geometry import FloatArray, IntArray
from rholoc.trajectory.visual.flow import Flow

_MIN_CORNERS = 12
_ROUNDS = 3
_OUTLIER = 3.0  # times the median residual


@dataclass(frozen=True, eq=False)
class RollingShutter:
    """Image motion of K frames during their read-out.

    Attributes:
        readout_s: from the first row to the last; the frame's time is that of the middle row.
        height: of the images [px].
        velocities: (K, 2, 3) affine functions of (u, v, 1) [px/s].
    """

    readout_s: float
    height: int
    velocities: FloatArray

    def take(self, rows: IntArray) -> RollingShutter:
        """The motion of the frames in ``rows`` (M,), numbers 0..K-1."""
        return replace(self, velocities=self.velocities[rows])

    def pixels_at_once(self, frame: int, pixels: FloatArray) -> FloatArray:
        """Move pixels (N, 2) of frame 0..K-1 to their positions at the read-out of the middle row."""
        late_s = ((pixels[:, 1:] + 0.5) / self.height - 0.5) * self.readout_s
        velocity = pixels @ self.velocities[frame][:, :2].T + self.velocities[frame][:, 2]
        return np.asarray(pixels - late_s * velocity)

    def at_once(self, frame: int, features: FeatureSet) -> FeatureSet:
        """The features of frame 0..K-1 with pixels as at the read-out of the middle row."""
        pixels = self.pixels_at_once(frame, features.pixels.astype(np.float64))
        return replace(features, pixels=pixels.astype(np.float32))


def measure_rolling_shutter(flow: Flow, rows: IntArray, readout_s: float) -> RollingShutter:
    """Image motion of the frames ``rows`` (K,), from corners tracked from the frame before to the one after.

    Zero for frames with fewer than twelve corners.
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
    """Robust affine displacement (2, 3) of (u, v, 1), from points (N, 2) to their new positions (N, 2); 0 if N < 12."""
    middle, moved = (start + end) / 2, end - start
    A = np.column_stack([middle, np.ones(len(middle))])
    good = np.ones(len(middle), dtype=np.bool_)
    affine = np.zeros((2, 3))
    for _ in range(_ROUNDS):
        if good.sum() < _MIN_CORNERS:
            return np.zeros((2, 3))
        affine = np.asarray(np.linalg.lstsq(A[good], moved[good], rcond=None)[0].T)
        residuals = np.linalg.norm(A @ affine.T - moved, axis=1)
        good = good & (residuals <= _OUTLIER * max(float(np.median(residuals[good])), 0.1))
    return affine
