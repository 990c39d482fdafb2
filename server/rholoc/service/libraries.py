"""Async facades of the libraries: each call runs in a thread of the lane for its resource.

Routes use only these. ``sync`` is the library itself, for other threads: its methods block on disk, database or
storage.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from rholoc.errors import Conflict, InvalidInput, InvalidMap, NotFound, UnknownMap, UnknownRecording
from rholoc.exports import ExportFormat
from rholoc.jobs import Job, JobKind, JobOptions, JobQueue, UploadStore
from rholoc.library.cameras import CameraLibrary
from rholoc.library.maps import MapLibrary
from rholoc.library.queries import KeptQueries, QueryStore
from rholoc.library.recording_notes import WAYPOINTS_FILE, RecordedWaypoint, read_notes, waypoints_file
from rholoc.library.recordings import PendingRecording, RecordingEntry, RecordingStore
from rholoc.library.sites import SiteLibrary
from rholoc.mapping.edit.correcting import set_floor_plan
from rholoc.mapping.learn.from_queries import MIN_QUERIES, too_few_queries
from rholoc.maps import FloorPlan, Map, MapInfo, SiteOnEarth, check_memory
from rholoc.service.access.audit import AuditLog
from rholoc.service.access.keys import ApiKey, KeyStore
from rholoc.service.access.quotas import Quotas, Usage
from rholoc.service.frames.kept.learning import Learner
from rholoc.service.http.files import OpenedFile
from rholoc.service.maps.descriptions import MapDetail, detail_of, list_of, versions_of
from rholoc.service.maps.job_events import JobEvents
from rholoc.service.maps.publishing import publish_file, publish_merged
from rholoc.service.settings import Settings
from rholoc.service.threads.storage import StorageLanes

NotedRecording = tuple[RecordingEntry, dict[str, bytes]]
"""A recording, and the content of the files with what is noted of it, by name."""


class AsyncMaps:
    """The maps.

    Attributes:
        publishing: lock on publishing, because checking a large map takes memory.
    """

    def __init__(self, library: MapLibrary, queries: QueryStore, settings: Settings, lanes: StorageLanes) -> None:
        self.sync, self._queries, self._settings, self._lanes = library, queries, settings, lanes
        self.publishing = asyncio.Lock()
        self.names = lanes.files.offload(library.names)
        self.readable = lanes.files.offload(library.readable)
        self.stat = lanes.files.offload(library.stat)
        self.existing = lanes.files.offload(self._existing)
        self.list = lanes.files.offload(partial(list_of, library))
        self.detail = lanes.database.offload(self._detail)
        self.versions = lanes.database.offload(partial(versions_of, library))
        self.rename = lanes.database.offload(library.rename)
        self.delete = lanes.database.offload(self._delete)
        self.path = lanes.fetches.offload(library.path)
        self.open = lanes.fetches.offload(self._open)
        self.publish = lanes.transfers.offload(self._publish)
        self.publish_merged = lanes.transfers.offload(partial(publish_merged, library))
        self.restore = lanes.transfers.offload(library.restore)
        self.replace = lanes.transfers.offload(library.replace)
        self.keep_plan = lanes.transfers.offload(self._keep_plan)

    async def get(self, name: str) -> Map:
        """A map, fetched from the storage if it is not on this machine. Raises InvalidName, UnknownMap, InvalidMap,
        StorageUnavailable, StorageFull.
        """
        if not await self._lanes.files(self.sync.is_here, name):
            await self.path(name)
        return await self._lanes.files(self.sync.get, name)

    def _existing(self, names: Iterable[str]) -> list[str]:
        """The ``names`` that exist in the library."""
        found = []
        for name in names:
            with suppress(UnknownMap):
                self.sync.stat(name)
                found.append(name)
        return found

    def _detail(self, name: str, published: Map | None = None) -> MapDetail:
        """Description of a map, its file's size and settings of this server included. Raises the errors of :meth:`get`.
        ``published`` is the map that the request just published: the library's may be newer, or not visible here yet.
        """
        library, settings = self.sync, self._settings
        detail = detail_of(name, published or library.get(name), library.stat(name).size_bytes, library.previous(name))
        here = {
            "live": settings.live,
            "keeps_failures": settings.keep_failures,
            "keeps_refused": settings.keep_refused > 0,
            "pictures": detail.pictures and settings.keep_pictures,
        }
        return detail.model_copy(update=here)

    def _delete(self, name: str) -> None:
        """Delete a map and its kept queries. Raises InvalidName, UnknownMap, StorageUnavailable, StorageFull."""
        with suppress(InvalidMap):  # an unreadable map has no id; the sweep deletes its queries
            self._queries.delete(self.sync.map_id(name))
        self.sync.delete(name)

    def _open(self, name: str, headers: dict[str, str]) -> OpenedFile:
        """A response with a map's file. Raises UnknownMap, or Conflict if the map is replaced at this moment."""
        try:
            return OpenedFile(self.sync.path(name), headers, ExportFormat.RHO.media_type)
        except FileNotFoundError:
            self.sync.stat(name)  # raises UnknownMap, unless it came back meanwhile
            raise Conflict(f"The map {name} was replaced in the meantime.", "Try again.") from None

    def _publish(self, name: str, arrived: Path) -> None:
        """Publish an uploaded file. Raises as :func:`publish_file`."""
        publish_file(self.sync, name, arrived, self._settings)

    def _keep_plan(self, name: str, content: bytes, plan: FloorPlan | None) -> Map:
        """Publish a map's next version with another floor plan, or none if ``plan`` is None, and return it."""
        planned = set_floor_plan(self.sync.get(name), content, plan)
        self.sync.replace(name, planned)
        return planned


class AsyncCameras:
    """The stored cameras."""

    def __init__(self, cameras: CameraLibrary, lanes: StorageLanes) -> None:
        self.names = lanes.database.offload(cameras.names)
        self.get = lanes.database.offload(cameras.get)
        self.put = lanes.database.offload(cameras.put)
        self.delete = lanes.database.offload(cameras.delete)
        self.named_in = lanes.database.offload(cameras.named_in)


class AsyncSites:
    """The sites."""

    def __init__(self, sites: SiteLibrary, lanes: StorageLanes) -> None:
        self.names = lanes.database.offload(sites.names)
        self.get = lanes.database.offload(sites.get)
        self.all = lanes.database.offload(sites.all)
        self.put = lanes.database.offload(sites.put)
        self.delete = lanes.database.offload(sites.delete)
        self.rename_map = lanes.database.offload(sites.rename_map)
        self._sync = sites
        self.earth_of = lanes.database.offload(self._earth_of)

    def _earth_of(self, map_name: str) -> SiteOnEarth | None:
        """Pose on Earth of a map, by the first site that has placed it; None if none has, or the site has none."""
        name = self._sync.site_of(map_name)
        try:
            return None if name is None else self._sync.get(name).earth_of(map_name)
        except (NotFound, InvalidInput):  # deleted meanwhile
            return None


class AsyncJobs:
    """The mapping jobs.

    Attributes:
        events: of the jobs that are watched.
    """

    def __init__(self, jobs: JobQueue, quotas: AsyncQuotas, lanes: StorageLanes) -> None:
        self.sync, self._quotas, self._database = jobs, quotas, lanes.database
        self.events = JobEvents(jobs, lanes.database)
        self.list = lanes.database.offload(jobs.list)
        self.get = lanes.database.offload(jobs.get)
        self.prioritize = lanes.database.offload(jobs.prioritize)
        self.cancel = lanes.database.offload(jobs.cancel)
        self.delete = lanes.database.offload(jobs.delete)

    async def begin(self, key: ApiKey | None, map_name: str, submit: Callable[[JobQueue], Job]) -> Job:
        """Queue a job by ``submit``, counted to a key.

        Args:
            key: of the request; None if none is needed.
            map_name: name of the map that the job makes, or empty.
            submit: queues the job, in a thread.

        Raises:
            QuotaExceeded: the key's limit of unfinished jobs is reached.
        """
        async with self._quotas.counting(key):
            await self._quotas.check(key, job_for=map_name)
            job = await self._database(submit, self.sync)
            await self._quotas.hold_job(key, job.id, map_name)
        return job


class AsyncRecordings:
    """The recordings, and the uploads that become recordings."""

    def __init__(self, store: RecordingStore, uploads: UploadStore, jobs: JobQueue, lanes: StorageLanes) -> None:
        self.sync, self.uploads, self._jobs = store, uploads, jobs
        self.list = lanes.database.offload(self._list)
        self.get = lanes.database.offload(self._get)
        self.correct = lanes.database.offload(self._correct)
        self.delete = lanes.database.offload(self._delete)
        self.begin = lanes.files.offload(store.begin)
        self.commit = lanes.transfers.offload(self._commit)
        self.begin_upload = lanes.database.offload(uploads.create)
        self.upload = lanes.database.offload(uploads.get)
        self.append = lanes.transfers.offload(uploads.append)

    def _list(self) -> list[NotedRecording]:
        """All recordings with the files of their notes, the newest first."""
        found = []
        for entry in self.sync.list():
            with suppress(UnknownRecording):  # deleted meanwhile
                found.append((entry, self.sync.notes(entry.id)))
        return found

    def _get(self, recording: str) -> NotedRecording:
        """A recording with its notes. Raises UnknownRecording."""
        return self.sync.get(recording), self.sync.notes(recording)

    def _correct(self, recording: str, waypoints: tuple[RecordedWaypoint, ...] | None) -> NotedRecording:
        """Replace a recording's waypoints; None: by its own. Raises UnknownRecording, InvalidWaypoints, StorageFull."""
        notes = read_notes(self.sync.notes(recording))
        corrected = None if waypoints is None else waypoints_file(waypoints, notes)
        self.sync.note(recording, {WAYPOINTS_FILE: corrected})
        return self._get(recording)

    def _commit(self, pending: PendingRecording, map_name: str, options: JobOptions) -> tuple[RecordingEntry, Job]:
        """Store an uploaded recording and queue its job, or neither. Raises Conflict, InvalidRecording, StorageFull,
        StorageUnavailable.
        """
        entry = pending.commit()
        try:
            return entry, self._jobs.submit(entry.id, map_name, options)
        except Exception:
            self.sync.delete(entry.id)  # it has no job
            raise

    def _delete(self, recording: str) -> None:
        """Abandon an upload, or delete a recording. Raises UnknownRecording, or Conflict while a job has it."""
        try:
            self.uploads.delete(recording)
        except UnknownRecording:
            self._jobs.delete_recording(recording)


@dataclass(frozen=True)
class Learning:
    """A map's kept queries and learning jobs.

    Attributes:
        info: of the map.
        kept: summary of the kept queries.
        job: queued or running learning job, or None.
        latest: last published or failed learning job, or None.
    """

    info: MapInfo
    kept: KeptQueries
    job: Job | None
    latest: Job | None


class AsyncLearning:
    """The queries that are kept for maps to learn from."""

    def __init__(self, library: MapLibrary, learner: Learner, jobs: JobQueue, lanes: StorageLanes) -> None:
        self._library, self._learner, self._jobs = library, learner, jobs
        self.store = learner.store
        self.get = lanes.database.offload(self._get)
        self.delete = lanes.database.offload(self._delete)

    @property
    def listens(self) -> bool:
        """Whether queries are kept."""
        return self._learner.listens

    def _get(self, name: str) -> Learning:
        """A map's kept queries and learning jobs. Raises InvalidName, UnknownMap, InvalidMap, StorageUnavailable."""
        info = self._library.get(name).info
        jobs = self._jobs
        return Learning(info, self.store.kept(info.id), jobs.learning(name), jobs.last_learning(name))

    def _delete(self, name: str, asker: str | None) -> int:
        """Delete a map's queries, or those of one asker (a key's name or an address). Returns how many."""
        who = None if asker is None else self._learner.pseudonym(asker)
        return self.store.delete(self._library.map_id(name), who)

    def submit(self, name: str) -> Job:
        """Queue a job by which a map learns. Blocks: call it in a thread.

        Raises:
            InvalidInput: the map has no memory.
            Conflict: fewer than ``MIN_QUERIES`` queries are kept, or it is learning already.
        """
        map_ = self._library.get(name)
        check_memory(map_, f"The map {name}")
        kept = self.store.kept(map_.info.id).queries
        if kept < MIN_QUERIES:
            raise too_few_queries(kept)
        if (running := self._jobs.learning(name)) is not None:
            raise Conflict(f"The map {name} is learning already.", f"Wait for the job {running.id}.")
        return self._jobs.submit("", name, JobOptions(kind=JobKind.LEARN))


class AsyncQuotas:
    """Quotas of API keys and their use."""

    def __init__(self, quotas: Quotas, lanes: StorageLanes) -> None:
        self.sync = quotas
        self.counting = quotas.counting
        self.check = lanes.database.offload(quotas.check)
        self.check_upload = lanes.database.offload(quotas.check_upload)
        self.hold = lanes.database.offload(quotas.hold)
        self.hold_job = lanes.database.offload(quotas.hold_job)
        self.rename_map = lanes.database.offload(quotas.rename_map)
        self.uploads = lanes.database.offload(quotas.uploads)


class AsyncKeys:
    """The API keys. ``chain`` reads memory alone, and does not block."""

    def __init__(self, keys: KeyStore, quotas: Quotas, lanes: StorageLanes) -> None:
        self.sync, self._quotas = keys, quotas
        self.chain = keys.chain
        self.list = lanes.database.offload(keys.keys)
        self.get = lanes.database.offload(self._get)
        self.hand_on = lanes.database.offload(keys.hand_on)
        self.limit = lanes.database.offload(keys.limit)
        self.revoke = lanes.database.offload(keys.revoke)
        self.abandon_uploads = lanes.database.offload(quotas.abandon_uploads)

    def _get(self, name: str) -> tuple[ApiKey, Usage]:
        """The key called ``name`` and its usage with all keys below it. Raises NotFound."""
        return self.sync.named(name), self._quotas.usage(name)


class AsyncAudit:
    """The requests that changed something."""

    def __init__(self, log: AuditLog, lanes: StorageLanes) -> None:
        self.changes = lanes.database.offload(log.changes)
