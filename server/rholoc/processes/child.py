"""A function in a child process, so that native code can be killed and may crash without taking us along."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from typing import Any, TypeVar

from rholoc.errors import Cancelled, RholocError
from rholoc.processes.interrupts import interrupts_deferred
from rholoc.processes.limits import Limits, MemoryLimitExceeded, TimeLimitExceeded, limit_own_memory
from rholoc.processes.tree import descendants, group_memory_bytes, kill
from rholoc.progress import ProgressListener, Stage

Result = TypeVar("Result")

_SEND_EVERY_S = 0.1
_EXIT_TAKES_S = 0.05


class ChildDied(Exception):
    """The process ended without an answer; ``reason`` says how, as ``signal 9`` or ``exit status 1``."""

    def __init__(self, status: int) -> None:
        self.reason = f"signal {-status}" if status < 0 else f"exit status {status}"
        super().__init__(f"the process ended with {self.reason}")


class ChildFailed(Exception):
    """The function raised an error other than RholocError; this one has its text."""


@dataclass(frozen=True)
class _Progress:
    stage: Stage
    fraction: float
    message: str


@dataclass(frozen=True)
class _Returned:
    result: Any


@dataclass(frozen=True)
class _Raised:
    error: RholocError | ChildFailed | MemoryError


@dataclass(frozen=True)
class _Conditions:
    limits: Limits
    niceness: int
    own_group: bool
    quiet: bool


def run_in_child(
    function: Callable[..., Result],
    *args: Any,
    progress: ProgressListener,
    check: Callable[[], object] = lambda: None,
    poll_s: float = 0.2,
    grace_s: float = 0.0,
    limits: Limits = Limits(),
    niceness: int = 0,
    own_group: bool = False,
    quiet: bool = False,
) -> Result:
    """Call ``function(*args, listener)`` in a new process and return what it returns.

    Function, arguments and result must be picklable. The process ends with this one, however that ends. When
    ``progress`` or ``check`` raises, it is killed with all that it started, and the error passed on.

    Args:
        function: a module's function whose last parameter is a progress listener.
        args: its other arguments.
        progress: hears here of the progress that the function reports, of every stage the latest, at most every
            ``poll_s`` seconds.
        check: called every ``poll_s`` seconds.
        poll_s: see there.
        grace_s: how long the function may take to stop by itself after ``progress`` or ``check`` raised
            :class:`rholoc.errors.Cancelled`, which its listener then raises too.
        limits: what the process may take; looked at every ``poll_s`` seconds.
        niceness: added to this process's.
        own_group: whether it leads a process group of its own, as limits of memory need.
        quiet: whether what native libraries print is dropped.

    Raises:
        RholocError: the function raised it.
        MemoryError: likewise.
        ChildFailed: the function raised another error.
        ChildDied: the process ended without an answer.
        LimitExceeded: it took more than ``limits`` allow.
    """
    conditions = _Conditions(limits, niceness, own_group, quiet)
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(
        target=_main, args=(theirs, conditions, function, args), name=f"rholoc-{function.__name__}"
    )
    try:
        with interrupts_deferred():
            process.start()
        theirs.close()
        answer = _follow(process, ours, progress, check, poll_s, limits)
    except Cancelled:
        with contextlib.suppress(OSError):
            ours.send(Cancelled.code)
        process.join(grace_s)
        raise
    finally:
        _kill(process)
        ours.close()
    if isinstance(answer, _Raised):
        raise answer.error
    result: Result = answer.result
    return result


def _follow(
    process: SpawnProcess,
    connection: Connection,
    progress: ProgressListener,
    check: Callable[[], object],
    poll_s: float,
    limits: Limits,
) -> _Returned | _Raised:
    """Wait for the answer, passing on progress."""
    last_s = time.monotonic() + limits.time_s
    while True:
        check()
        alive = process.is_alive()  # asked first: what a dead process had sent is received below
        reports, answer = _receive(connection, time.monotonic() + poll_s)
        for report in reports:
            progress(report.stage, report.fraction, report.message)
        if answer is not None:
            return answer
        if not alive:
            raise ChildDied(process.exitcode or 0)
        if time.monotonic() > last_s:
            raise TimeLimitExceeded
        if process.pid is not None and group_memory_bytes(process.pid) > limits.memory_bytes:
            raise MemoryLimitExceeded


def _receive(connection: Connection, until: float) -> tuple[list[_Progress], _Returned | _Raised | None]:
    """What comes until the time given, of each stage the latest; or until the answer, as soon as it comes."""
    latest: dict[Stage, _Progress] = {}
    try:
        while connection.poll(max(0.0, until - time.monotonic())):
            message = connection.recv()
            if not isinstance(message, _Progress):
                return list(latest.values()), message
            latest[message.stage] = message
            if time.monotonic() > until:
                break
    except (EOFError, OSError):
        time.sleep(_EXIT_TAKES_S)  # the process closed its end: it is about to be gone
    return list(latest.values()), None


def _kill(process: SpawnProcess) -> None:
    """End the process and those that it started."""
    if process.pid is None:  # it was never started
        return
    left = descendants(process.pid)
    with contextlib.suppress(ProcessLookupError, PermissionError):
        # A group of its own holds also those whose parents have ended; without one, no group has this number.
        os.killpg(process.pid, signal.SIGKILL)
    process.kill()
    kill(left)
    process.join()
    process.close()


def _main(connection: Connection, conditions: _Conditions, function: Callable[..., Any], args: tuple[Any, ...]) -> None:
    """The child."""
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # pycolmap's own handler may wait for itself for ever
    if conditions.own_group:
        os.setsid()
    os.nice(conditions.niceness)
    limit_own_memory(conditions.limits.memory_bytes)
    if conditions.quiet:
        _silence_native_code()
    listener = _Listener(connection)
    threading.Thread(target=_watch_parent, args=(connection, listener, conditions.own_group), daemon=True).start()
    with contextlib.suppress(Cancelled):  # nobody is left to hear of it
        listener.send(_answer(function, args, listener))


def _answer(function: Callable[..., Any], args: tuple[Any, ...], listener: ProgressListener) -> _Returned | _Raised:
    try:
        return _Returned(function(*args, listener))
    except (RholocError, MemoryError) as error:
        return _Raised(error)
    except Exception as error:
        return _Raised(ChildFailed(next(iter(str(error).splitlines()), type(error).__name__)))


class _Listener:
    """The function's progress listener: reports to the parent, and raises Cancelled when that wants no more."""

    def __init__(self, connection: Connection) -> None:
        self.cancelled = threading.Event()
        self._connection = connection
        self._lock = threading.Lock()
        self._stage: Stage | None = None
        self._next_s = 0.0

    def __call__(self, stage: Stage, fraction: float, message: str = "") -> None:
        if self.cancelled.is_set():
            raise Cancelled("The work was cancelled.")
        now = time.monotonic()
        if stage != self._stage or now >= self._next_s:
            self._stage, self._next_s = stage, now + _SEND_EVERY_S
            self.send(_Progress(stage, float(fraction), message))

    def send(self, message: _Progress | _Returned | _Raised) -> None:
        try:
            with self._lock:
                self._connection.send(message)
        except OSError as error:
            raise Cancelled("The process that asked for the work is gone.") from error


def _watch_parent(connection: Connection, listener: _Listener, own_group: bool) -> None:
    """Pass on the parent's wish to cancel; end with the parent, however it ends."""
    try:
        while True:
            connection.recv()
            listener.cancelled.set()
    except (EOFError, OSError):
        kill(descendants(os.getpid()))
        if own_group:
            os.killpg(0, signal.SIGKILL)
        os._exit(1)


def _silence_native_code() -> None:
    """Native libraries print what they meet on the way; what matters comes back as an error."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(nowhere, stream)
    os.close(nowhere)
