"""Pauses of a walk, from the IMU."""

import numpy as np
from scipy.ndimage import binary_dilation, uniform_filter1d

from rholoc.geometry import BoolArray, FloatArray
from rholoc.recordings.recording import Imu

MIN_PAUSE_S = 1.0
_WINDOW_S = 0.8  # shorter than a pause, which may have soft edges
_TREMOR = 0.12  # rad/s, rms: a resting hand trembles with up to 0.09
_TURN = 0.045  # rad/s, of the mean: tremor cancels out, slow turning does not
_FORCE = 0.25  # m/s², standard deviation; a step feels like 1 and more


def is_still(imu: Imu) -> BoolArray:
    """Mask (M,) of the IMU's rows that lie in some window of 0.8 s without motion.

    A window is without motion if the rate's rms is below 0.12 rad/s, its mean below 0.045 rad/s, and the acceleration's
    standard deviation below 0.25 m/s². All False with a single row.
    """
    if len(imu.times) < 2:
        return np.zeros(len(imu.times), dtype=np.bool_)
    size = max(1, round(_WINDOW_S / float(np.median(np.diff(imu.times)))))
    squared = _mean(np.sum(imu.angular_velocity**2, axis=1), size)
    tremor = np.sqrt(np.maximum(squared, 0))  # a running mean may fall a little below
    turn = np.linalg.norm(_mean(imu.angular_velocity, size), axis=1)
    variance = _mean(np.sum(imu.acceleration**2, axis=1), size) - np.sum(_mean(imu.acceleration, size) ** 2, axis=1)
    middles = (tremor < _TREMOR) & (turn < _TURN) & (variance < _FORCE**2)
    return np.asarray(binary_dilation(middles, np.ones(size, dtype=np.bool_)))


def pauses(imu: Imu, shortest_s: float = MIN_PAUSE_S) -> FloatArray:
    """Start and end (P, 2), in seconds, of every rest of at least ``shortest_s``."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], is_still(imu), [False]])))
    spans = np.column_stack([imu.times[edges[::2]], imu.times[edges[1::2] - 1]])
    return spans[spans[:, 1] - spans[:, 0] >= shortest_s]


def _mean(values: FloatArray, size: int) -> FloatArray:
    """Running mean of values (M, ...) over ``size`` rows around each."""
    return np.asarray(uniform_filter1d(values, size, axis=0, mode="nearest"))
