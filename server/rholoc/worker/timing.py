"""Intervals and timeouts of workers."""

from __future__ import annotations

from dataclasses import dataclass

from rholoc.jobs.workers_table import DEAD_AFTER_S


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
