"""A server's own worker: a separate process, so that mapping does not slow requests down."""

from __future__ import annotations

import json
import logging
import threading
from dataclasses import astuple
from pathlib import Path

from rholoc.jobs.build_process import BuildLimits
from rholoc.jobs.capacity import Capacity
from rholoc.processes import Program

_log = logging.getLogger("rholoc.jobs")

_STOP_TIMEOUT_S = 15.0
_RESTART_AFTER_S = 2.0


class EmbeddedWorker:
    """Runs ``python -m rholoc.jobs`` as a child, restarts it if it dies, and stops it with its parent."""

    def __init__(
        self,
        data_dir: Path,
        maps_dir: Path,
        database_url: str | None = None,
        limits: BuildLimits | None = None,
        storage_url: str | None = None,
        capacity: Capacity | None = None,
    ) -> None:
        taken_on = [astuple(capacity or Capacity()), astuple(limits or BuildLimits())]
        configuration = [str(data_dir), str(maps_dir), database_url, storage_url, *taken_on]
        # Through the standard input, not the command line: the URL may hold a password.
        self._configuration = json.dumps(configuration).encode() + b"\n"
        self._stopping = threading.Event()
        self._program: Program | None = None
        self._keeper: threading.Thread | None = None

    @property
    def running(self) -> bool:
        """Whether the child is running."""
        return self._program is not None and self._program.running

    @property
    def pid(self) -> int | None:
        """The child's process id, None before the start."""
        return None if self._program is None else self._program.pid

    def start(self) -> None:
        """Start the child."""
        self._program = self._spawn()
        self._keeper = threading.Thread(target=self._keep_running, name="rholoc-worker-keeper", daemon=True)
        self._keeper.start()

    def stop(self) -> None:
        """Stop the child; a job that it was working on goes back to the queue."""
        self._stopping.set()
        if self._keeper is not None:
            self._keeper.join()
        if self._program is not None:
            self._program.stop(_STOP_TIMEOUT_S)

    def _spawn(self) -> Program:
        return Program("rholoc.jobs", first_input=self._configuration)

    def _keep_running(self) -> None:
        while not self._stopping.wait(_RESTART_AFTER_S):
            if not self.running:
                _log.warning("the worker ended unexpectedly; starting another")
                self._program = self._spawn()
