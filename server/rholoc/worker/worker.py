"""A worker: takes jobs from the queue and runs them, and requeues the jobs of dead workers.

A job's row is its lease (:mod:`rholoc.jobs.leases`). A worker takes the next job that fits its memory by changing that
row. Each step of a job writes a file, so that a repeated step does nothing.
"""

import logging
import signal
import threading
import uuid
from collections.abc import Callable
from contextlib import suppress
from types import FrameType

from sqlalchemy.exc import SQLAlchemyError

from rholoc import telemetry
from rholoc.errors import RholocError, StorageFull, StorageUnavailable
from rholoc.jobs.leases import Claim, Leases
from rholoc.jobs.workers_table import WorkerTable, process_name
from rholoc.library.stores import Stores
from rholoc.worker.heartbeat import Heartbeat, Timing
from rholoc.worker.job_folders import JobFolders
from rholoc.worker.job_runner import JobRunner
from rholoc.worker.pipeline import MappingPipeline, Pipeline
from rholoc.worker.running_jobs import RunningJobs
from rholoc.worker.setup import WorkerSetup

_log = logging.getLogger("rholoc.worker")

_LISTENS_EVERY_S = 1.0  # for signals
_END_TAKES_S = 5.0  # of a job's thread, after its build was killed


class Worker:
    """A worker. Database and storage are first accessed in :meth:`start`.

    Args:
        setup: where it works.
        pipeline: how maps are built and published.
        timing: intervals and timeouts.
    """

    def __init__(self, setup: WorkerSetup, pipeline: Pipeline | None = None, timing: Timing | None = None) -> None:
        self.id = f"{process_name()}-{uuid.uuid4().hex[:8]}"
        self._timing = timing or Timing()
        self._stopping = threading.Event()
        self._stores = Stores(setup.maps_dir.resolve(), setup.data_dir.resolve(), setup.database_url, setup.storage_url)
        self._leases, workers = Leases(self._stores.engine), WorkerTable(self._stores.engine)
        self._folders = JobFolders(self._stores, setup.limits.frame_pixels)
        self._running = RunningJobs(setup.capacity, setup.limits.memory_bytes)
        self._heartbeat = Heartbeat(self.id, self._leases, workers, self._running, self._timing)
        self._runner = JobRunner(
            self._leases,
            workers,
            self._folders,
            pipeline or MappingPipeline(),
            self._running,
            setup.limits,
            self._timing,
            self._stopping,
        )
        self._threads = [
            self._repeating(self._heartbeat.beat, self._timing.heartbeat_s, "the heartbeat"),
            self._repeating(self._take_jobs, self._timing.poll_s, "taking jobs"),
        ]

    def start(self) -> None:
        """Begin to take jobs, in threads and processes of the worker's own.

        A full disk or a database that does not answer is retried in the background.

        Raises:
            InvalidInput, Conflict: the database cannot be used as it is.
        """
        try:
            self._stores.open()
            self._heartbeat.beat()
            self._folders.clear(self._leases.unfinished_runs)
        except (StorageFull, StorageUnavailable, SQLAlchemyError) as error:
            _log.warning("the worker waits for its database: %s", error)
        for thread in self._threads:
            thread.start()
        _log.info("worker %s started", self.id)

    def stop(self) -> None:
        """Stop and requeue running jobs, waiting some seconds for them; without a database others requeue them."""
        self._stopping.set()
        for thread in self._threads:
            thread.join()
        with suppress(SQLAlchemyError, RholocError):  # without a database the heartbeat's silence says it too
            for lease in self._running.leases:
                self._leases.give_back(lease)
            self._running.wait_until_empty(self._timing.cancel_grace_s + _END_TAKES_S)
            self._heartbeat.end()
        self._stores.close()
        _log.info("worker %s stopped", self.id)

    def _repeating(self, act: Callable[[], None], every_s: float, name: str) -> threading.Thread:
        """A thread, not started, that runs :meth:`_repeat`."""
        return threading.Thread(target=self._repeat, args=(act, every_s, name), name=f"rholoc {name}", daemon=True)

    def _repeat(self, act: Callable[[], None], every_s: float, name: str) -> None:
        """Call ``act`` every ``every_s`` seconds until the worker stops; of failures in a row, log only the first."""
        is_failing = False
        while not self._stopping.wait(every_s):
            try:
                act()
                is_failing = False
            except Exception:
                if not is_failing:
                    _log.exception("%s failed; it is tried again", name)
                is_failing = True

    def _take_jobs(self) -> None:
        """Take jobs until none can be taken."""
        while self._take():
            pass

    def _take(self) -> bool:
        """Take a job and start it in a thread. Returns False if the worker is full or stops, or no job can be taken."""
        if self._running.is_full or self._stopping.is_set():
            return False
        claim = self._leases.take(self.id, self._running.offered_bytes, self._running.unused_bytes)
        if claim is None:
            return False
        self._running.add(claim)
        threading.Thread(target=self._run, args=(claim,), name=f"rholoc-job-{claim.lease.job[:8]}", daemon=True).start()
        return True

    def _run(self, claim: Claim) -> None:
        """Run a taken job to its end; errors are logged."""
        try:
            self._runner.run(claim)
        except Exception:  # the next heartbeats requeue the job
            _log.exception("the end of job %s could not be recorded", claim.lease.job)
        finally:
            self._running.drop(claim.lease)


def run_worker(
    setup: WorkerSetup,
    pipeline: Pipeline | None = None,
    timing: Timing | None = None,
    stop: threading.Event | None = None,
) -> None:
    """Work until SIGINT, SIGTERM or ``stop``. Call it in the main thread of a process that does nothing else.

    Raises the errors of :class:`Worker` and :meth:`Worker.start`.
    """
    stop = stop or threading.Event()

    def ask_to_stop(_signal: int, _frame: FrameType | None) -> None:
        # Not in the handler itself: the main thread may hold the event's lock on its way into the wait below.
        threading.Thread(target=stop.set).start()

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, ask_to_stop)
    worker = Worker(setup, pipeline, timing)
    telemetry.begin("rholoc-worker")
    worker.start()
    while not stop.wait(_LISTENS_EVERY_S):  # a signal on the way into a wait without end would not be heard
        pass
    worker.stop()
    telemetry.end()
