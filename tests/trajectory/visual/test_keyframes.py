"""Keyframes: sharp frames at even steps of image motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic_walk import followed

from rholoc.geometry import FloatArray
from rholoc.trajectory.visual.keyframes import KeyframeSteps, choose_keyframes, is_film


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
