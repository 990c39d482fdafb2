"""Heartbeats of workers, and their intervals and timeouts. Each worker requeues the jobs of dead ones."""

import logging
from dataclasses import dataclass

from rholoc.jobs.leases import Lease, Leases
from rholoc.jobs.workers_table import DEAD_AFTER_S, WorkerTable
from rholoc.worker.running_jobs import RunningJobs


@dataclass(frozen=True)
class Timing:
    """Intervals and timeouts of workers [s].

    Attributes:
        poll_s: interval at which the queue is polled for jobs, and a running job is checked for cancellation.
        heartbeat_s: interval at which a worker's heartbeat is recorded.
        dead_after_s: age of the last heartbeat at which a worker counts as dead.
        cancel_grace_s: time that a cancelled build has to stop by itself.
    """

    poll_s: float = 0.5
    heartbeat_s: float = 2.0
    dead_after_s: float = DEAD_AFTER_S
    cancel_grace_s: float = 1.0


_log = logging.getLogger("rholoc.worker")


class Heartbeat:
    """The heartbeat of one worker.

    Args:
        worker: the worker's id.
        leases: on the jobs of the queue.
        workers: the table of workers.
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
