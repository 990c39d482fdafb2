"""The parts of the service that its routes share."""

from dataclasses import dataclass
from typing import Annotated

from fastapi import Depends, Request

from rholoc.library.stores import Stores
from rholoc.service.access.open_streams import OpenStreams
from rholoc.service.frames.answerer import Answerer
from rholoc.service.http.bodies import HeldBodies
from rholoc.service.http.metrics import Metrics
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
from rholoc.service.settings import Settings
from rholoc.service.threads.storage import StorageLanes
from rholoc.worker import EmbeddedWorker


@dataclass(frozen=True)
class Operation:
    """Background parts of the service, and its metrics."""

    stores: Stores
    metrics: Metrics
    readiness: Readings
    worker: EmbeddedWorker | None
    watch: MapWatch
    lanes: StorageLanes


@dataclass(frozen=True)
class State:
    """The parts of one running service."""

    settings: Settings
    maps: AsyncMaps
    cameras: AsyncCameras
    sites: AsyncSites
    recordings: AsyncRecordings
    jobs: AsyncJobs
    learning: AsyncLearning
    keys: AsyncKeys
    quotas: AsyncQuotas
    audit: AsyncAudit
    streams: OpenStreams
    frames: Answerer
    held_bodies: HeldBodies
    renderings: Renderings
    exports: Exports
    operation: Operation


def _state(request: Request) -> State:
    """The service that answers the request."""
    state: State = request.app.state.rholoc
    return state


Service = Annotated[State, Depends(_state)]
