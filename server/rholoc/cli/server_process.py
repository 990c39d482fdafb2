"""Child processes of a command that do not outlive it: a server as users start it, and programs in the background."""

import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from rholoc.errors import RholocError
from rholoc.processes.interrupts import interruptible
from rholoc.processes.program import Program, running_program

_START_TIMEOUT_S = 200.0  # only a very busy machine takes more than a few seconds
_STOP_TIMEOUT_S = 2.0  # after which the server and its workers are killed
_POLL_S = 0.1


@dataclass(frozen=True)
class RunningServer:
    """URL and log file of a running server."""

    url: str
    log: Path


@contextmanager
def running_server(maps_dir: Path, data_dir: Path, log: Path) -> Iterator[RunningServer]:
    """``rholoc serve`` with its worker on a free local port; always stopped at the end of the block.

    A job in progress is abandoned.

    Raises:
        RholocError: it does not answer within 200 s, or ends before.
    """
    port = _free_port()
    server = RunningServer(f"http://127.0.0.1:{port}", log)
    command = ["serve", "--host", "127.0.0.1", "--port", port, "--maps", maps_dir, "--data", data_dir]
    with (
        log.open("wb") as output,
        interruptible(),
        running_program(
            "rholoc", *command, grace_s=_STOP_TIMEOUT_S, stdout=output, stderr=subprocess.STDOUT
        ) as program,
    ):
        _wait_until_it_answers(program, server)
        yield server


@contextmanager
def in_background(module: str, *arguments: object) -> Iterator[Callable[[], None]]:
    """Run ``python -m module`` in the background until the end of the block; yields a call that waits for it to end.

    Raises:
        RholocError: from that call: the program failed.
    """
    with running_program(module, *arguments, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as program:

        def wait() -> None:
            status, errors = program.wait()
            if status:
                last = next(reversed(errors.splitlines()), "It ended unexpectedly; it may need more memory.")
                raise RholocError(f"{module} failed in the background.", last)

        yield wait


def _wait_until_it_answers(program: Program, server: RunningServer) -> None:
    """Wait until the server answers. Raises RholocError if it ends before, or not within 200 s."""
    import httpx

    deadline = time.monotonic() + _START_TIMEOUT_S
    while time.monotonic() < deadline and program.running:
        with suppress(httpx.TransportError):
            if httpx.get(f"{server.url}/healthz").is_success:
                return
        time.sleep(_POLL_S)
    raise RholocError("The server did not start.", f"Its log says why: {server.log}.")


def _free_port() -> int:
    """A local port that was free just now."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port: int = listener.getsockname()[1]
    return port
