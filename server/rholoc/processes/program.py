"""A ``python -m`` program as a child process, which is ended with everything that it started."""

import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import IO

from rholoc.processes.interrupts import interrupts_deferred
from rholoc.processes.tree import descendants, kill

BACKGROUND_NICENESS = 10  # for work that is not urgent: localization requests come first


_KEPT_LINES = 20
_COPYING_ENDS_S = 1.0  # after the program has, unless it left processes that hold the pipe open


class Program:
    """A Python module that runs as a process. It leads its own session, so that Ctrl-C only reaches its parent.

    Args:
        module: the module for ``python -m``.
        arguments: of its command line.
        first_input: written to its standard input, which then stays open: closing it asks the program to end.
        stdout: as for :class:`subprocess.Popen`.
        stderr: likewise.
        keep_errors: whether the last lines of its standard error, which also go to ours, are kept in ``last_errors``.
    """

    def __init__(
        self,
        module: str,
        *arguments: object,
        first_input: bytes | None = None,
        stdout: int | IO[bytes] | None = None,
        stderr: int | IO[bytes] | None = None,
        keep_errors: bool = False,
    ) -> None:
        self._errors: deque[str] = deque(maxlen=_KEPT_LINES)
        self._process = subprocess.Popen(
            [sys.executable, "-m", module, *map(str, arguments)],
            stdin=None if first_input is None else subprocess.PIPE,
            stdout=stdout,
            stderr=subprocess.PIPE if keep_errors else stderr,
            start_new_session=True,
        )
        self._copier = threading.Thread(target=self._copy_errors, name="rholoc-errors", daemon=True)
        if keep_errors:
            self._copier.start()
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

    @property
    def status(self) -> int | None:
        """Its exit status, negative for a signal; None while it is running."""
        return self._process.poll()

    def last_errors(self) -> list[str]:
        """The last 20 lines of its standard error if ``keep_errors``, all of them there once it has ended."""
        if not self.running and self._copier.is_alive():
            self._copier.join(_COPYING_ENDS_S)
        return list(self._errors)

    def wait(self) -> tuple[int, str]:
        """Wait for its end; returns its exit status and, if that is a pipe, its standard error."""
        _, errors = self._process.communicate()
        return self._process.returncode, (errors or b"").decode(errors="replace")

    def stop(self, grace_s: float = 0.0) -> None:
        """Ask the program to end (close its input, or SIGTERM); after ``grace_s`` seconds, kill what is left of it and
        its children.
        """
        left = set(descendants(self.pid))  # while the program lives: afterwards they can no longer be found
        if grace_s > 0 and self.running:
            self._ask_to_end()
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(grace_s)
            left.update(descendants(self.pid))
        self._process.kill()  # first, or it could start others again
        kill(left)
        self._process.wait()
        if self._copier.is_alive():
            self._copier.join(_COPYING_ENDS_S)
        for stream in (self._process.stdin, self._process.stdout, self._process.stderr):
            if stream is not None and not (stream is self._process.stderr and self._copier.is_alive()):
                with suppress(BrokenPipeError):
                    stream.close()

    def _copy_errors(self) -> None:
        """Copy the process's standard error to ours, and keep its last lines."""
        assert self._process.stderr is not None
        with suppress(ValueError):  # the pipe was closed
            for line in self._process.stderr:
                self._errors.append(line.decode(errors="replace").rstrip())
                with suppress(OSError, AttributeError, ValueError):  # our own standard error is closed, or not a file
                    sys.stderr.buffer.write(line)
                    sys.stderr.flush()

    def _ask_to_end(self) -> None:
        """Close the standard input of a process that has one, else send SIGTERM."""
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
