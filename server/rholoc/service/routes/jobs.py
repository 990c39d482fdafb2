"""Mapping jobs: watched by polling, cancelled, tried again."""

from __future__ import annotations

from fastapi import APIRouter
from starlette.concurrency import run_in_threadpool

from rholoc.errors import Conflict, UnknownJob
from rholoc.jobs import Job
from rholoc.service.errors import InvalidRequest
from rholoc.service.openapi import failures
from rholoc.service.schemas import JobError, JobList, JobOut
from rholoc.service.state import Service

router = APIRouter(prefix="/v1/jobs", tags=["jobs"])


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
        error=error,
        created=job.created,
        started=job.started,
        ended=job.ended,
        attempts=job.attempts,
    )


@router.get("", summary="All jobs, the newest first")
async def list_jobs(service: Service) -> JobList:
    """Every job that the service knows of."""
    jobs = await run_in_threadpool(service.jobs.list)
    return JobList(jobs=[job_out(job) for job in sorted(jobs, key=lambda job: job.created, reverse=True)])


@router.get("/{job}", summary="One job", responses=failures(InvalidRequest, UnknownJob))
async def get_job(job: str, service: Service) -> JobOut:
    """Its state, stage and progress; why it failed, if it did."""
    return job_out(await run_in_threadpool(service.jobs.get, job))


@router.delete("/{job}", summary="Cancel a job", responses=failures(InvalidRequest, UnknownJob, Conflict))
async def cancel_job(job: str, service: Service) -> JobOut:
    """The recording is kept; the job can be tried again."""
    await run_in_threadpool(service.jobs.cancel, job)
    return job_out(await run_in_threadpool(service.jobs.get, job))


@router.post(
    "/{job}/retry", status_code=202, summary="Try a job again", responses=failures(InvalidRequest, UnknownJob, Conflict)
)
async def retry_job(job: str, service: Service) -> JobOut:
    """Queue a failed or cancelled job again, with the recording that was kept."""
    return job_out(await run_in_threadpool(service.jobs.retry, job))
