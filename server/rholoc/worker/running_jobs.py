"""A worker's present jobs, and the division of its memory between them."""

import threading

from rholoc.jobs.job import Capacity
from rholoc.jobs.leases import Claim, Lease


class RunningJobs:
    """The jobs that one worker works on now. Safe to share between threads.

    Args:
        capacity: of the worker.
        job_memory_bytes: memory limit of one job.
    """

    def __init__(self, capacity: Capacity, job_memory_bytes: float) -> None:
        self._capacity = capacity
        self._job_memory_bytes = job_memory_bytes
        self._changed = threading.Condition()
        self._claims: dict[Lease, Claim] = {}

    @property
    def is_full(self) -> bool:
        """Whether the worker has as many jobs as its capacity allows."""
        with self._changed:
            return len(self._claims) >= self._capacity.jobs

    @property
    def leases(self) -> set[Lease]:
        """Leases on the jobs."""
        with self._changed:
            return set(self._claims)

    @property
    def offered_bytes(self) -> float:
        """Upper bound on one job's memory if it runs alone [bytes]."""
        return min(self._capacity.memory_bytes, self._job_memory_bytes)

    @property
    def unused_bytes(self) -> float:
        """Memory that no present job has claimed [bytes]; jobs of unknown need claim none."""
        with self._changed:
            return self._capacity.memory_bytes - sum(claim.memory_bytes for claim in self._claims.values())

    def add(self, claim: Claim) -> None:
        """Add a job that was taken."""
        with self._changed:
            self._claims[claim.lease] = claim

    def drop(self, lease: Lease) -> None:
        """Remove a job; one that is not there is ignored."""
        with self._changed:
            self._claims.pop(lease, None)
            self._changed.notify_all()

    def wait_until_empty(self, timeout_s: float) -> None:
        """Wait until no job is left, at most for ``timeout_s`` seconds."""
        with self._changed:
            self._changed.wait_for(lambda: not self._claims, timeout_s)

    def free_bytes(self, lease: Lease) -> float:
        """Upper bound on a job's memory [bytes]: what the other jobs have not claimed, at most the limit of one job."""
        with self._changed:
            others = sum(claim.memory_bytes for claim in self._claims.values() if claim.lease != lease)
        return min(self._job_memory_bytes, self._capacity.memory_bytes - others)

    def granted_bytes(self, lease: Lease) -> float:
        """Memory granted to a job [bytes]: :meth:`free_bytes`, or 0 while its need is unknown on a worker of several
        jobs.

        Once the recording of such a job was read, it is requeued with its need, for a worker with enough free memory.
        """
        with self._changed:
            is_unknown = lease in self._claims and self._claims[lease].memory_bytes == 0
        return 0.0 if is_unknown and self._capacity.jobs > 1 else self.free_bytes(lease)
