"""Keyframes, pairs of them, and the child process."""

from __future__ import annotations

import os
import time

import cv2
import numpy as np
import pytest

from rholoc.errors import Cancelled, InvalidRecording, MappingFailed
from rholoc.progress import ProgressListener, Stage, silent
from rholoc.recordings import MemoryFrames
from rholoc.trajectory.child import run_in_child
from rholoc.trajectory.keyframes import choose_keyframes, measure_motion
from rholoc.trajectory.loops import sequential_pairs


def test_keyframes_are_sharp_and_evenly_spaced_in_motion() -> None:
    rng = np.random.default_rng(0)
    motion = rng.uniform(0.002, 0.012, 600)
    sharpness = np.where(np.arange(600) % 3 == 0, 1.0, 0.1)
    rows = choose_keyframes(motion, sharpness)
    assert np.all(np.diff(rows) > 0)
    assert 60 <= len(rows) <= 160
    assert np.mean(sharpness[rows] == 1.0) > 0.9
    assert np.diff(np.cumsum(motion)[rows]).max() < 0.09


def test_blurred_frames_are_no_keyframes() -> None:
    """A hand shakes for a third of a second in every two: these frames are left out, also where a whole step is."""
    rng = np.random.default_rng(1)
    blurred = np.arange(900) % 60 < 10
    sharpness = np.where(blurred, 0.2, 1.0) * rng.uniform(0.8, 1.0, 900)
    motion = np.where(blurred, 0.012, 0.006)
    rows = choose_keyframes(motion, sharpness)
    assert not blurred[rows[1:-1]].any()
    assert np.diff(np.cumsum(motion)[rows]).max() <= 0.2
    assert len(rows) > 80


def test_a_walk_does_not_break_where_all_of_it_is_blurred() -> None:
    sharpness = np.where((np.arange(600) > 250) & (np.arange(600) < 350), 0.1, 1.0)
    motion = np.full(600, 0.01)
    rows = choose_keyframes(motion, sharpness)
    assert np.diff(np.cumsum(motion)[rows]).max() <= 0.2


def test_sharpness_tells_motion_blur() -> None:
    """Frames that were smeared while they were exposed are measured as less than half as sharp as their neighbours."""
    rng = np.random.default_rng(2)
    wall = cv2.GaussianBlur(rng.integers(0, 255, (240, 400, 3), dtype=np.uint8), (0, 0), 1.5)
    pictures = [wall[:, 3 * k : 3 * k + 320] for k in range(12)]
    pictures[5] = cv2.blur(pictures[5], (9, 1))
    motion, sharpness = measure_motion(MemoryFrames(pictures))
    assert sharpness[5] < 0.5 * np.delete(sharpness, 5).min()
    assert motion[1:5] == pytest.approx(3 / 320, abs=0.002)


def test_a_pause_gives_one_keyframe() -> None:
    motion = np.concatenate([np.full(50, 0.03), np.zeros(300), np.full(50, 0.03)])
    rows = choose_keyframes(motion, np.ones(400))
    assert np.sum((rows >= 50) & (rows < 350)) <= 1


def test_long_recordings_have_a_bounded_number_of_keyframes() -> None:
    assert len(choose_keyframes(np.full(20_000, 0.02), np.ones(20_000))) <= 400


def test_sequential_pairs_skip_nothing() -> None:
    pairs = sequential_pairs(10, 3)
    assert len(pairs) == len(set(pairs))
    assert {(i, i + 1) for i in range(9)} <= set(pairs)
    assert {j - i for i, j in pairs} == {1, 2, 3, 6}


def _add(a: int, b: int, progress: ProgressListener = silent) -> int:
    progress(Stage.POSES, 0.5, "half")
    return a + b


def _refuse(progress: ProgressListener = silent) -> None:
    raise InvalidRecording("no", "hint")


def _crash(progress: ProgressListener = silent) -> None:
    os.abort()


def _sleep(folder: str, progress: ProgressListener = silent) -> None:
    progress(Stage.POSES, 0.1, str(os.getpid()))
    time.sleep(60)


def test_a_child_returns_its_result_and_its_progress() -> None:
    told: list[float] = []
    assert run_in_child(_add, 2, 3, progress=lambda s, f, m="": told.append(f), stage=Stage.POSES) == 5
    assert 0.5 in told or told == [0.0]


def test_a_childs_error_arrives() -> None:
    with pytest.raises(InvalidRecording, match="no hint"):
        run_in_child(_refuse, progress=silent, stage=Stage.POSES)


def test_a_crashed_child_is_a_failed_mapping() -> None:
    with pytest.raises(MappingFailed, match="process died"):
        run_in_child(_crash, progress=silent, stage=Stage.POSES)


def test_a_cancelled_child_is_killed() -> None:
    pids: list[int] = []

    def cancel(stage: Stage, fraction: float, message: str = "") -> None:
        if message:
            pids.append(int(message))
            raise Cancelled("stop")

    with pytest.raises(Cancelled):
        run_in_child(_sleep, "", progress=cancel, stage=Stage.POSES)
    with pytest.raises(ProcessLookupError):
        os.kill(pids[0], 0)
