"""Rows that were read one after the other are put where they were at one time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
import pytest

from rholoc.features import Channel, FeatureSet
from rholoc.geometry import ByteArray, FloatArray, IntArray
from rholoc.trajectory.visual.flow import track_corners
from rholoc.trajectory.visual.rolling_shutter import measure_rolling_shutter

_READOUT_S = 0.015
_SIZE = (640, 480)
_ROLL_RATE = 0.5  # rad/s, about the image's middle
_SHIFT_RATE = np.array([250.0, -90.0])  # px/s


def _seen_at(points: FloatArray, seconds: FloatArray) -> FloatArray:
    """Where points (N, 2) of the first picture are after so many seconds (N,)."""
    middle = np.array(_SIZE) / 2
    c, s = np.cos(_ROLL_RATE * seconds), np.sin(_ROLL_RATE * seconds)
    x, y = (points - middle).T
    return np.column_stack([c * x - s * y, s * x + c * y]) + middle + seconds[:, None] * _SHIFT_RATE


@dataclass(frozen=True, eq=False)
class _Film:
    """A picture that turns and moves, read out in 15 ms, 30 times a second."""

    picture: ByteArray = field(
        default_factory=lambda: cv2.GaussianBlur(
            np.random.default_rng(0).integers(0, 255, (*_SIZE[::-1], 3), dtype=np.uint8), (0, 0), 2
        )
    )

    @property
    def times(self) -> FloatArray:
        return np.arange(5) / 30.0

    @property
    def numbers(self) -> IntArray:
        return np.arange(5)

    @property
    def size(self) -> tuple[int, int]:
        return _SIZE

    def images(self, rows: Sequence[int]) -> Iterator[ByteArray]:
        return (self._image(float(self.times[row])) for row in rows)

    def _image(self, time: float) -> ByteArray:
        v, u = np.mgrid[: _SIZE[1], : _SIZE[0]].astype(np.float64)
        pixels = np.column_stack([u.ravel(), v.ravel()])
        read_s = time + ((pixels[:, 1] + 0.5) / _SIZE[1] - 0.5) * _READOUT_S
        middle = np.array(_SIZE) / 2
        x, y = (pixels - middle - read_s[:, None] * _SHIFT_RATE).T
        c, s = np.cos(_ROLL_RATE * read_s), np.sin(_ROLL_RATE * read_s)
        source = (np.column_stack([c * x + s * y, -s * x + c * y]) + middle).reshape(*_SIZE[::-1], 2)
        return cv2.remap(self.picture, source.astype(np.float32), None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)


def _features(pixels: FloatArray) -> FeatureSet:
    zeros = np.zeros(len(pixels), np.float32)
    return FeatureSet(
        pixels.astype(np.float32), np.full(len(pixels), Channel.L), np.zeros((len(pixels), 32), np.uint8), zeros, zeros
    )


@pytest.mark.parametrize("row", [0, 2, 4])
def test_features_are_put_where_they_were_at_one_time(row: int) -> None:
    film = _Film()
    points = np.random.default_rng(1).uniform((80, 60), (560, 420), (200, 2))
    time = film.times[row]
    at_once = _seen_at(points, np.full(200, time))
    rolling = at_once.copy()
    for _ in range(5):
        rolling = _seen_at(points, time + ((rolling[:, 1] + 0.5) / _SIZE[1] - 0.5) * _READOUT_S)
    shutter = measure_rolling_shutter(track_corners(film), np.array([1, row] if row > 1 else [row, 3]), _READOUT_S)
    corrected = shutter.at_once(1 if row > 1 else 0, _features(rolling)).pixels
    assert np.abs(rolling - at_once).max() > 1.2
    assert np.abs(corrected - at_once).max() < 0.15


def test_what_cannot_be_tracked_is_left_where_it_is() -> None:
    blank = _Film(np.full((*_SIZE[::-1], 3), 128, np.uint8))
    shutter = measure_rolling_shutter(track_corners(blank), np.array([1, 3]), _READOUT_S)
    features = _features(np.array([[10.0, 20.0]]))
    np.testing.assert_array_equal(shutter.at_once(1, features).pixels, features.pixels)
    assert len(shutter.take(np.array([1])).velocities) == 1
