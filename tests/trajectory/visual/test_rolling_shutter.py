"""Rows that were read one after the other are put where they were at one time."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
import pytest
from synthetic_walk import followed

from rholoc.features import Channel, FeatureSet
from rholoc.geometry import ByteArray, FloatArray, IntArray
from rholoc.trajectory.visual.flow import track_corners
from rholoc.trajectory.visual.rolling_shutter import RollingShutter, measure_rolling_shutter

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
    def timed(self) -> bool:
        return True

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


_AFFINE = np.array([[30.0, -5.0, 2000.0], [4.0, 20.0, -900.0]]) / 1000  # px/s of (u, v, 1)


def test_a_row_is_late_by_its_share_of_the_readout() -> None:
    """The middle row not at all, the first half of the readout too early."""
    shutter = RollingShutter(0.02, 480, np.stack([np.zeros((2, 3)), 1000 * _AFFINE]))
    pixels = np.array([[100.0, 239.5], [100.0, -0.5], [100.0, 479.5], [300.0, 119.5]])
    late_s = np.array([0.0, -0.01, 0.01, -0.005])
    speed = np.column_stack([pixels, np.ones(4)]) @ (1000 * _AFFINE).T
    np.testing.assert_allclose(shutter.pixels_at_once(1, pixels), pixels - late_s[:, None] * speed)
    np.testing.assert_array_equal(shutter.pixels_at_once(0, pixels), pixels)
    np.testing.assert_array_equal(shutter.take(np.array([1])).velocities, [1000 * _AFFINE])


def _moves(count: int, wrong: int = 0) -> tuple[FloatArray, FloatArray]:
    """Corners before and after a motion that is affine in their places midway, some of which go elsewhere."""
    rng = np.random.default_rng(0)
    middle = rng.uniform([0, 0], _SIZE, (count, 2))
    moved = np.column_stack([middle, np.ones(count)]) @ _AFFINE.T
    moved[:wrong] += [40.0, -30.0]
    return middle - moved / 2, middle + moved / 2


@pytest.mark.parametrize(("row", "seconds"), [(0, 0.1), (2, 0.3), (4, 0.2)])
def test_speed_is_between_the_frame_before_and_the_one_after(row: int, seconds: float) -> None:
    times = np.array([10.0, 10.1, 10.2, 10.4, 10.6])
    start, end = _moves(30)
    ends = (max(row - 1, 0), min(row + 1, 4))
    pixels = np.array([start + (end - start) * (k - ends[0]) / (ends[1] - ends[0]) for k in range(5)])
    flow = followed(times, _SIZE, pixels, np.ones((5, 30), np.bool_))
    found = measure_rolling_shutter(flow, np.array([row]), 0.015)
    np.testing.assert_allclose(found.velocities[0], _AFFINE / seconds, atol=1e-6)
    assert (found.readout_s, found.height) == (0.015, 480)
    alone = followed(times[:1], _SIZE, pixels[:1], np.ones((1, 30), np.bool_))
    assert not measure_rolling_shutter(alone, np.array([0]), 0.015).velocities.any()
