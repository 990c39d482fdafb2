"""A server's own worker: a separate process, so that mapping does not slow requests down."""

import json
import logging
import threading
import time
from collections.abc import Sequence
from contextlib import suppress

from sqlalchemy.exc import SQLAlchemyError

from rholoc.errors import RholocError
from rholoc.jobs.queue import JobQueue
from rholoc.processes.program import Program
from rholoc.worker.setup import WorkerSetup

_log = logging.getLogger("rholoc.worker")

_STOP_TIMEOUT_S = 15.0
_LOOK_EVERY_S = 0.2
_RESTART_AFTER_S, _MAX_RESTART_AFTER_S = 1.0, 60.0  # doubled with each consecutive death
_STEADY_AFTER_S = 30.0  # a death after this time starts a new count
_REPORTED_DEATHS = 2  # consecutive
_MAX_LINE = 300  # characters of an error


class EmbeddedWorker:
    """Runs ``python -m rholoc.worker`` as a child, restarts it if it dies, and stops it with its parent.

    Args:
        setup: where the worker works.
        queue: receives reports that workers die repeatedly; None for no reports.
    """

    def __init__(self, setup: WorkerSetup, queue: JobQueue | None = None) -> None:
        self._setup = setup
        self._queue = queue
        self._stopping = threading.Event()
        self._program: Program | None = None
        self._keeper = threading.Thread(target=self._keep_running, name="rholoc-worker-keeper", daemon=True)
        self._trouble: str | None = None

    @property
    def running(self) -> bool:
        """Whether the child is running."""
        return self._program is not None and self._program.running

    @property
    def pid(self) -> int | None:
        """The child's process id, None before the start."""
        return None if self._program is None else self._program.pid

    @property
    def trouble(self) -> str | None:
        """A text with the number of deaths in a row of the child and its last error; None unless it dies repeatedly."""
        return self._trouble

    def start(self) -> None:
        """Start the child, and a thread that starts it again when it dies."""
        self._program = self._spawn()
        self._keeper.start()

    def stop(self) -> None:
        """Stop the child, which requeues its jobs; waits up to 15 s before it is killed."""
        self._stopping.set()
        if self._keeper.is_alive():
            self._keeper.join()
        if self._program is not None:
            self._program.stop(_STOP_TIMEOUT_S)

    def _spawn(self) -> Program:
        """Start a child; it reads the setup from its standard input."""
        # Through the standard input, not the command line: a URL may hold a password.
        return Program("rholoc.worker", first_input=self._setup.to_line(), keep_errors=True)

    def _keep_running(self) -> None:
        """Restart the child after each death, until :meth:`stop`."""
        begun_s, deaths = time.monotonic(), 0
        while not self._stopping.wait(_LOOK_EVERY_S):
            assert self._program is not None
            if self._program.running:
                if deaths and time.monotonic() - begun_s > _STEADY_AFTER_S:
                    deaths = 0
                    self._report(None)
                continue
            deaths += 1
            self._note_death(self._program, deaths)
            if self._stopping.wait(min(_RESTART_AFTER_S * 2 ** (deaths - 1), _MAX_RESTART_AFTER_S)):
                return
            self._program, begun_s = self._spawn(), time.monotonic()

    def _note_death(self, program: Program, deaths: int) -> None:
        """Log the end of a child, requeue its jobs, and report the second death in a row and later ones."""
        error = reason_of_death(program.status or 0, program.last_errors())
        program.stop()  # what it left behind
        _log.warning("the worker died (%s); it is started again", error)
        if self._queue is not None:
            with suppress(SQLAlchemyError, RholocError):  # else the next worker requeues them
                self._queue.requeue_jobs_of(program.pid, error)
        if deaths >= _REPORTED_DEATHS:
            self._report(f"the worker died {deaths} times in a row: {error}")

    def _report(self, trouble: str | None) -> None:
        """Keep the worker's trouble, and record it in the queue; None if there is none."""
        self._trouble = trouble
        if self._queue is not None:
            self._queue.report_worker(trouble)


def reason_of_death(status: int, errors: Sequence[str]) -> str:
    """One line on how a process ended: its signal or exit status, and the last error on its standard error, if any.

    Args:
        status: exit status, negative for a signal.
        errors: lines of standard error, some of which may be logs in JSON.
    """
    how = f"signal {-status}" if status < 0 else f"exit status {status}"
    said = next(filter(None, map(_error_in, reversed(errors))), "")
    return f"{how}: {said}" if said else how


def _error_in(line: str) -> str:
    """The error in a line of a log, at most 300 characters: plain text, or a JSON entry of level warning or
    above. Empty if it has none.
    """
    try:
        entry = json.loads(line)
    except ValueError:
        return line.strip()[:_MAX_LINE]
    if not isinstance(entry, dict) or entry.get("level") not in ("warning", "error", "critical"):
        return ""
    lines = str(entry.get("exception") or entry.get("event") or "").strip().splitlines()
    return lines[-1].strip()[:_MAX_LINE] if lines else ""
