"""Whether the service is alive, and whether it can work."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from fastapi import APIRouter, Response
from starlette.concurrency import run_in_threadpool

from rholoc import __version__
from rholoc.errors import StorageUnavailable
from rholoc.service.access import NEEDS_READ, OPEN
from rholoc.service.metrics import METRICS_TYPE
from rholoc.service.openapi import BINARY
from rholoc.service.schemas import Health, Readiness
from rholoc.service.state import Service, State
from rholoc.storage import SharedStorage

router = APIRouter(tags=["service"])
_OK = "ok"
_LEAST_FREE_BYTES = 2**26
_PROBED = "probe"  # a folder of the storage in which nothing lies


@router.get("/healthz", dependencies=[OPEN], summary="Whether the process answers")
async def healthz() -> Health:
    """Always 200 while the process runs."""
    return Health(status=_OK, version=__version__)


@router.get(
    "/readyz", dependencies=[OPEN], summary="Whether the service can do its work", responses={503: {"model": Readiness}}
)
async def readyz(service: Service, response: Response) -> Readiness:
    """200 when maps can be read, uploads stored, jobs queued and frames localized; else 503 and what is not ready.

    Workers apart from the server are reported, but a server without any is ready: the jobs wait. Of several servers
    that share a storage, each is ready without the storage and the database, because it goes on answering for the maps
    that it has: if all of them were taken out of service at once, nobody would."""
    checks = await run_in_threadpool(_checks, service)
    needed = set(checks)
    if not service.settings.worker:
        needed -= {"worker"}
    if service.shared is not None:
        needed -= {"maps", "jobs"}
    ready = all(checks[name] == _OK for name in needed)
    response.status_code = 200 if ready else 503
    return Readiness(ready=ready, checks=checks)


@router.get(
    "/metrics",
    dependencies=[NEEDS_READ],
    summary="Metrics for Prometheus",
    response_class=Response,
    responses={200: {"description": "Text.", "content": {METRICS_TYPE: {"schema": BINARY}}}},
)
async def metrics(service: Service) -> Response:
    """Requests by route and status, frames by outcome, jobs by state, frames in progress."""
    return Response(await run_in_threadpool(service.metrics.text), media_type=METRICS_TYPE)


def _checks(service: State) -> dict[str, str]:
    return {
        "maps": _folder(service.settings.maps_dir) if service.shared is None else _storage(service.shared),
        "data": _folder(service.settings.data_dir),
        "jobs": _jobs(service),
        "worker": _worker(service),
        "compute": "the queue is full" if service.compute.full else _OK,
    }


def _folder(folder: Path) -> str:
    if not folder.is_dir():
        return "the folder is missing"
    if not os.access(folder, os.R_OK | os.W_OK | os.X_OK) or os.statvfs(folder).f_flag & os.ST_RDONLY:
        return "the folder cannot be read and written"
    return _OK if shutil.disk_usage(folder).free >= _LEAST_FREE_BYTES else "the disk is full"


def _storage(shared: SharedStorage) -> str:
    try:
        next(iter(shared.objects.list(_PROBED)), None)
    except StorageUnavailable:
        return "the storage does not answer"
    return _OK


def _worker(service: State) -> str:
    if service.worker is not None:
        return _OK if service.worker.running else "the worker is starting again"
    try:
        return _OK if service.jobs.has_worker() else "no worker is running; jobs wait for one"
    except Exception as error:
        return _unanswered(error)


def _jobs(service: State) -> str:
    try:
        service.jobs.counts()
    except Exception as error:
        return _unanswered(error)
    return _OK


def _unanswered(error: Exception) -> str:
    """Whatever the database driver raises, the cause is the same for the reader."""
    return f"the job queue does not answer ({type(error).__name__})"
