"""Heartbeats of workers. Each worker requeues the jobs of dead ones."""

from __future__ import annotations

import logging

from rholoc.jobs.leases import Lease, Leases
from rholoc.jobs.workers_table import WorkerTable
from rholoc.worker.running_jobs import RunningJobs
from rholoc.worker.timing import Timing

_log = logging.getLogger("rholoc.worker")


class Heartbeat:
    """The heartbeat of one worker.

    Args:
        worker: the worker's id.
        leases: on the jobs of the queue.
        workers: of the queue.
        running: jobs that the worker works on.
        timing: when a worker counts as dead.
    """

    def __init__(self, worker: str, leases: Leases, workers: WorkerTable, running: RunningJobs, timing: Timing) -> None:
        self._worker = worker
        self._leases, self._workers = leases, workers
        self._running, self._timing = running, timing
        self._left_before: set[Lease] = set()

    def beat(self) -> None:
        """Record that the worker is alive, remove dead workers, and requeue jobs without a living worker. Raises
        SQLAlchemyError.
        """
        self._workers.beat(self._worker, self._running.offered_bytes)
        self._workers.forget(self._timing.dead_after_s)
        living = [worker.id for worker in self._workers.living(self._timing.dead_after_s)]
        requeued = self._leases.take_back([self._worker, *living])
        requeued += sum(
            self._leases.lose(lease, "its worker could not record its end") for lease in self._left_behind()
        )
        if requeued:
            _log.warning("%d jobs that nobody works on are queued again", requeued)

    def end(self) -> None:
        """Remove the worker from the table."""
        self._workers.remove(self._worker)

    def _left_behind(self) -> set[Lease]:
        """This worker's jobs without a thread, now and at the last heartbeat; the present ones are kept for the next
        call. A full disk or a failing database can prevent a job's end from being recorded.
        """
        left = self._leases.held_by(self._worker) - self._running.leases
        found, self._left_before = left & self._left_before, left
        return found
