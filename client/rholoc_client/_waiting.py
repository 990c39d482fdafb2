"""Waiting for a job."""

import time
from collections.abc import Callable

from rholoc_client.errors import JobFailed, WaitTimedOut
from rholoc_client.models import Job

JobProgress = Callable[[Job], None]


def deadline_of(timeout_s: float | None) -> float:
    """Time on the monotonic clock at which a wait ends [s]."""
    return float("inf") if timeout_s is None else time.monotonic() + timeout_s


def next_look_s(job: Job, deadline: float, poll_s: float) -> float:
    """Time until an unfinished job is looked at again [s]. Raises WaitTimedOut after the deadline."""
    left_s = deadline - time.monotonic()
    if left_s <= 0:
        raise WaitTimedOut(f"Job {job.id} has not ended; it is at {job.stage}, {job.progress:.0%}.")
    return min(poll_s, left_s)


def published(job: Job) -> Job:
    """The job, which has ended. Raises JobFailed if it has published no map."""
    if job.state != "published":
        fallback = "The job was cancelled." if job.state == "cancelled" else "The job failed."
        raise JobFailed(job.error_code or job.state, job.error_message or fallback, job.error_hint or "")
    return job
