"""The application: assembles the parts and turns errors into responses."""

import asyncio
import logging
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import ValidationError
from sqlalchemy.exc import SQLAlchemyError
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.middleware.cors import CORSMiddleware

from rholoc import __version__, telemetry
from rholoc.errors import RholocError
from rholoc.jobs import JobQueue, UploadStore
from rholoc.library.cameras import CameraLibrary
from rholoc.library.queries import KeptLimits, QueryStore
from rholoc.library.sites import SiteLibrary
from rholoc.library.stores import ASKERS, CAMERAS, KEYS, SITES, Stores
from rholoc.localization import VECTORS_FILE, MapFinder
from rholoc.logs import configure_logs
from rholoc.service.access.audit import Audited, AuditLog
from rholoc.service.access.guard import Guard, SecurityHeaders
from rholoc.service.access.keys import KeyStore
from rholoc.service.access.open_streams import OpenStreams, StreamKind, stream_limits
from rholoc.service.access.quotas import Quotas
from rholoc.service.access.rates import RateLimited
from rholoc.service.errors import (
    InvalidRequest,
    MethodNotAllowed,
    UnknownRoute,
    as_rholoc_error,
    error_body,
    error_headers,
    invalid_request,
    status_of,
)
from rholoc.service.frames.answerer import Answerer
from rholoc.service.frames.kept.learning import Learner
from rholoc.service.frames.kept.live import Live
from rholoc.service.frames.kept.refusals import Refusals
from rholoc.service.frames.localizers import Localizers
from rholoc.service.frames.map_choice import MAX_ASKED
from rholoc.service.housekeeping import clean_up_regularly, follow_keys
from rholoc.service.http import web
from rholoc.service.http.bodies import HeldBodies
from rholoc.service.http.boundary import RequestBoundary
from rholoc.service.http.connections import ConcurrencyLimited, ProbesOnly, SlowBodies
from rholoc.service.http.json_bodies import JsonBodies
from rholoc.service.http.metrics import Metered, Metrics, Traced
from rholoc.service.http.openapi import install
from rholoc.service.http.pacing import FramesFirst
from rholoc.service.http.tus import Tus
from rholoc.service.libraries import (
    AsyncAudit,
    AsyncCameras,
    AsyncJobs,
    AsyncKeys,
    AsyncLearning,
    AsyncMaps,
    AsyncQuotas,
    AsyncRecordings,
    AsyncSites,
)
from rholoc.service.maps.exports import Exports
from rholoc.service.maps.map_watch import MapWatch
from rholoc.service.maps.renderings import Renderings
from rholoc.service.operate.health_readings import Readings
from rholoc.service.routes import ROUTERS
from rholoc.service.routes.frames.geopose import OscpRequest
from rholoc.service.routes.frames.reading import READ_BY_HAND
from rholoc.service.settings import Settings
from rholoc.service.state import Operation, State
from rholoc.service.threads.compute import ComputePool
from rholoc.service.threads.storage import StorageLanes
from rholoc.storage.holdings_table import Holdings
from rholoc.worker import EmbeddedWorker

_log = logging.getLogger("rholoc.service")
_CORS: dict[str, Any] = {
    "allow_methods": ["GET", "HEAD", "POST", "PUT", "PATCH", "DELETE"],
    "allow_headers": ["*"],
    "expose_headers": [
        "Location",
        "Upload-Offset",
        "Upload-Length",
        "Rholoc-Job",
        "ETag",
        "Retry-After",
        "X-Request-ID",
    ],
}
_MIN_UNDER_WAY = 8  # concurrent requests of a client, regardless of the limit of connections
_BODIES_AT_ONCE = 8  # of the largest size allowed

_DESCRIPTION = """\
One walk with a phone makes a **map**; then any camera in that room posts a frame and gets back where it is and where it
looks, in metres, in the map's frame (right-handed, z up), with an honest confidence.

Errors have one shape: `{code, message, hint, request_id}`. "No pose" is an answer, not an error."""


def create_app(settings: Settings | None = None) -> FastAPI:
    """The service as an ASGI application, by default with the environment's settings. Its threads and worker live while
    it runs.
    """
    settings, metrics = settings or Settings(), Metrics()
    stores = settings.stores()
    keys, audit, lanes = KeyStore(stores.documents(KEYS)), AuditLog(stores.engine), StorageLanes()

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        configure_logs()
        telemetry.begin("rholoc-server")
        app.state.rholoc = state = await asyncio.to_thread(_start, settings, metrics, keys, audit, stores, lanes)
        tasks = _begin(state)
        try:
            yield
        finally:
            for task in tasks:
                task.cancel()
            await _end(state)
            telemetry.end()

    app = FastAPI(
        title="rholoc",
        version=__version__,
        description=_DESCRIPTION,
        lifespan=lifespan,
        redirect_slashes=False,
        openapi_url=None,
        docs_url=None,
        redoc_url=None,
    )
    for router in ROUTERS:  # `include_router` would analyse every route anew, which takes a fifth of a second
        app.router.routes.extend(router.routes)
    web.install(app)
    for kind in (RholocError, ValidationError, RequestValidationError, HTTPException, OSError, SQLAlchemyError):
        app.add_exception_handler(kind, _answer_error)
    app.user_middleware.extend(_middlewares(app, settings, metrics, keys, audit, lanes))
    install(app, (*READ_BY_HAND, OscpRequest))
    return app


def _middlewares(
    app: FastAPI, settings: Settings, metrics: Metrics, keys: KeyStore, audit: AuditLog, lanes: StorageLanes
) -> list[Middleware]:
    """Middlewares between a request and its route, outermost first."""
    origins = [origin for origin in settings.origins.split(",") if origin]
    return [
        Middleware(Metered, metrics=metrics),
        Middleware(SecurityHeaders),
        *([Middleware(CORSMiddleware, allow_origins=origins, **_CORS)] if origins else []),
        Middleware(Traced),
        Middleware(RequestBoundary),
        Middleware(Audited, log=audit, lanes=lanes),
        Middleware(Tus),
        Middleware(
            Guard,
            routes=app.routes,
            keys=keys,
            lanes=lanes,
            policy=settings.keys,
            host=settings.host,
            open_paths=("/metrics",) if settings.open_metrics else (),
            origins=origins,
        ),
        Middleware(ProbesOnly),
        Middleware(ConcurrencyLimited, max_of_client=max(_MIN_UNDER_WAY, settings.max_connections // 4)),
        Middleware(RateLimited, keys=keys),
        Middleware(SlowBodies, silence_s=settings.slow_client_timeout_s),
        Middleware(FramesFirst, busy=lambda scope: scope["app"].state.rholoc.frames.compute.busy),
        Middleware(JsonBodies, max_bytes=settings.max_json_bytes),
    ]


def _begin(state: State) -> list[asyncio.Task[None]]:
    """Start the map watch, the learner, the worker and two tasks; returns the tasks, to be cancelled at the end."""
    state.operation.watch.start()
    state.frames.learner.start()
    if state.operation.worker is not None:
        state.operation.worker.start()
    return [asyncio.create_task(clean_up_regularly(state)), asyncio.create_task(follow_keys(state))]


async def _end(state: State) -> None:
    """Stop the worker, the watch, and all threads, and close the stores."""
    parts = state.operation
    if parts.worker is not None:
        parts.worker.stop()
    parts.watch.stop()
    state.frames.compute.close()
    state.frames.learner.close()
    await state.renderings.close()
    parts.readiness.close()
    parts.lanes.close()
    state.jobs.sync.close()
    parts.stores.close()


def _start(
    settings: Settings, metrics: Metrics, keys: KeyStore, audit: AuditLog, stores: Stores, lanes: StorageLanes
) -> State:
    """Open the stores and make the parts of the service. Blocks; starts only the catalogue's thread."""
    _open(settings, stores)
    keys.refresh()
    library, recordings = stores.library, stores.recordings
    jobs = JobQueue(recordings)
    uploads = UploadStore(
        recordings, jobs, settings.upload_expires_s, settings.max_upload_files, settings.max_unfinished_uploads
    )
    queries = QueryStore(stores.objects, KeptLimits(size_bytes=settings.learn_max_bytes))
    learner = Learner(queries, settings, stores.documents(ASKERS))
    sites = SiteLibrary(stores.documents(SITES))
    finder = MapFinder(library, settings.data_dir / VECTORS_FILE, min_maps=MAX_ASKED + 1)  # of fewer, all are asked
    compute = ComputePool(settings.concurrency, settings.queue_length)
    frames = Answerer(
        settings,
        library,
        sites,
        Localizers(library, settings.min_recognized),
        finder,
        compute,
        learner,
        Live(settings.live, settings.keep_failures),
        Refusals(settings.keep_refused, settings.max_image_pixels),
        metrics,
        lanes,
    )
    quotas = Quotas(Holdings(stores.engine), keys, library, recordings, uploads, jobs)
    async_quotas = AsyncQuotas(quotas, lanes)
    streams = OpenStreams(keys, *stream_limits(settings.max_streams, settings.max_connections))
    readiness = Readings(settings, jobs, stores)
    _measure(metrics, readiness, frames, streams)
    worker = EmbeddedWorker(settings.worker_setup, jobs) if settings.worker else None
    return State(
        settings=settings,
        maps=AsyncMaps(library, queries, settings, lanes),
        cameras=AsyncCameras(CameraLibrary(stores.documents(CAMERAS)), lanes),
        sites=AsyncSites(sites, lanes),
        recordings=AsyncRecordings(recordings, uploads, jobs, lanes),
        jobs=AsyncJobs(jobs, async_quotas, lanes),
        learning=AsyncLearning(library, learner, jobs, lanes),
        keys=AsyncKeys(keys, quotas, lanes),
        quotas=async_quotas,
        audit=AsyncAudit(audit, lanes),
        streams=streams,
        frames=frames,
        held_bodies=HeldBodies(_BODIES_AT_ONCE * settings.max_request_bytes),
        renderings=Renderings(settings.data_dir / "renderings", library, lanes),
        exports=Exports(settings.export_time_limit_s),
        operation=Operation(stores, metrics, readiness, worker, MapWatch(finder), lanes),
    )


def _open(settings: Settings, stores: Stores) -> None:
    """Make the folders and open the stores; a database that does not answer is logged and tried again later."""
    settings.data_dir.mkdir(parents=True, exist_ok=True)
    if not stores.are_shared:
        settings.maps_dir.mkdir(parents=True, exist_ok=True)
    stores.recall()
    try:  # engines connect on first use, and stores.follow() retries
        stores.open()
    except (RholocError, SQLAlchemyError) as error:
        _log.warning("database_not_opened", extra={"error": str(error)[:200]})
    stores.follow()


def _measure(metrics: Metrics, known: Readings, frames: Answerer, streams: OpenStreams) -> None:
    """Add gauges of jobs, frames, maps and streams."""
    metrics.gauge("rholoc_jobs", "Mapping jobs, as last known", "state", lambda: known.jobs.value)
    waiting = "Queued mapping jobs, by why no worker can take them, as last known"
    metrics.gauge("rholoc_jobs_waiting", waiting, "obstacle", lambda: known.waiting.value)
    metrics.gauge("rholoc_jobs_age_seconds", "Age of the last known numbers of jobs", "at", known.job_ages)
    under_way = "Frames that are being localized, or wait"
    metrics.gauge("rholoc_frames", under_way, "at", lambda: {"now": frames.compute.taken})
    present = "Maps in the folder, and how many of them are indexed"
    metrics.gauge("rholoc_maps", present, "state", frames.finder.counts)
    counted = lambda: {str(kind): streams.count(kind) for kind in StreamKind}  # noqa: E731
    metrics.gauge("rholoc_streams", "Streams that are open", "kind", counted)


async def _answer_error(request: Request, error: Exception) -> JSONResponse:
    """The answer to an error that a route raised. Raises an unexpected one again."""
    known = _known(error)
    if known is None:
        raise error
    body = error_body(known, request.state.request_id)
    return JSONResponse(body, status_of(type(known)), error_headers(known))


def _known(error: Exception) -> RholocError | None:
    """The error as one of ours; None if it is unexpected."""
    if isinstance(error, RequestValidationError):
        return invalid_request(error.errors())
    if isinstance(error, HTTPException):
        if error.status_code == 404:
            return UnknownRoute("There is nothing at this path.", "See /docs for the routes.")
        if error.status_code == 405:
            allowed = (error.headers or {}).get("Allow", "").split(", ")
            return MethodNotAllowed("This route does not support this method.", "See /docs for the routes.", allowed)
        return InvalidRequest(str(error.detail), "See /docs for what this route takes.")
    return as_rholoc_error(error)
