"""Features of keyframes are extracted while the walk is looked at: what was foreseen is not decoded again."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import cv2
import numpy as np
import pytest

from rholoc.geometry import ByteArray, FloatArray
from rholoc.recordings import MemoryFrames
from rholoc.trajectory.visual.flow import track_corners
from rholoc.trajectory.visual.keyframe_features import KeyframeFeatures
from rholoc.trajectory.visual.keyframes import choose_keyframes

WALL = np.random.default_rng(0).integers(0, 255, (60, 900, 3), np.uint8).repeat(2, 0).repeat(2, 1)


class Walk:
    """Frames that slide along a wall of noise, four pixels a frame; what is decoded is counted."""

    size = (160, 120)
    timed = True

    def __init__(self, count: int, step_px: int = 4) -> None:
        self.times: FloatArray = np.arange(count) / 30
        self.numbers = np.arange(count)
        self.decoded: list[int] = []
        self._step_px = step_px

    def images(self, rows: Sequence[int]) -> Iterator[ByteArray]:
        for row in rows:
            self.decoded.append(row)
            yield np.ascontiguousarray(WALL[:, self._step_px * row : self._step_px * row + 160])


def _foreseen(walk: Walk, certain: Sequence[int] = ()) -> tuple[list[int], list[int]]:
    """Which keyframes there are, and what was decoded for their features once all had been looked at."""
    heard: list[float] = []
    shown: set[int] = set()
    with KeyframeFeatures(walk, certain, lambda row, _: shown.add(row)) as features:
        flow = track_corners(walk, show=features.foresee)
        assert walk.decoded == list(range(len(walk.times)))
        rows = np.union1d(choose_keyframes(flow.times, flow.motion, flow.sharpness), np.array(certain, np.int64))
        found = features.of(rows, lambda _, share, __="": heard.append(share))
    assert heard == pytest.approx(np.arange(1, len(rows) + 1) / len(rows))
    assert shown >= set(rows.tolist())
    with KeyframeFeatures(walk) as anew:
        for one, other in zip(found, anew.of(rows), strict=True):
            np.testing.assert_array_equal(one.descriptors, other.descriptors)
            np.testing.assert_array_equal(one.pixels, other.pixels)
    return rows.tolist(), walk.decoded[len(walk.times) : -len(rows)]


def test_of_a_walk_of_some_length_every_frame_is_decoded_once() -> None:
    rows, again = _foreseen(Walk(400))
    assert len(rows) >= 60
    assert again == []


def test_a_certain_keyframe_is_extracted_whatever_the_motion() -> None:
    rows, again = _foreseen(Walk(400), [0, 7, 133, 399])
    assert {0, 7, 133, 399} <= set(rows)
    assert again == []


def test_a_short_walk_takes_smaller_steps_that_are_decoded_again() -> None:
    rows, again = _foreseen(Walk(90))
    assert len(rows) > 20
    assert set(again) < set(rows)
    assert again == sorted(again)


def test_features_of_large_pictures_are_in_pixels_of_the_whole() -> None:
    (noise,) = Walk(1).images([0])
    large = cv2.resize(noise, (1920, 1440), interpolation=cv2.INTER_CUBIC)
    small = cv2.resize(large, (960, 720), interpolation=cv2.INTER_AREA)
    found, reduced = (KeyframeFeatures(MemoryFrames([image])).of(np.zeros(1, np.int64))[0] for image in (large, small))
    np.testing.assert_allclose(found.pixels, 2 * reduced.pixels + 0.5, atol=1e-3)
    np.testing.assert_allclose(found.sizes, 2 * reduced.sizes)


def test_few_images_wait_at_a_time() -> None:
    """All frames of a walk that jumps are keyframes: they are not all kept until there is time for them."""
    walk = Walk(40)
    with KeyframeFeatures(walk, range(40)) as features:
        for row, image in enumerate(walk.images(range(40))):
            features.foresee(row, image, 0.1, 1.0)
            assert sum(not future.done() for future in features._found.values()) <= 4
        assert len(features.of(np.arange(40))) == 40


def test_pictures_that_show_little_are_searched_at_twice_the_size() -> None:
    """White plaster shows fine specks alone, which vanish where a phone's picture is reduced."""
    picture = np.full((1440, 1920), 200, np.float32)
    rng = np.random.default_rng(0)
    picture[rng.integers(20, 1420, 400), rng.integers(20, 1900, 400)] -= 600
    speckled = np.repeat(cv2.GaussianBlur(picture, (0, 0), 1.4)[..., None], 3, axis=2).astype(np.uint8)
    small = cv2.resize(speckled, (960, 720), interpolation=cv2.INTER_AREA)
    with KeyframeFeatures(MemoryFrames([speckled], 1.0)) as whole, KeyframeFeatures(MemoryFrames([small], 1.0)) as half:
        rows = np.array([0])
        found, reduced = whole.of(rows)[0], half.of(rows)[0]
    assert len(found) > 1.5 * len(reduced)
    assert found.pixels.max() > 1000
