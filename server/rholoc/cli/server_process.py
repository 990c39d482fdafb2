"""A server as a user would start it, that cannot outlive whoever started it."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

from rholoc.errors import RholocError

_START_TIMEOUT_S = 60.0
_STOP_TIMEOUT_S = 30.0
_POLL_S = 0.1


@dataclass(frozen=True)
class RunningServer:
    """Where a server answers and where its log is."""

    url: str
    log: Path


@contextmanager
def running_server(maps_dir: Path, data_dir: Path, log: Path) -> Iterator[RunningServer]:
    """``rholoc serve`` with its worker on a free port of this machine; stopped at the end, whatever happens.

    Raises:
        RholocError: it does not answer.
    """
    port = _free_port()
    server = RunningServer(f"http://127.0.0.1:{port}", log)
    command = [sys.executable, "-m", "rholoc", "serve", "--host", "127.0.0.1", "--port", str(port)]
    command += ["--maps", str(maps_dir), "--data", str(data_dir)]
    with log.open("wb") as output, _terminated_as_interrupted():
        # In a session of its own: Ctrl-C comes to us alone, and we stop the server in order.
        process = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT, start_new_session=True)
        try:
            _wait_until_it_answers(process, server)
            yield server
        finally:
            _stop(process)


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
    process.terminate()
    try:
        process.wait(_STOP_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


@contextmanager
def _terminated_as_interrupted() -> Iterator[None]:
    """While it lasts, SIGTERM ends this process as Ctrl-C does: by way of every ``finally``."""

    def interrupt(_signal: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port: int = listener.getsockname()[1]
    return port
