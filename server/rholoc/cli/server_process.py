"""Processes beside a command, that do not outlive it: a server as a user would start it, work in the background."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

from rholoc.errors import RholocError

_START_TIMEOUT_S = 60.0
_STOP_TIMEOUT_S = 2.0  # then what is left of the server and its workers is killed
_POLL_S = 0.1
_STAT_PARENT = 1  # field of /proc/PID/stat after the process's name
_INTERRUPTS = (signal.SIGINT, signal.SIGTERM)


@dataclass(frozen=True)
class RunningServer:
    """Where a server answers and where its log is."""

    url: str
    log: Path


@contextmanager
def running_server(maps_dir: Path, data_dir: Path, log: Path) -> Iterator[RunningServer]:
    """``rholoc serve`` with its worker on a free port of this machine; stopped at the end, whatever happens.

    A job that it is working on is given up.

    Raises:
        RholocError: it does not answer.
    """
    port = _free_port()
    server = RunningServer(f"http://127.0.0.1:{port}", log)
    command = [sys.executable, "-m", "rholoc", "serve", "--host", "127.0.0.1", "--port", str(port)]
    command += ["--maps", str(maps_dir), "--data", str(data_dir)]
    process: subprocess.Popen[bytes] | None = None
    with log.open("wb") as output, interruptible():
        try:
            with _interrupts_deferred():
                # In a session of its own: Ctrl-C comes to us alone, and we stop the server in order.
                process = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT, start_new_session=True)
            _wait_until_it_answers(process, server)
            yield server
        finally:
            if process is not None:
                _stop(process)


@contextmanager
def interruptible() -> Iterator[None]:
    """While it lasts, the first SIGINT or SIGTERM ends this process by way of every ``finally``; later ones wait.

    Python leaves SIGTERM to the system, and SIGINT too where whoever started it had that ignored. Within another one it
    changes nothing.
    """
    if _interrupt in (signal.getsignal(number) for number in _INTERRUPTS):
        yield
        return
    before = {number: signal.signal(number, _interrupt) for number in _INTERRUPTS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _interrupt(_signal: int, _frame: FrameType | None) -> None:
    for number in _INTERRUPTS:
        signal.signal(number, signal.SIG_IGN)
    raise KeyboardInterrupt


@contextmanager
def _interrupts_deferred() -> Iterator[None]:
    """SIGINT and SIGTERM act when the block is left: one that came while a process starts would lose track of it."""
    arrived: list[int] = []
    before = {number: signal.signal(number, lambda number, _: arrived.append(number)) for number in _INTERRUPTS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if arrived:
            signal.raise_signal(arrived[0])


@contextmanager
def in_background(*command: object) -> Iterator[Callable[[], None]]:
    """A ``rholoc`` command in a process of its own, killed when the block is left; yields what waits for its end.

    Raises:
        RholocError: by the call of what is yielded: the command failed.
    """
    arguments = [sys.executable, "-m", "rholoc", *map(str, command)]
    process: subprocess.Popen[str] | None = None

    def wait() -> None:
        assert process is not None
        _, errors = process.communicate()
        if process.returncode:
            last = next(reversed(errors.splitlines()), "It ended unexpectedly; it may need more memory.")
            raise RholocError(f"rholoc {command[0]} failed in the background.", last)

    try:
        with _interrupts_deferred():
            # In a session of its own: Ctrl-C comes to us alone.
            process = subprocess.Popen(
                arguments, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, start_new_session=True, text=True
            )
        yield wait
    finally:
        if process is not None:
            process.kill()
            process.communicate()


def _wait_until_it_answers(process: subprocess.Popen[bytes], server: RunningServer) -> None:
    import httpx

    deadline = time.monotonic() + _START_TIMEOUT_S
    while time.monotonic() < deadline and process.poll() is None:
        with suppress(httpx.TransportError):
            if httpx.get(f"{server.url}/healthz").is_success:
                return
        time.sleep(_POLL_S)
    raise RholocError("The server did not start.", f"Its log says why: {server.log}.")


def _stop(process: subprocess.Popen[bytes]) -> None:
    """End a server in order if it is quick about it, and leave none of its workers behind."""
    left = set(_descendants(process.pid))  # asked while the server lives: it is what holds them together
    process.terminate()
    with suppress(subprocess.TimeoutExpired):
        process.wait(_STOP_TIMEOUT_S)
    left.update(_descendants(process.pid))
    process.kill()  # first, or it would start its worker again
    for pid in left:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
    process.wait()


def _descendants(pid: int) -> list[int]:
    """The processes that a process started, and those that they did; none where the system does not tell."""
    children: dict[int, list[int]] = {}
    for file in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):  # it has ended
            fields = file.read_text(encoding="utf-8", errors="replace").rsplit(")", 1)[1].split()
            children.setdefault(int(fields[_STAT_PARENT]), []).append(int(file.parent.name))
    found = list(children.get(pid, ()))
    for one in found:  # which grows meanwhile
        found += children.get(one, ())
    return found


def _free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port: int = listener.getsockname()[1]
    return port
