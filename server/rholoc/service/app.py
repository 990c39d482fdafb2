"""The application: assembles the parts and turns errors into responses."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import ValidationError
from sqlalchemy.exc import SQLAlchemyError
from starlette.exceptions import HTTPException

from rholoc import __version__, telemetry
from rholoc.errors import RholocError
from rholoc.jobs import (
    EmbeddedWorker,
    JobQueue,
    KeptLimits,
    QueryStore,
    RecordingStore,
    SharedQueryStore,
    SharedRecordingStore,
    SharedUploadStore,
    UploadStore,
)
from rholoc.localization import VECTORS_FILE, MapFinder
from rholoc.logs import configure_logs
from rholoc.maps import CameraLibrary, Documents, FolderDocuments, MapLibrary, SiteLibrary
from rholoc.service import web
from rholoc.service.audit import Audited, AuditLog, FolderAuditLog, SharedAuditLog
from rholoc.service.bodies import HeldBodies
from rholoc.service.compute import ComputePool
from rholoc.service.connections import SlowBodies
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
from rholoc.service.exports import Exports
from rholoc.service.guard import Guard, SecurityHeaders
from rholoc.service.housekeeping import clean_up_regularly
from rholoc.service.job_events import JobEvents
from rholoc.service.json_bodies import JsonBodies
from rholoc.service.keys import KeyStore
from rholoc.service.learning import Learner
from rholoc.service.live import Live
from rholoc.service.localizers import Localizers
from rholoc.service.map_watch import MapWatch
from rholoc.service.metrics import Metered, Metrics
from rholoc.service.middleware import RequestBoundary
from rholoc.service.openapi import install
from rholoc.service.pacing import FramesFirst
from rholoc.service.quotas import Quotas
from rholoc.service.rates import RateLimited
from rholoc.service.renderings import Renderings
from rholoc.service.routes import ROUTERS
from rholoc.service.settings import Settings
from rholoc.service.state import State
from rholoc.service.stream_count import OpenStreams
from rholoc.service.tracing import Traced
from rholoc.service.tus import Tus
from rholoc.storage import ASKERS, CAMERAS, KEYS, SITES, SharedStorage
from rholoc.storage.holdings import Holdings

_BODIES_AT_ONCE = 8  # of the largest size allowed

_DESCRIPTION = """\
One walk with a phone makes a **map**; then any camera in that room posts a frame and gets back where it is and where it
looks, in metres, in the map's frame (right-handed, z up), with an honest confidence.

Errors have one shape: `{code, message, hint, request_id}`. "No pose" is an answer, not an error."""


def create_app(settings: Settings | None = None) -> FastAPI:
    """The service as an ASGI application. Its threads and its worker live from start-up to shut-down."""
    settings, metrics = settings or Settings(), Metrics()
    shared = open_shared(settings)
    keys, audit = open_keys(settings, shared), audit_log(settings, shared)

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        configure_logs()
        telemetry.begin("rholoc-server")
        app.state.rholoc = state = _start(settings, metrics, keys, audit, shared)
        state.watch.start()
        state.learner.start()
        if state.worker is not None:
            state.worker.start()
        cleanup = asyncio.create_task(clean_up_regularly(state))
        try:
            yield
        finally:
            cleanup.cancel()
            if state.worker is not None:
                state.worker.stop()
            state.watch.stop()
            state.compute.close()
            state.learner.close()
            await state.renderings.close()
            state.jobs.close()
            if shared is not None:
                shared.close()
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
    for router in ROUTERS:
        app.include_router(router)
    web.install(app)
    for kind in (RholocError, ValidationError, RequestValidationError, HTTPException, OSError, SQLAlchemyError):
        app.add_exception_handler(kind, _answer_error)
    app.add_middleware(JsonBodies, max_bytes=settings.max_json_bytes)
    app.add_middleware(FramesFirst, busy=lambda scope: scope["app"].state.rholoc.compute.busy)
    app.add_middleware(SlowBodies, silence_s=settings.slow_client_timeout_s)
    app.add_middleware(RateLimited, keys=keys)
    app.add_middleware(Guard, routes=app.routes, keys=keys, policy=settings.keys, host=settings.host)
    app.add_middleware(Tus)
    app.add_middleware(Audited, log=audit)
    app.add_middleware(RequestBoundary)
    app.add_middleware(Traced)
    app.add_middleware(SecurityHeaders)
    app.add_middleware(Metered, metrics=metrics)
    install(app)
    return app


def open_shared(settings: Settings) -> SharedStorage | None:
    """What the service shares with others, not yet opened; None where it keeps all to itself.

    Raises:
        InvalidInput: an URL is not valid.
    """
    if settings.shared_storage is None:
        return None
    return SharedStorage(
        settings.shared_storage,
        settings.data_dir,
        settings.jobs_database,
        settings.storage_cache_bytes,
        settings.map_cache_bytes,
    )


def open_keys(settings: Settings, shared: SharedStorage | None) -> KeyStore:
    """The API keys of the service."""
    return KeyStore(settings.data_dir, None if shared is None else shared.documents(KEYS))


def audit_log(settings: Settings, shared: SharedStorage | None) -> AuditLog:
    """Where it is noted who changed what."""
    return FolderAuditLog(settings.data_dir) if shared is None else SharedAuditLog(shared.engine)


def _start(
    settings: Settings, metrics: Metrics, keys: KeyStore, audit: AuditLog, shared: SharedStorage | None
) -> State:
    settings.data_dir.mkdir(parents=True, exist_ok=True)
    limits = KeptLimits(size_bytes=settings.learn_max_bytes)
    if shared is None:
        settings.maps_dir.mkdir(parents=True, exist_ok=True)
        library = MapLibrary(settings.maps_dir, settings.map_cache_bytes)
        cameras, recordings = CameraLibrary(settings.maps_dir), RecordingStore(settings.data_dir)
        sites, queries = SiteLibrary(settings.maps_dir), QueryStore(settings.data_dir, limits)
        salts: Documents = FolderDocuments(settings.data_dir)
    else:
        shared.open(follow=True)
        library, cameras = shared.library, CameraLibrary(settings.maps_dir, shared.documents(CAMERAS))
        recordings = SharedRecordingStore(settings.data_dir, shared)
        sites = SiteLibrary(settings.maps_dir, shared.documents(SITES))
        queries, salts = SharedQueryStore(shared.objects, limits), shared.documents(ASKERS)
    jobs = JobQueue(settings.data_dir, settings.jobs_database, recordings)
    finder = MapFinder(library, settings.data_dir / VECTORS_FILE)
    compute = ComputePool(settings.concurrency, settings.queue_length)
    metrics.gauge("rholoc_jobs", "Mapping jobs", "state", lambda: {str(state): n for state, n in jobs.counts().items()})
    waiting = lambda: {str(obstacle or "none"): n for obstacle, n in jobs.waiting().items()}  # noqa: E731
    metrics.gauge("rholoc_jobs_waiting", "Queued mapping jobs, by why no worker can take them", "obstacle", waiting)
    metrics.gauge("rholoc_frames", "Frames that are being localized, or wait", "at", lambda: {"now": compute.taken})
    metrics.gauge("rholoc_maps", "Maps in the folder, and how many of them are indexed", "state", finder.counts)
    streams = OpenStreams(settings.max_streams)
    metrics.gauge("rholoc_streams", "Streams of frames that are open", "at", lambda: {"now": streams.count})
    uploads = _uploads(settings, recordings, jobs, shared)
    return State(
        settings=settings,
        library=library,
        cameras=cameras,
        keys=keys,
        audit=audit,
        shared=shared,
        localizers=Localizers(library, settings.min_confidence),
        finder=finder,
        sites=sites,
        watch=MapWatch(finder),
        renderings=Renderings(settings.data_dir / "renderings", library),
        compute=compute,
        held_bodies=HeldBodies(_BODIES_AT_ONCE * settings.max_request_bytes),
        exports=Exports(settings.export_time_limit_s),
        metrics=metrics,
        live=Live(settings.live, settings.keep_failures),
        recordings=recordings,
        uploads=uploads,
        jobs=jobs,
        job_events=JobEvents(jobs),
        queries=queries,
        learner=Learner(queries, settings, salts),
        worker=_worker(settings) if settings.worker else None,
        streams=streams,
        quotas=Quotas(Holdings(jobs.engine), keys, library, recordings, uploads, jobs),
    )


def _uploads(
    settings: Settings, recordings: RecordingStore, jobs: JobQueue, shared: SharedStorage | None
) -> UploadStore:
    limits = (settings.upload_expires_s, settings.max_upload_files, settings.max_unfinished_uploads)
    if shared is not None and isinstance(recordings, SharedRecordingStore):
        return SharedUploadStore(recordings, jobs, shared, *limits)
    return UploadStore(recordings, jobs, *limits)


def _worker(settings: Settings) -> EmbeddedWorker:
    return EmbeddedWorker(
        settings.data_dir,
        settings.maps_dir,
        settings.jobs_database,
        settings.job_limits,
        settings.shared_storage,
        settings.worker_capacity,
    )


async def _answer_error(request: Request, error: Exception) -> JSONResponse:
    known = _known(error)
    if known is None:
        raise error
    body = error_body(known, request.state.request_id)
    return JSONResponse(body, status_of(type(known)), error_headers(known))


def _known(error: Exception) -> RholocError | None:
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
