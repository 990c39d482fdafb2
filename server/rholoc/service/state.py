"""The parts of the service that its routes share."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field
from typing import Annotated

from fastapi import Depends, Request

from rholoc.jobs import EmbeddedWorker, JobQueue, QueryStore, RecordingStore, Stores, UploadStore
from rholoc.localization import AnyLocalizer, MapFinder
from rholoc.maps import CameraLibrary, Map, MapLibrary, SiteLibrary
from rholoc.service.access.audit import AuditLog
from rholoc.service.access.keys import KeyStore
from rholoc.service.access.open_streams import OpenStreams
from rholoc.service.access.quotas import Quotas
from rholoc.service.frames.learning import Learner
from rholoc.service.frames.live import Live
from rholoc.service.frames.localizers import Localizers
from rholoc.service.http.bodies import HeldBodies
from rholoc.service.http.metrics import Metrics
from rholoc.service.maps.exports import Exports
from rholoc.service.maps.job_events import JobEvents
from rholoc.service.maps.map_watch import MapWatch
from rholoc.service.maps.renderings import Renderings
from rholoc.service.operate.readings import Readings
from rholoc.service.settings import Settings
from rholoc.service.threads.compute import ComputePool
from rholoc.service.threads.storage import StorageLanes


@dataclass(frozen=True)
class State:
    """The parts of one running service."""

    settings: Settings
    library: MapLibrary
    cameras: CameraLibrary
    keys: KeyStore
    audit: AuditLog
    stores: Stores
    localizers: Localizers
    finder: MapFinder
    sites: SiteLibrary
    watch: MapWatch
    renderings: Renderings
    compute: ComputePool
    held_bodies: HeldBodies
    exports: Exports
    metrics: Metrics
    live: Live
    recordings: RecordingStore
    uploads: UploadStore
    jobs: JobQueue
    job_events: JobEvents
    queries: QueryStore
    learner: Learner
    worker: EmbeddedWorker | None
    streams: OpenStreams
    quotas: Quotas
    readiness: Readings
    threads: StorageLanes
    publishing: asyncio.Lock = field(default_factory=asyncio.Lock)  # a large map takes memory while it is checked

    async def map(self, name: str) -> Map:
        """The map of a name, fetched from the storage if it is not on this machine.

        Raises:
            InvalidName, UnknownMap, InvalidMap: as :meth:`rholoc.maps.MapLibrary.get` does.
            StorageUnavailable, StorageFull: it cannot be fetched.
        """
        await self._fetch(name)
        return await self.threads.files(self.library.get, name)

    async def localizer(self, name: str) -> AnyLocalizer:
        """The localizer of the map of a name. Raises as :meth:`map` does."""
        await self._fetch(name)
        return await self.threads.files(self.localizers.get, name)

    async def _fetch(self, name: str) -> None:
        if not await self.threads.files(self.library.is_here, name):
            await self.threads.fetches(self.library.path, name)


def _state(request: Request) -> State:
    state: State = request.app.state.rholoc
    return state


Service = Annotated[State, Depends(_state)]
