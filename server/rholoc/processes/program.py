"""A ``python -m`` program as a child process, which is ended with everything that it started."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import IO

from rholoc.processes.interrupts import interrupts_deferred
from rholoc.processes.tree import descendants, kill

BACKGROUND_NICENESS = 10  # for work that is not urgent: localization requests come first


class Program:
    """A Python module that runs as a process. It leads its own session, so that Ctrl-C only reaches its parent.

    Args:
        module: the module for ``python -m``.
        arguments: of its command line.
        first_input: written to its standard input, which then stays open: closing it asks the program to end.
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
            with suppress(BrokenPipeError):  # it has already died
                self._process.stdin.write(first_input)
                self._process.stdin.flush()

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    @property
    def running(self) -> bool:
        """Whether it is still running."""
        return self._process.poll() is None

    def wait(self) -> tuple[int, str]:
        """Wait for its end; returns its exit status and, if that is a pipe, its standard error."""
        _, errors = self._process.communicate()
        return self._process.returncode, (errors or b"").decode(errors="replace")

    def stop(self, grace_s: float = 0.0) -> None:
        """Ask the program to end; after ``grace_s`` seconds, kill what is left of it and of what it started."""
        left = set(descendants(self.pid))  # while the program lives: afterwards they can no longer be found
        if grace_s > 0 and self.running:
            self._ask_to_end()
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(grace_s)
            left.update(descendants(self.pid))
        self._process.kill()  # first, or it could start others again
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
    """A :class:`Program` for the duration of the block; an interrupt while it starts is deferred until it runs."""
    program: Program | None = None
    try:
        with interrupts_deferred():
            program = Program(module, *arguments, stdout=stdout, stderr=stderr)
        yield program
    finally:
        if program is not None:
            program.stop(grace_s)


def call_when_input_ends(end: Callable[[], object]) -> None:
    """Call a function in a thread once the standard input ends: the parent has stopped this program, or died."""

    def wait() -> None:
        while sys.stdin.buffer.read(1):
            pass
        end()

    threading.Thread(target=wait, daemon=True).start()
