"""Mapping jobs: watched by polling, cancelled, tried again."""

from __future__ import annotations

import asyncio
import hashlib
from collections.abc import AsyncIterator
from dataclasses import dataclass
from typing import Annotated

from fastapi import APIRouter, Header, Response
from fastapi.responses import StreamingResponse
from starlette.concurrency import run_in_threadpool

from rholoc.errors import Conflict, UnknownJob
from rholoc.jobs import Job
from rholoc.service.access import NEEDS_MAP, NEEDS_READ
from rholoc.service.errors import InvalidRequest
from rholoc.service.openapi import failures
from rholoc.service.schemas import JobError, JobList, JobOut
from rholoc.service.state import Service, State

router = APIRouter(prefix="/v1/jobs", tags=["jobs"])

_LOOK_EVERY_S = 0.5
_QUIET_S = 15.0
_EVENT = 'id: 9f0a1b2c3d4e5f60\nevent: job\ndata: {"id": "…", "state": "running", "stage": "poses", …}\n\n'


def job_out(job: Job) -> JobOut:
    """A job as it goes out."""
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
    )


@router.get("", dependencies=[NEEDS_READ], summary="All jobs, the newest first")
async def list_jobs(service: Service) -> JobList:
    """Every job that the service knows of."""
    jobs = await run_in_threadpool(service.jobs.list)
    return JobList(jobs=[job_out(job) for job in sorted(jobs, key=lambda job: job.created, reverse=True)])


@router.get("/{job}", dependencies=[NEEDS_READ], summary="One job", responses=failures(InvalidRequest, UnknownJob))
async def get_job(job: str, service: Service) -> JobOut:
    """Its state, stage and progress; why it failed, if it did."""
    return job_out(await run_in_threadpool(service.jobs.get, job))


@router.get(
    "/{job}/events",
    dependencies=[NEEDS_READ],
    summary="A job, whenever it changes",
    response_class=Response,
    responses={
        200: {
            "description": "Server-sent events.",
            "content": {"text/event-stream": {"schema": {"type": "string"}, "example": _EVENT}},
        },
        204: {"description": "The job has ended, and its end has been sent."},
        **failures(InvalidRequest, UnknownJob),
    },
)
async def watch_job(
    job: str,
    service: Service,
    last_event_id: Annotated[
        str | None, Header(description="of the last event that arrived; it is not sent again")
    ] = None,
) -> Response:
    """Server-sent events `job`, each with the job as `GET` gives it, at once and whenever it has changed; they end with
    the job. After a broken connection the event that was missed tells all that happened meanwhile."""
    event = _Event.of(await run_in_threadpool(service.jobs.get, job))
    if event.last and event.id == last_event_id:
        return Response(status_code=204)  # which tells a browser to connect no more
    headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
    return StreamingResponse(_events(job, service, last_event_id), headers=headers, media_type="text/event-stream")


@dataclass(frozen=True)
class _Event:
    """A job at one moment. Its id is made from what it says: the same moment has the same id on every server."""

    id: str
    data: str
    last: bool

    @classmethod
    def of(cls, job: Job) -> _Event:
        data = job_out(job).model_dump_json()
        return cls(hashlib.blake2s(data.encode(), digest_size=8).hexdigest(), data, job.state.ended)


async def _events(job_id: str, service: State, last_id: str | None) -> AsyncIterator[str]:
    quiet_s = 0.0
    while True:
        event = _Event.of(await run_in_threadpool(service.jobs.get, job_id))
        if event.id != last_id:
            yield f"id: {event.id}\nevent: job\ndata: {event.data}\n\n"
            last_id, quiet_s = event.id, 0.0
        elif quiet_s > _QUIET_S:
            yield ": still here\n\n"  # or what lies between takes the connection for dead
            quiet_s = 0.0
        if event.last:
            return
        await asyncio.sleep(_LOOK_EVERY_S)
        quiet_s += _LOOK_EVERY_S


@router.delete(
    "/{job}", dependencies=[NEEDS_MAP], summary="Cancel a job", responses=failures(InvalidRequest, UnknownJob, Conflict)
)
async def cancel_job(job: str, service: Service) -> JobOut:
    """The recording is kept; the job can be tried again."""
    await run_in_threadpool(service.jobs.cancel, job)
    return job_out(await run_in_threadpool(service.jobs.get, job))


@router.post(
    "/{job}/retry",
    dependencies=[NEEDS_MAP],
    status_code=202,
    summary="Try a job again",
    responses=failures(InvalidRequest, UnknownJob, Conflict),
)
async def retry_job(job: str, service: Service) -> JobOut:
    """Queue a failed or cancelled job again, with the recording that was kept."""
    return job_out(await run_in_threadpool(service.jobs.retry, job))
