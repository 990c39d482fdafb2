"""The processes of this machine: those that a process started, and how much memory a process group holds."""

import os
from collections.abc import Iterable
from contextlib import suppress

import psutil


def descendants(pid: int) -> list[int]:
    """Process ids of the processes that a process started, and of those that they started; empty if it has ended."""
    with suppress(psutil.NoSuchProcess):
        return [child.pid for child in psutil.Process(pid).children(recursive=True)]
    return []


def group_memory_bytes(group: int) -> int:
    """Resident memory of all processes of a process group [bytes]."""
    held = 0
    for process in psutil.process_iter():
        with suppress(psutil.Error, ProcessLookupError):  # it has just ended
            if os.getpgid(process.pid) == group:
                held += process.memory_info().rss
    return held


def kill(pids: Iterable[int]) -> None:
    """Kill processes. Those that have already ended are skipped."""
    for pid in pids:
        with suppress(psutil.NoSuchProcess):
            psutil.Process(pid).kill()
