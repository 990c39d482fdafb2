"""Waiting for processes."""

import time
from collections.abc import Callable
from pathlib import Path

# A sitecustomize.py by which the worker of a server dies as soon as it is started, as if by a fault of native code.
BREAKS_WORKERS = """
import os, sys
if sys.orig_argv[1:3] == ["-m", "rholoc.worker"]:
    sys.stderr.write("its library is broken\\n")
    sys.stderr.flush()
    os.abort()
"""
TIMEOUT_S = 240.0  # only a stuck test takes so long, or a busy machine


def until(condition: Callable[[], bool], timeout_s: float = TIMEOUT_S) -> None:
    """Wait for a condition."""
    deadline = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline, "it did not happen in time"
        time.sleep(0.03)


def alive(pid: int) -> bool:
    """Whether a process runs; one that nobody waited for is dead all the same."""
    try:
        status = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8")
    except FileNotFoundError:
        return False
    return status.rsplit(")", 1)[1].split()[0] != "Z"
