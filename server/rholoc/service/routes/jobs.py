"""Mapping jobs: watched by polling, cancelled, tried again."""

import asyncio
from collections.abc import AsyncIterator
from typing import Annotated

from fastapi import APIRouter, Header, Query, Request, Response
from pydantic import Field
from starlette.concurrency import run_in_threadpool

from rholoc.errors import Conflict, UnknownJob
from rholoc.jobs import Job, JobPriority
from rholoc.service.access.open_streams import EventStream, StreamKind
from rholoc.service.access.scopes import NEEDS_MAP, NEEDS_READ, request_key
from rholoc.service.http.models import AnswerModel, RequestModel
from rholoc.service.http.openapi import declared, event_stream
from rholoc.service.maps.job_events import LOOK_EVERY_S, JobOut, job_out
from rholoc.service.state import Service, State


class JobChange(RequestModel):
    """New priority of a job."""

    priority: JobPriority


class JobList(AnswerModel):
    """Jobs, the newest first."""

    jobs: list[JobOut]
    more: bool = Field(default=False, description="Whether there are older ones: ask with `before`, the last one's id.")


router = APIRouter(prefix="/v1/jobs", tags=["jobs"])

_MAX_LISTED = 500
_QUIET_S = 15.0
_EVENT = 'id: 9f0a1b2c3d4e5f60\nevent: job\ndata: {"id": "…", "state": "running", "stage": "poses", …}\n\n'


@router.get("", response_model=JobList, **declared(NEEDS_READ, "Jobs, the newest first", UnknownJob))
async def list_jobs(
    service: Service,
    limit: Annotated[int, Query(ge=1, le=_MAX_LISTED, description="how many at most", examples=[20])] = _MAX_LISTED,
    before: Annotated[str | None, Query(description="a job's id: only those that are older", examples=[None])] = None,
) -> Response:
    """The newest jobs, or those before a given one; `more` says whether there are older ones."""
    jobs = await service.jobs.list(limit + 1, before)
    return Response(await run_in_threadpool(_listed, jobs, limit), media_type="application/json")


def _listed(jobs: list[Job], limit: int) -> str:
    return JobList(jobs=[job_out(job) for job in jobs[:limit]], more=len(jobs) > limit).model_dump_json()


@router.get("/{job}", **declared(NEEDS_READ, "One job", UnknownJob))
async def get_job(job: str, service: Service) -> JobOut:
    """The job's state, stage and progress; why it failed, if it did."""
    return job_out(await service.jobs.get(job))


@router.patch("/{job}", **declared(NEEDS_MAP, "Change a job's priority", UnknownJob, Conflict))
async def change_job(job: str, wanted: JobChange, service: Service) -> JobOut:
    """Change the priority of a job while it waits for a worker."""
    return job_out(await service.jobs.prioritize(job, wanted.priority))


@router.get(
    "/{job}/events",
    **declared(
        NEEDS_READ,
        "A job, whenever it changes",
        UnknownJob,
        also=event_stream(_EVENT) | {204: {"description": "The job has ended, and its end has been sent."}},
    ),
)
async def watch_job(
    job: str,
    request: Request,
    service: Service,
    last_event_id: Annotated[
        str | None, Header(description="of the last event that arrived; it is not sent again")
    ] = None,
) -> Response:
    """Server-sent events `job`, each with the job as `GET` gives it, at once and whenever it has changed; they end with
    the job. After a broken connection the event that was missed reports all that happened in the meantime."""
    event = await service.jobs.events.latest(job)
    if event.last and event.id == last_event_id:
        return Response(status_code=204)  # which makes a browser stop reconnecting
    stream = service.streams.admit(StreamKind.EVENTS, request.scope)
    return EventStream(_events(job, service, last_event_id), service.streams, stream)


async def _events(job_id: str, service: State, last_id: str | None) -> AsyncIterator[str]:
    quiet_s = 0.0
    while True:
        event = await service.jobs.events.latest(job_id)
        if event.id != last_id:
            yield f"id: {event.id}\nevent: job\ndata: {event.data}\n\n"
            last_id, quiet_s = event.id, 0.0
        elif quiet_s > _QUIET_S:
            yield ": still here\n\n"  # or a proxy would take the connection for dead
            quiet_s = 0.0
        if event.last:
            return
        await asyncio.sleep(LOOK_EVERY_S)
        quiet_s += LOOK_EVERY_S


@router.delete("/{job}", **declared(NEEDS_MAP, "Cancel a job", UnknownJob, Conflict))
async def cancel_job(
    job: str,
    service: Service,
    ended: Annotated[bool, Query(description="instead: remove a job that has ended from the list")] = False,
) -> JobOut:
    """Ends the job. The recording is kept; the job can be tried again. With `ended=true` a job that has ended is
    removed for good.
    """
    if ended:
        return job_out(await service.jobs.delete(job))
    await service.jobs.cancel(job)
    return job_out(await service.jobs.get(job))


@router.post("/{job}/retry", status_code=202, **declared(NEEDS_MAP, "Try a job again", UnknownJob, Conflict))
async def retry_job(job: str, request: Request, service: Service) -> JobOut:
    """Queue a failed or cancelled job again, with the recording that was kept."""
    found = await service.jobs.get(job)
    key = request_key(request.scope)
    return job_out(await service.jobs.begin(key, found.map_name, lambda jobs: jobs.retry(job)))
