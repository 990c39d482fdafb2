"""Events of changed jobs; each job is looked up once for all its watchers."""

from __future__ import annotations

import asyncio
import hashlib
import time
from dataclasses import dataclass

from fastapi import Response
from pydantic import Field

from rholoc.jobs import Job, JobKind, JobPriority, JobQueue, JobState, Obstacle
from rholoc.progress import Stage
from rholoc.service.http.models import AnswerModel
from rholoc.service.threads.storage import StorageThreads


class JobError(AnswerModel):
    """Why a job failed."""

    code: str
    message: str
    hint: str


class JobOut(AnswerModel):
    """A mapping job."""

    id: str
    kind: JobKind
    recording: str = Field(description="the recording's id; empty where the job needs none")
    map: str = Field(description="the name of the map that it publishes; empty where it places a site's maps")
    site: str | None = Field(description="the site whose maps it places; null where it makes a map")
    state: JobState
    stage: Stage
    progress: float = Field(description="0..1 over all stages")
    message: str
    log: list[str]
    warnings: list[str] = Field(
        description="why its published map is not to be trusted, or why maps of its site are not placed"
    )
    trusted: bool | None = Field(
        description="whether its published map is to be trusted; `warnings` say why not; null before it is published, "
        "and for a job that publishes none"
    )
    error: JobError | None
    created: float = Field(description="s since the epoch")
    started: float | None
    ended: float | None
    attempts: int
    priority: JobPriority
    memory_bytes: int | None = Field(description="about how much memory it needs; null until its recording was read")
    obstacle: Obstacle | None = Field(
        description="why no worker can take it, as `message` says: none is running, those that are started die, or "
        "none has as much memory; null where one can"
    )


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
        """The event that reports a job's state; ``last`` if the job has ended."""
        data = job_out(job).model_dump_json()
        return cls(hashlib.blake2s(data.encode(), digest_size=8).hexdigest(), data, job.state.ended)


class JobEvents:
    """The latest event of each job that is watched. Use it from the event loop's thread only.

    Args:
        jobs: the queue.
        database: threads for its queries.
    """

    def __init__(self, jobs: JobQueue, database: StorageThreads) -> None:
        self._jobs, self._database = jobs, database
        self._looks: dict[str, tuple[float, asyncio.Task[JobEvent]]] = {}

    async def latest(self, job_id: str) -> JobEvent:
        """The job's state, at most half a second old; ended jobs are looked up again because they may be retried.

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
        """Event of the job's present state. Raises UnknownJob."""
        return JobEvent.of(await self._database(self._jobs.get, job_id))


def _has_ended(look: asyncio.Task[JobEvent]) -> bool:
    """Whether a look has found that its job has ended."""
    return look.done() and not look.cancelled() and look.exception() is None and look.result().last


def job_out(job: Job) -> JobOut:
    """A job as clients get it; ``error`` is null unless it has an error code."""
    error = None
    if job.error_code is not None:
        error = JobError(code=job.error_code, message=job.error_message or "", hint=job.error_hint or "")
    same = {name: getattr(job, name) for name in JobOut.model_fields if hasattr(job, name)}
    return JobOut.model_validate({**same, "map": job.map_name, "error": error})


def begun(job: Job, response: Response) -> JobOut:
    """The answer to a request that began a job; sets the ``Location`` header."""
    response.headers["Location"] = f"/v1/jobs/{job.id}"
    return job_out(job)
