"""Keyframes: sharp frames at even steps of image motion."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import cv2
import numpy as np
import pytest
from synthetic_walk import followed

from rholoc.geometry import ByteArray, FloatArray
from rholoc.recordings import MemoryFrames
from rholoc.trajectory.visual.flow import track_corners
from rholoc.trajectory.visual.keyframe_features import KeyframeFeatures
from rholoc.trajectory.visual.keyframes import MAX_PICTURES, KeyframeSteps, choose_keyframes, is_film, may_be_film


def _times(count: int) -> FloatArray:
    return np.arange(count) / 30


def test_keyframes_are_sharp_and_evenly_spaced_in_motion() -> None:
    rng = np.random.default_rng(0)
    motion = rng.uniform(0.002, 0.012, 600)
    sharpness = np.where(np.arange(600) % 3 == 0, 1.0, 0.1)
    rows = choose_keyframes(_times(600), motion, sharpness)
    assert np.all(np.diff(rows) > 0)
    assert 60 <= len(rows) <= 160
    assert np.mean(sharpness[rows] == 1.0) > 0.9
    assert np.diff(np.cumsum(motion)[rows]).max() < 0.11


def test_blurred_frames_are_no_keyframes() -> None:
    """A hand shakes for a tenth of a second in every half: these frames are left out, the walk does not break."""
    rng = np.random.default_rng(1)
    blurred = np.arange(900) % 15 < 3
    sharpness = np.where(blurred, 0.2, 1.0) * rng.uniform(0.8, 1.0, 900)
    motion = np.where(blurred, 0.012, 0.006)
    rows = choose_keyframes(_times(900), motion, sharpness)
    assert not blurred[rows].any()
    assert np.diff(np.cumsum(motion)[rows]).max() <= 0.2
    assert len(rows) > 80


def test_a_walk_does_not_break_where_all_of_it_is_blurred() -> None:
    sharpness = np.where((np.arange(600) > 250) & (np.arange(600) < 350), 0.1, 1.0)
    motion = np.full(600, 0.01)
    rows = choose_keyframes(_times(600), motion, sharpness)
    assert np.diff(np.cumsum(motion)[rows]).max() <= 0.2


def test_at_rest_there_are_few() -> None:
    """Ten seconds of rest between moves: about one keyframe in 1.4 s, so that the IMU is held by pictures."""
    motion = np.concatenate([np.full(50, 0.03), np.zeros(300), np.full(50, 0.03)])
    rows = choose_keyframes(_times(400), motion, np.ones(400))
    resting = (rows >= 50) & (rows < 350)
    assert 5 <= resting.sum() <= 9
    assert np.diff(_times(400)[rows]).max() < 3.0


def test_a_longer_walk_has_more_keyframes_without_end() -> None:
    counts = [len(choose_keyframes(_times(n), np.full(n, 0.02), np.ones(n))) for n in (2_000, 20_000, 40_000)]
    assert counts[1] > 5_000
    assert abs(counts[2] - 2 * counts[1]) <= 2
    assert abs(counts[1] - 10 * counts[0]) <= 10


def test_a_fast_turn_does_not_take_every_frame() -> None:
    motion = np.full(300, 0.2)
    rows = choose_keyframes(_times(300), motion, np.ones(300))
    assert np.diff(_times(300)[rows]).min() >= 0.08 - 1e-9


def test_an_empty_recording_has_none() -> None:
    assert len(choose_keyframes(np.zeros(0), np.zeros(0), np.zeros(0))) == 0


@pytest.mark.parametrize(
    ("motion", "step"),
    [(0.0125, 0.05), (0.0026, 0.026), (0.001, 0.01), (0.0005, 0.01)],
)
def test_a_step_is_a_twentieth_of_the_picture_and_less_in_short_walks(motion: float, step: float) -> None:
    """Of six hundred frames: where they move by less than three pictures in all, sixty steps, but of a hundredth."""
    times = 0.05 * np.arange(600)
    rows = choose_keyframes(times, np.full(600, motion), np.ones(600))
    steps = 600 * (motion / step + 0.05 / 1.4)  # at rest time makes steps, too
    assert len(rows) == pytest.approx(steps, rel=0.02)


def test_the_sharpest_frame_of_a_step_is_known_once_the_next_begins() -> None:
    steps = KeyframeSteps(0.1)
    assert steps.sharpest is None
    assert steps.end() is None
    told = []
    for row, (motion, sharpness) in enumerate(
        [(0.0, 1.0), (0.04, 3.0), (0.04, 3.0), (0.04, 2.0), (0.04, 5.0), (0.1, 1.0)]
    ):
        told.append(steps.add(row, 7 + 0.1 * row, motion, sharpness))
    assert told == [None, None, None, 1, None, 4]
    assert steps.sharpest == 5
    assert steps.end() == 5
    assert steps.end() is None  # once


@pytest.mark.parametrize(("apart_s", "kept"), [(0.079, 10), (0.081, 20)])
def test_two_keyframes_are_eight_hundredths_of_a_second_apart(apart_s: float, kept: int) -> None:
    assert len(choose_keyframes(5 + apart_s * np.arange(20), np.full(20, 0.9), np.ones(20))) == kept


def test_at_rest_one_is_taken_every_second_and_two_fifths() -> None:
    times = 100 + np.arange(0, 28.0, 0.05)
    rows = choose_keyframes(times, np.zeros(len(times)), np.ones(len(times)))
    np.testing.assert_allclose(times[rows], 100 + 1.4 * np.arange(20), atol=0.051)


@pytest.mark.parametrize(("interval_s", "film"), [(1 / 30, True), (0.5, False), (np.nan, False)])
def test_pictures_that_seconds_pass_between_are_a_set_however_little_the_camera_moves(
    interval_s: float, film: bool
) -> None:
    """A film's frames are thinned to even steps of motion; of a desk at 2 Hz, 26 of 29 pictures were left."""
    corners = np.random.default_rng(0).uniform(0, 480, (100, 2))
    pixels = corners + np.arange(30.0)[:, None, None]
    flow = followed(interval_s * np.arange(30.0), (640, 480), pixels, np.ones((30, 100), np.bool_))
    assert is_film(replace(flow, timed=bool(np.isfinite(interval_s)))) is film


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


@pytest.mark.slow
def test_of_a_walk_of_some_length_every_frame_is_decoded_once_and_certain_keyframes_are_extracted() -> None:
    certain = {0, 7, 133, 219}
    rows, again = _foreseen(Walk(220), sorted(certain))
    assert certain <= set(rows)
    assert len(set(rows) - certain) >= 60
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
    picture = np.full((360, 1920), 200, np.float32)
    rng = np.random.default_rng(0)
    picture[rng.integers(20, 340, 400), rng.integers(20, 1900, 400)] -= 600
    speckled = np.repeat(cv2.GaussianBlur(picture, (0, 0), 1.4)[..., None], 3, axis=2).astype(np.uint8)
    small = cv2.resize(speckled, (960, 180), interpolation=cv2.INTER_AREA)
    with KeyframeFeatures(MemoryFrames([speckled], 1.0)) as whole, KeyframeFeatures(MemoryFrames([small], 1.0)) as half:
        rows = np.array([0])
        found, reduced = whole.of(rows)[0], half.of(rows)[0]
    assert len(found) > 1.5 * len(reduced)
    assert found.pixels.max() > 1000


def test_weak_features_come_on_top_of_those_at_twice_the_size() -> None:
    """On plaster whose faint texture has weak features enough, the specks would be lost at the usual size."""
    rng = np.random.default_rng(0)
    picture = 200 + 6 * cv2.GaussianBlur(rng.normal(0, 30, (360, 1920)).astype(np.float32), (0, 0), 8.0)
    specks = np.zeros((360, 1920), np.float32)
    specks[rng.integers(20, 340, 100), rng.integers(20, 1900, 100)] = 600
    picture -= cv2.GaussianBlur(specks, (0, 0), 1.4)
    plaster = np.repeat(picture.clip(0, 255)[..., None], 3, axis=2).astype(np.uint8)
    rows = np.array([0])
    with KeyframeFeatures(MemoryFrames([plaster], 1.0)) as features:
        usual, of_set = features.of(rows)[0], features.of_set(rows)[0]
    away = np.linalg.norm(usual.pixels[:, None] - of_set.pixels, axis=2).min(axis=1)
    assert len(of_set) > 2 * len(usual) > 100
    assert (away < 0.5).mean() > 0.95


def test_weak_features_count_in_a_set_of_dim_pictures() -> None:
    """A wooden door in a dim bedroom showed sixty features, too few to link the pictures before it and after it."""
    texture = cv2.GaussianBlur(np.random.default_rng(0).normal(0, 1, (480, 640)).astype(np.float32), (0, 0), 2.0)
    dim, bright = (
        np.repeat((100 + contrast * texture).round().clip(0, 255)[..., None], 3, axis=2).astype(np.uint8)
        for contrast in (20, 200)
    )
    for pictures, weak in (([dim, dim, bright], True), ([dim, bright, bright], False)):
        rows = np.arange(3)
        with KeyframeFeatures(MemoryFrames(pictures, 1.0)) as features:
            usual, of_set = features.of(rows), features.of_set(rows)
        assert len(usual[0]) < 600
        assert (len(of_set[0]) > 1000) is weak
        assert of_set[2] is usual[2]


@pytest.mark.parametrize(
    ("count", "timed", "film"), [(MAX_PICTURES, False, False), (MAX_PICTURES + 1, False, True), (10, True, True)]
)
def test_up_to_three_hundred_pictures_without_times_are_no_film(
    count: int, timed: bool, film: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    walk = Walk(count)
    monkeypatch.setattr(walk, "timed", timed)
    assert may_be_film(walk) is film
