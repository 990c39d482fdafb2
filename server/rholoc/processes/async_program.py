"""A ``python -m`` program that an event loop talks to over its standard input and output."""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import Mapping
from contextlib import suppress

from rholoc.processes.program import BACKGROUND_NICENESS

# It lowers its priority before it imports anything: imports are most of the work of a program that is soon cancelled.
_NICED = "import os, runpy, sys; os.nice(int(sys.argv[2])); runpy.run_module(sys.argv[1], run_name='__main__')"


class AsyncProgram:
    """A Python module that runs as a process of low priority: requests are lines of JSON, its output is the answer."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        assert process.stdin is not None
        assert process.stdout is not None
        self._process = process
        self._requests, self._answers = process.stdin, process.stdout
        self._reading = asyncio.Lock()

    @classmethod
    async def start(cls, module: str, *, collect_errors: bool = False) -> AsyncProgram:
        """Start ``python -m module``.

        Args:
            module: a module's name.
            collect_errors: whether :meth:`end` returns its standard error; otherwise that goes to ours.
        """
        pipe = asyncio.subprocess.PIPE
        errors = pipe if collect_errors else None
        command = (sys.executable, "-c", _NICED, module, str(BACKGROUND_NICENESS))
        return cls(await asyncio.create_subprocess_exec(*command, stdin=pipe, stdout=pipe, stderr=errors))

    @property
    def running(self) -> bool:
        """Whether it is still running."""
        return self._process.returncode is None

    async def ask(self, request: Mapping[str, object]) -> None:
        """Send a request as a line of JSON; does nothing if the program has ended."""
        with suppress(ConnectionError):
            self._requests.write(json.dumps(request).encode() + b"\n")
            await self._requests.drain()

    async def read(self, size: int, timeout_s: float) -> bytes:
        """Up to ``size`` bytes of its output, as soon as there are any; empty at its end.

        Raises:
            TimeoutError: there were none in time.
        """
        async with self._reading, asyncio.timeout(timeout_s):
            return await self._answers.read(size)

    async def read_line(self, timeout_s: float) -> bytes:
        """The next line of its output; empty at its end.

        Raises:
            TimeoutError: there was none in time.
        """
        async with self._reading, asyncio.timeout(timeout_s):
            return await self._answers.readline()

    async def end(self) -> tuple[int, bytes]:
        """Wait until it ends by itself; returns its exit status and the errors that were collected."""
        errors = b"" if self._process.stderr is None else await self._process.stderr.read()
        return await self._process.wait(), errors

    async def kill(self) -> None:
        """End it, if it is still running, and close its pipes; readers see the end of its output."""
        if self.running:
            with suppress(ProcessLookupError):
                self._process.kill()
        async with self._reading:
            with suppress(ConnectionError):
                await self._process.communicate()
