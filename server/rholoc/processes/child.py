"""Runs a function in a child process, so that native code can be killed, or crash, without harm to this process."""

import contextlib
import multiprocessing
import os
import signal
import threading
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from typing import Any, TypeVar, cast

from rholoc.errors import Cancelled, RholocError
from rholoc.processes.interrupts import interrupts_deferred
from rholoc.processes.limits import Limits, MemoryLimitExceeded, TimeLimitExceeded, limit_own_memory
from rholoc.processes.tree import descendants, group_memory_bytes, kill
from rholoc.progress import ProgressListener, Stage

Result = TypeVar("Result")

_SEND_EVERY_S = 0.1
_EXIT_TAKES_S = 0.05


class ChildDied(Exception):
    """The process ended without an answer.

    Attributes:
        reason: how, as ``signal 9`` or ``exit status 1``.
        was_killed: whether by SIGKILL, as a system does that is short of memory.
        held_bytes: the most memory that it was seen to hold.
    """

    def __init__(self, status: int, held_bytes: float = 0.0) -> None:
        self.was_killed, self.held_bytes = status == -signal.SIGKILL, held_bytes
        self.reason = f"signal {-status}" if status < 0 else f"exit status {status}"
        super().__init__(f"the process ended with {self.reason}")


class ChildFailed(Exception):
    """The function raised an error other than RholocError: its type and text, and its traceback as a note."""


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

    Function, arguments and result must be picklable. The process ends with this one, however that ends. If ``progress``
    or ``check`` raises, it is killed with everything that it started, and the error is raised.

    Args:
        function: a module's function whose last parameter is a progress listener.
        args: its other arguments.
        progress: called here with the progress that the function reports: the latest of each stage, at most every
            ``poll_s`` seconds.
        check: called every ``poll_s`` seconds.
        poll_s: see there.
        grace_s: how long the function may take to stop by itself after ``progress`` or ``check`` raised
            :class:`rholoc.errors.Cancelled`, which its listener then raises too.
        limits: what the process may take; checked every ``poll_s`` seconds.
        niceness: added to this process's.
        own_group: whether it leads a process group of its own, which memory limits need.
        quiet: whether the output of native libraries is discarded.

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
    # Not among the process's own arguments: multiprocessing would wait for ever for a child that dies while it starts.
    process = context.Process(target=_main, args=(theirs,), name=f"rholoc-{function.__name__}")
    try:
        with interrupts_deferred():
            process.start()
        theirs.close()
        with contextlib.suppress(OSError):  # it has died, which is noticed below
            ours.send((conditions, function, args))
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
    """Wait for the answer, passing on progress. Raises ChildDied, TimeLimitExceeded, MemoryLimitExceeded, or what
    ``check`` raises.
    """
    deadline_s, held_bytes = time.monotonic() + limits.time_s, 0.0
    while True:
        check()
        alive = process.is_alive()  # checked first: what a dead process had sent is received below
        reports, answer = _receive(connection, time.monotonic() + poll_s)
        for report in reports:
            progress(report.stage, report.fraction, report.message)
        if answer is not None:
            return answer
        if not alive:
            raise ChildDied(process.exitcode or 0, held_bytes)
        if time.monotonic() > deadline_s:
            raise TimeLimitExceeded
        if process.pid is not None:
            held_bytes = max(held_bytes, group_memory_bytes(process.pid))
        if held_bytes > limits.memory_bytes:
            raise MemoryLimitExceeded(held_bytes)


def _receive(connection: Connection, until: float) -> tuple[list[_Progress], _Returned | _Raised | None]:
    """The latest progress of each stage until ``until`` (monotonic clock) or the answer; and the answer, or None."""
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
        time.sleep(_EXIT_TAKES_S)  # the process closed its end: it is about to exit
    return list(latest.values()), None


def _kill(process: SpawnProcess) -> None:
    """Kill the process and those that it started, and wait for its end; does nothing if it was never started."""
    if process.pid is None:  # it was never started
        return
    left = descendants(process.pid)
    with contextlib.suppress(ProcessLookupError, PermissionError):
        # Its own group also includes processes whose parents have ended; without one, no group has this number.
        os.killpg(process.pid, signal.SIGKILL)
    process.kill()
    kill(left)
    process.join()
    process.close()


def _main(connection: Connection) -> None:
    """Body of the child process: receives function, arguments and conditions by the connection; sends the answer."""
    conditions, function, args = cast(tuple[_Conditions, Callable[..., Any], tuple[Any, ...]], connection.recv())
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # pycolmap's own handler may deadlock
    if conditions.own_group:
        os.setsid()
    os.nice(conditions.niceness)
    limit_own_memory(conditions.limits.memory_bytes)
    if conditions.quiet:
        _silence_native_code()
    listener = _Listener(connection)
    threading.Thread(target=_watch_parent, args=(connection, listener, conditions.own_group), daemon=True).start()
    with contextlib.suppress(Cancelled):  # there is nobody left to report it to
        listener.send(_answer(function, args, listener))


def _answer(function: Callable[..., Any], args: tuple[Any, ...], listener: ProgressListener) -> _Returned | _Raised:
    """Result of the function, or the error that it raised; ChildFailed for others than RholocError, MemoryError."""
    try:
        return _Returned(function(*args, listener))
    except (RholocError, MemoryError) as error:
        return _Raised(error)
    except Exception as error:
        failed = ChildFailed(named(error))
        failed.add_note(traceback.format_exc())
        return _Raised(failed)


def named(error: Exception) -> str:
    """One line: the error's type, and the first line of its text that is not empty, if there is one."""
    line = next((line.strip() for line in str(error).splitlines() if line.strip()), "")
    return f"{type(error).__name__}: {line}" if line else type(error).__name__


class _Listener:
    """The function's progress listener: reports to the parent, and raises Cancelled once the parent has cancelled."""

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
        """Send a message to the parent. Raises Cancelled if that has ended."""
        try:
            with self._lock:
                self._connection.send(message)
        except OSError as error:
            raise Cancelled("The process that asked for the work is gone.") from error


def _watch_parent(connection: Connection, listener: _Listener, own_group: bool) -> None:
    """Set the listener's ``cancelled`` if the parent cancels; kill this process and its children if the parent ends."""
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
    """Discard what native libraries print; what matters is raised as an error."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(nowhere, stream)
    os.close(nowhere)
