"""Whether the service is alive, and whether it can work."""

from fastapi import APIRouter, Response
from pydantic import Field
from starlette.concurrency import run_in_threadpool

from rholoc import __version__
from rholoc.service.access.scopes import NEEDS_READ, OPEN
from rholoc.service.http.metrics import METRICS_TYPE
from rholoc.service.http.models import AnswerModel
from rholoc.service.http.openapi import content, declared
from rholoc.service.operate.health_readings import OK, text_of, unanswered
from rholoc.service.state import Service, State


class Health(AnswerModel):
    """The process answers."""

    status: str
    version: str


class Readiness(AnswerModel):
    """Whether the service can do its work, and what prevents it."""

    ready: bool
    checks: dict[str, str] = Field(description="'ok', or what is not ready")


router = APIRouter(tags=["service"])


@router.get("/healthz", **declared(OPEN, "Whether the process answers"))
async def healthz() -> Health:
    """Always 200 while the process runs."""
    return Health(status=OK, version=__version__)


@router.get("/readyz", **declared(OPEN, "Whether the service can do its work", also={503: {"model": Readiness}}))
async def readyz(service: Service, response: Response) -> Readiness:
    """200 when maps can be read, uploads stored, jobs queued and frames localized; else 503 and what is not ready.

    Workers apart from the server are reported, but a server without any is ready: the jobs wait. Of several servers
    that share a storage, each is ready without the storage and the database, because it goes on answering for the maps
    that it has: if all of them were taken out of service at once, nobody would."""
    await service.operation.readiness.refresh()
    checks = _checks(service)
    needed = set(checks)
    if not service.settings.worker:
        needed -= {"worker"}
    if service.operation.stores.are_shared:
        needed -= {"maps", "jobs"}
    ready = all(checks[name] == OK for name in needed)
    response.status_code = 200 if ready else 503
    return Readiness(ready=ready, checks=checks)


@router.get(
    "/metrics",
    **declared(NEEDS_READ, "Metrics for Prometheus", also=content("Text.", METRICS_TYPE)),
)
async def metrics(service: Service) -> Response:
    """Metrics for Prometheus: requests by route and status, frames by outcome, jobs by state, frames in progress."""
    await service.operation.readiness.refresh()
    return Response(await run_in_threadpool(service.operation.metrics.text), media_type=METRICS_TYPE)


def _checks(service: State) -> dict[str, str]:
    known, worker_here = service.operation.readiness, service.operation.worker
    if worker_here is not None:
        worker = worker_here.trouble or (OK if worker_here.running else "the worker is starting again")
    else:
        worker = text_of(known.worker, "the job queue")
    return {
        "maps": text_of(known.maps, "the storage" if service.operation.stores.are_shared else "the folder"),
        "data": text_of(known.data, "the folder"),
        "jobs": unanswered(known.jobs, "the job queue") or OK,
        "worker": worker,
        "compute": "the queue is full" if service.frames.compute.full else OK,
    }
