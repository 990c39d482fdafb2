"""A function in a child process."""

from __future__ import annotations

import os
import signal
import time

import pycolmap  # noqa: F401  # the child imports this module, and so installs pycolmap's handlers
import pytest

from rholoc.errors import Cancelled, InvalidRecording, MappingFailed
from rholoc.progress import ProgressListener, Stage, silent
from rholoc.trajectory.child import run_in_child


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


def _terminate_itself(progress: ProgressListener = silent) -> None:
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(60)


def test_a_child_ends_at_sigterm() -> None:
    """Also one that has imported pycolmap, whose own handler of the signal may wait for itself for ever."""
    with pytest.raises(MappingFailed, match=f"status -{int(signal.SIGTERM)}"):
        run_in_child(_terminate_itself, progress=silent, stage=Stage.POSES)


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
