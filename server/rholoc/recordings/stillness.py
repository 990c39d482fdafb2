"""Pauses of a walk, as the IMU feels them."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import uniform_filter1d

from rholoc.geometry import BoolArray, FloatArray
from rholoc.recordings.recording import Imu

MIN_PAUSE_S = 1.0
_MOMENT_S = 0.5
_TREMOR = 0.12  # rad/s, rms over a moment: a resting hand trembles with up to 0.09
_FORCE = 0.25  # m/s², standard deviation over a moment; a step feels like 1 and more
_WHILE_S = 1.0
_TURN = 0.045  # rad/s, of the mean over a while, in which tremor cancels out and slow turning does not


def is_still(imu: Imu) -> BoolArray:
    """Whether the device rests at each of the IMU's times, (M,): neither thrust nor turn, but for a hand's tremor."""
    if len(imu.times) < 2:
        return np.zeros(len(imu.times), dtype=np.bool_)
    interval_s = float(np.median(np.diff(imu.times)))
    moment, while_ = (max(1, round(span_s / interval_s)) for span_s in (_MOMENT_S, _WHILE_S))
    tremor = np.sqrt(_mean(np.sum(imu.angular_velocity**2, axis=1), moment))
    turn = np.linalg.norm(_mean(imu.angular_velocity, while_), axis=1)
    force = np.sqrt(_mean(np.sum((imu.acceleration - _mean(imu.acceleration, moment)) ** 2, axis=1), moment))
    return np.asarray((tremor < _TREMOR) & (turn < _TURN) & (force < _FORCE))


def pauses(imu: Imu, shortest_s: float = MIN_PAUSE_S) -> FloatArray:
    """Start and end (P, 2), in seconds, of every rest of at least ``shortest_s``."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], is_still(imu), [False]])))
    spans = np.column_stack([imu.times[edges[::2]], imu.times[edges[1::2] - 1]])
    return spans[spans[:, 1] - spans[:, 0] >= shortest_s]


def _mean(values: FloatArray, size: int) -> FloatArray:
    return np.asarray(uniform_filter1d(values, size, axis=0, mode="nearest"))
