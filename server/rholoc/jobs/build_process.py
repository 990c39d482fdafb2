"""A job's build in a process of its own: it can be killed, and native code that crashes takes no worker with it."""

from __future__ import annotations

import contextlib
import logging
import math
import multiprocessing
import os
import resource
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from pathlib import Path

from rholoc.disk import is_full, storage_full
from rholoc.errors import Cancelled, RholocError
from rholoc.jobs.pipeline import MappingTask, Pipeline
from rholoc.jobs.table import Failure
from rholoc.progress import ProgressListener, Stage
from rholoc.recordings import MAX_FRAME_PIXELS

_log = logging.getLogger("rholoc.jobs")

_CONTAINER_MEMORY = Path("/sys/fs/cgroup/memory.max")
_NICENESS = 10  # requests of localization come first
_SEND_EVERY_S = 0.1
_RESERVED_BYTES = 2**30  # that libraries and threads reserve and never touch
_EXIT_TAKES_S = 0.05
_STAT_GROUP, _STAT_PAGES = 2, 21  # fields of /proc/PID/stat after the process's name


@dataclass(frozen=True)
class Limits:
    """What one build may take.

    Attributes:
        time_s: how long it may last.
        memory_bytes: how much memory its processes may hold together; watched on Linux alone.
        frame_pixels: how many pixels a frame of its video may have.
    """

    time_s: float = math.inf
    memory_bytes: float = math.inf
    frame_pixels: int = MAX_FRAME_PIXELS


def memory_bytes() -> float:
    """How much memory this machine has, or its container may use, whichever is less."""
    machine = float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    try:
        container = _CONTAINER_MEMORY.read_text(encoding="ascii").strip()
    except OSError:
        return machine
    return min(machine, float(container)) if container.isdigit() else machine


@dataclass(frozen=True)
class Progress:
    """One call of the progress listener."""

    stage: Stage
    fraction: float
    message: str


@dataclass(frozen=True)
class Finished:
    """The build ended, with a map or a failure."""

    failure: Failure | None


def build_in_process(
    pipeline: Pipeline,
    task: MappingTask,
    note: Callable[[Progress], None],
    wanted: Callable[[], bool],
    poll_s: float,
    cancel_grace_s: float,
    limits: Limits,
) -> Failure | None:
    """Run ``pipeline.build`` in a new process; returns why it failed, or None when the map file is there.

    Args:
        pipeline: what to run.
        task: what to run it on.
        note: hears of progress, at most every ``poll_s`` seconds.
        wanted: asked every ``poll_s`` seconds whether to go on.
        poll_s: see there.
        cancel_grace_s: how long the build may take to stop by itself when it is not wanted any more.
        limits: what the build may take; looked at every ``poll_s`` seconds.

    Raises:
        Cancelled: it was not wanted any more. The process has ended.
    """
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_child, args=(pipeline, task, theirs, limits), name="rholoc-build")
    process.start()
    theirs.close()
    try:
        return _follow(process, ours, note, wanted, poll_s, limits)
    except Cancelled:
        with contextlib.suppress(OSError):
            ours.send(Cancelled.code)
        process.join(cancel_grace_s)
        raise
    finally:
        _kill(process)
        ours.close()


def _follow(
    process: SpawnProcess,
    connection: Connection,
    note: Callable[[Progress], None],
    wanted: Callable[[], bool],
    poll_s: float,
    limits: Limits,
) -> Failure | None:
    """Wait for the end, passing on progress."""
    last_s = time.monotonic() + limits.time_s
    while True:
        alive = process.is_alive()  # asked first: what a dead process had sent is received below
        latest, finished = _receive(connection, time.monotonic() + poll_s)
        for progress in latest:
            note(progress)
        if finished is not None:
            return finished.failure
        if not alive:
            return _died(process)
        if not wanted():
            raise Cancelled("The job is not wanted any more.")
        if time.monotonic() > last_s:
            return _too_long(limits.time_s)
        if process.pid is not None and group_memory_bytes(process.pid) > limits.memory_bytes:
            return _too_much_memory(limits.memory_bytes)


def _receive(connection: Connection, until: float) -> tuple[list[Progress], Finished | None]:
    """What comes until the time given, of each stage the latest; or until the end, as soon as it comes."""
    latest: dict[Stage, Progress] = {}
    try:
        while connection.poll(max(0.0, until - time.monotonic())):
            message = connection.recv()
            if isinstance(message, Finished):
                return list(latest.values()), message
            latest[message.stage] = message
            if time.monotonic() > until:
                break
    except (EOFError, OSError):
        time.sleep(_EXIT_TAKES_S)  # the process closed its end: it is about to be gone
    return list(latest.values()), None


def _too_long(time_s: float) -> Failure:
    return Failure(
        "mapping_failed",
        f"Mapping took longer than the limit of {time_s:g} s.",
        "Record a shorter walk, or raise RHOLOC_JOB_TIME_LIMIT_S.",
    )


def _too_much_memory(memory_bytes: float) -> Failure:
    return Failure(
        "mapping_failed",
        f"Mapping needed more memory than the limit of {memory_bytes / 2**30:.3g} GiB.",
        "Record a shorter walk, or raise RHOLOC_JOB_MEMORY_GIB.",
    )


def group_memory_bytes(group: int) -> int:
    """The resident memory of all processes of a group; 0 where the system does not tell."""
    pages = 0
    for file in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = file.read_text(encoding="utf-8", errors="replace").rsplit(")", 1)[1].split()
        except OSError:  # it has ended
            continue
        if int(fields[_STAT_GROUP]) == group:
            pages += int(fields[_STAT_PAGES])
    return pages * resource.getpagesize()


def _died(process: SpawnProcess) -> Failure:
    code = process.exitcode or 0
    reason = f"signal {-code}" if code < 0 else f"exit status {code}"
    return Failure(
        "internal",
        f"The mapping process ended unexpectedly ({reason}).",
        "It may have run out of memory: retry, record a shorter walk, or give the worker more memory.",
    )


def _kill(process: SpawnProcess) -> None:
    """End the process and those that it started."""
    if process.pid is not None:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            # The child leads a group of its own, unless it is so young that it has not made it yet.
            os.killpg(process.pid, signal.SIGKILL)
    process.kill()
    process.join()
    process.close()


def _child(pipeline: Pipeline, task: MappingTask, connection: Connection, limits: Limits) -> None:
    os.setsid()
    os.nice(_NICENESS)
    _limit_memory(limits.memory_bytes)
    listener = _Listener(connection)
    threading.Thread(target=_watch_worker, args=(connection, listener), daemon=True).start()
    failure = run_build(pipeline, task, listener, limits)
    listener.send(Finished(failure))


def _limit_memory(memory_bytes: float) -> None:
    """Let one large allocation fail at once; what grows slowly the worker sees."""
    if math.isfinite(memory_bytes):
        _, hard = resource.getrlimit(resource.RLIMIT_DATA)
        soft = int(memory_bytes) + _RESERVED_BYTES
        resource.setrlimit(resource.RLIMIT_DATA, (soft if hard == resource.RLIM_INFINITY else min(soft, hard), hard))


def run_build(
    pipeline: Pipeline, task: MappingTask, listener: ProgressListener, limits: Limits = Limits()
) -> Failure | None:
    """Run ``pipeline.build`` in this process; returns why it failed, or None."""
    try:
        pipeline.build(task, listener)
    except RholocError as error:
        return describe(error)
    except MemoryError:
        return _too_much_memory(limits.memory_bytes)
    except OSError as error:
        return describe(storage_full()) if is_full(error) else unexpected(error)
    except Exception as error:
        return unexpected(error)
    return None


def describe(error: RholocError) -> Failure:
    """The failure that an error of ours makes."""
    return Failure(error.code, error.message, error.hint)


def unexpected(error: Exception) -> Failure:
    """The failure that a fault of the program makes; its traceback goes to the log only."""
    _log.error("A job failed unexpectedly.", exc_info=error)
    line = next(iter(str(error).splitlines()), "")
    return Failure(
        "internal",
        f"An unexpected {type(error).__name__} stopped the job{': ' + line[:200] if line else '.'}",
        "The worker's log says more. Retry; if it happens again, report it.",
    )


class _Listener:
    """The progress listener of the build: tells the worker, and raises Cancelled when the worker wants no more."""

    def __init__(self, connection: Connection) -> None:
        self.cancelled = threading.Event()
        self._connection = connection
        self._stage: Stage | None = None
        self._next_s = 0.0

    def __call__(self, stage: Stage, fraction: float, message: str = "") -> None:
        if self.cancelled.is_set():
            raise Cancelled("The job was cancelled.")
        now = time.monotonic()
        if stage != self._stage or now >= self._next_s:
            self._stage, self._next_s = stage, now + _SEND_EVERY_S
            self.send(Progress(stage, float(fraction), message))

    def send(self, message: Progress | Finished) -> None:
        try:
            self._connection.send(message)
        except OSError as error:
            raise Cancelled("The worker is gone.") from error


def _watch_worker(connection: Connection, listener: _Listener) -> None:
    """Pass on the worker's wish to cancel; end with the worker, however it ends."""
    try:
        while True:
            connection.recv()
            listener.cancelled.set()
    except (EOFError, OSError):
        os.killpg(0, signal.SIGKILL)
