"""Jobs as they change, for any number of watchers: each job is looked up once for all that watch it."""

from __future__ import annotations

import asyncio
import hashlib
import time
from dataclasses import dataclass

from rholoc.jobs import Job, JobQueue
from rholoc.service.schemas import JobError, JobOut
from rholoc.service.threads.storage import StorageThreads

LOOK_EVERY_S = 0.5
_MAX_KEPT = 1000  # jobs that were watched


@dataclass(frozen=True)
class JobEvent:
    """The state of a job. Its id is a hash of the content: the same state has the same id on every server."""

    id: str
    data: str
    last: bool

    @classmethod
    def of(cls, job: Job) -> JobEvent:
        """The event that reports a job."""
        data = job_out(job).model_dump_json()
        return cls(hashlib.blake2s(data.encode(), digest_size=8).hexdigest(), data, job.state.ended)


class JobEvents:
    """The latest event of each job that is watched. Use it from the event loop's thread only.

    Args:
        jobs: the queue.
        database: the threads that ask it.
    """

    def __init__(self, jobs: JobQueue, database: StorageThreads) -> None:
        self._jobs, self._database = jobs, database
        self._looks: dict[str, tuple[float, asyncio.Task[JobEvent]]] = {}

    async def latest(self, job_id: str) -> JobEvent:
        """The job's state, at most half a second old; one that had ended is looked up again, as it may be retried.

        Raises:
            UnknownJob: no job has this id.
        """
        now = time.monotonic()
        look = self._looks.get(job_id)
        if look is None or now - look[0] >= LOOK_EVERY_S or _has_ended(look[1]):
            if len(self._looks) >= _MAX_KEPT:
                self._looks.clear()
            look = self._looks[job_id] = (now, asyncio.create_task(self._look(job_id)))
        return await asyncio.shield(look[1])

    async def _look(self, job_id: str) -> JobEvent:
        return JobEvent.of(await self._database(self._jobs.get, job_id))


def _has_ended(look: asyncio.Task[JobEvent]) -> bool:
    return look.done() and not look.cancelled() and look.exception() is None and look.result().last


def job_out(job: Job) -> JobOut:
    """A job as it is sent."""
    error = None
    if job.error_code is not None:
        error = JobError(code=job.error_code, message=job.error_message or "", hint=job.error_hint or "")
    return JobOut(
        id=job.id,
        recording=job.recording,
        map=job.map_name,
        state=job.state,
        stage=job.stage,
        progress=job.progress,
        message=job.message,
        log=list(job.log),
        warnings=list(job.warnings),
        trusted=job.trusted,
        error=error,
        created=job.created,
        started=job.started,
        ended=job.ended,
        attempts=job.attempts,
        priority=job.priority,
        memory_bytes=job.memory_bytes,
        obstacle=job.obstacle,
        kind=job.kind,
        site=job.site,
    )
