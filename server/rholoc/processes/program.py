"""A ``python -m`` program beside this one, which ends it with all that it started."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import IO

from rholoc.processes.interrupts import interrupts_deferred
from rholoc.processes.tree import descendants, kill

BACKGROUND_NICENESS = 10  # of what has time: requests of localization come first


class Program:
    """A Python module that runs as a process. It leads a session of its own: Ctrl-C reaches only whoever started it.

    Args:
        module: what ``python -m`` runs.
        arguments: of its command line.
        first_input: what it finds on its standard input, which then stays open: its end asks the program to end.
        stdout: as for :class:`subprocess.Popen`.
        stderr: likewise.
    """

    def __init__(
        self,
        module: str,
        *arguments: object,
        first_input: bytes | None = None,
        stdout: int | IO[bytes] | None = None,
        stderr: int | IO[bytes] | None = None,
    ) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", module, *map(str, arguments)],
            stdin=None if first_input is None else subprocess.PIPE,
            stdout=stdout,
            stderr=stderr,
            start_new_session=True,
        )
        if first_input is not None:
            assert self._process.stdin is not None
            with suppress(BrokenPipeError):  # it has died already
                self._process.stdin.write(first_input)
                self._process.stdin.flush()

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    @property
    def running(self) -> bool:
        """Whether it has not ended."""
        return self._process.poll() is None

    def wait(self) -> tuple[int, str]:
        """Wait for its end; returns its exit status and, where that is a pipe, what it wrote to its standard error."""
        _, errors = self._process.communicate()
        return self._process.returncode, (errors or b"").decode(errors="replace")

    def stop(self, grace_s: float = 0.0) -> None:
        """Ask the program to end; kill what is left of it, and of what it started, after ``grace_s`` seconds."""
        left = set(descendants(self.pid))  # asked while the program lives: it is what holds them together
        if grace_s > 0 and self.running:
            self._ask_to_end()
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(grace_s)
            left.update(descendants(self.pid))
        self._process.kill()  # first, or it would start others again
        kill(left)
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout, self._process.stderr):
            if stream is not None:
                with suppress(BrokenPipeError):
                    stream.close()

    def _ask_to_end(self) -> None:
        if self._process.stdin is None:
            self._process.terminate()
        else:
            with suppress(BrokenPipeError):
                self._process.stdin.close()


@contextmanager
def running_program(
    module: str,
    *arguments: object,
    grace_s: float = 0.0,
    stdout: int | IO[bytes] | None = None,
    stderr: int | IO[bytes] | None = None,
) -> Iterator[Program]:
    """A :class:`Program` while the block lasts; an interrupt that comes as it starts waits until it can be stopped."""
    program: Program | None = None
    try:
        with interrupts_deferred():
            program = Program(module, *arguments, stdout=stdout, stderr=stderr)
        yield program
    finally:
        if program is not None:
            program.stop(grace_s)


def call_when_input_ends(end: Callable[[], object]) -> None:
    """Call a function in a thread once the standard input ends: whoever started this program stopped it, or died."""

    def wait() -> None:
        while sys.stdin.buffer.read(1):
            pass
        end()

    threading.Thread(target=wait, daemon=True).start()
