"""A worker: takes jobs from the queue, and takes over those of workers that died.

A job's row alone says who has it (:mod:`rholoc.jobs.table`): a worker takes the job whose turn it is, of those that it
has memory for, by changing that row. DBOS runs the job's steps and remembers which were done; each worker has a queue
there for what it has taken. (DBOS's queues could not choose the jobs: their limits are stored with the queue, alike for
all workers, and priorities do not reach from one queue to another.)
"""

from __future__ import annotations

import logging
import os
import shutil
import signal
import socket
import threading
import time
import uuid
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import FrameType
from typing import TypeVar

import sqlalchemy as sa
from dbos import DBOS, DBOSClient, DBOSConfig
from sqlalchemy.exc import SQLAlchemyError

from rholoc import telemetry
from rholoc.disk import is_full, reporting_full_disk, storage_full
from rholoc.errors import Cancelled, RholocError, StorageUnavailable
from rholoc.jobs.build_process import BuildLimits, KilledForMemory, build_in_process, describe, unexpected
from rholoc.jobs.capacity import Capacity, MoreMemoryNeeded
from rholoc.jobs.job import JobKind
from rholoc.jobs.pipeline import MappingPipeline, MappingTask, Pipeline, doubts
from rholoc.jobs.recording_notes import READ_FILES
from rholoc.jobs.recording_store import RecordingStore
from rholoc.jobs.shared_queries import SharedQueryStore
from rholoc.jobs.shared_recordings import SharedRecordingStore
from rholoc.jobs.site_placing import store_links
from rholoc.jobs.table import DEAD_AFTER_S, RELEASE, Claim, Failure, JobTable, JobWork, Lease, WorkerTable
from rholoc.maps import CameraLibrary, Map, MapLibrary, SiteLibrary
from rholoc.progress import Stage
from rholoc.storage import CAMERAS, SITES, SharedStorage
from rholoc.storage.database import open_database

_log = logging.getLogger("rholoc.jobs")

_MAX_ATTEMPTS = 5
_INPUTS, _MAP_FILE, _LINKS_FILE = "inputs", "map.rho", "links.json"  # in a job's work folder
_STORAGE_PATIENCE_S, _STORAGE_AGAIN_S = 600.0, 2.0
_T = TypeVar("_T")
_APPLICATION = "rholoc"
WORKER_QUEUE = "rholoc-worker-"  # and the worker's id
_WORKFLOW = "rholoc-map-recording"
_ACTIVE = ("PENDING", "ENQUEUED", "DELAYED")  # states of workflows


@dataclass(frozen=True)
class Timing:
    """How quickly workers notice things.

    Attributes:
        poll_s: how often the queue is polled for jobs, and a running job is checked for cancellation.
        heartbeat_s: how often a worker's heartbeat is recorded.
        dead_after_s: the age of the last heartbeat at which a worker counts as dead.
        cancel_grace_s: how long a cancelled build may take to stop by itself.
    """

    poll_s: float = 0.5
    heartbeat_s: float = 2.0
    dead_after_s: float = DEAD_AFTER_S
    cancel_grace_s: float = 1.0


class StageSpans:
    """Spans of a build's stages, each noted when the next one is heard of."""

    def __init__(self) -> None:
        self._stage: Stage | None = None
        self._begun_s = 0.0

    def note(self, stage: Stage) -> None:
        """Hear of a stage; again and again, while it lasts."""
        if stage is not self._stage:
            self.end()
            self._stage, self._begun_s = stage, time.perf_counter()

    def end(self) -> None:
        """The last stage has ended."""
        if self._stage is not None:
            telemetry.note(str(self._stage), time.perf_counter() - self._begun_s)
        self._stage = None


class Worker:
    """A worker; at most one per process.

    Args:
        data_dir, maps_dir: the folders of jobs and of maps.
        database_url: ``postgresql://…``, or None for the SQLite file.
        pipeline: what is done for a job.
        timing: how quickly it notices things.
        limits: what one job may take.
        storage_url: of the storage that it shares with others, None for its folders.
        capacity: how much it takes on.
        release: whose work it can do, and that of all before.
    """

    def __init__(
        self,
        data_dir: Path,
        maps_dir: Path,
        database_url: str | None = None,
        *,
        pipeline: Pipeline | None = None,
        timing: Timing | None = None,
        limits: BuildLimits | None = None,
        storage_url: str | None = None,
        capacity: Capacity | None = None,
        release: int = RELEASE,
    ) -> None:
        self.id = f"{socket.gethostname()[:40]}-{os.getpid()}-{uuid.uuid4().hex[:8]}"
        self._data_dir = Path(data_dir).resolve()
        self._maps_dir = Path(maps_dir).resolve()
        self._pipeline = pipeline or MappingPipeline()
        self._timing = timing or Timing()
        self._limits = limits or BuildLimits()
        self._capacity = capacity or Capacity()
        self._release = release
        self._queue = f"{WORKER_QUEUE}{self.id}"
        self._database_url = database_url
        self._shared = None if storage_url is None else SharedStorage(storage_url, self._data_dir, database_url)
        self._stopping = threading.Event()
        self._idle = threading.Condition()
        self._claims: dict[str, Claim] = {}  # by workflow
        self._left_before: set[Lease] = set()

    def start(self) -> None:
        """Begin to take jobs, in its own threads and processes.

        Raises:
            StorageFull: the disk is full.
        """
        if self._shared is None:
            self._recordings = RecordingStore(self._data_dir)
            self._engine = open_database(self._data_dir, self._database_url)
        else:
            self._shared.open()
            self._recordings = SharedRecordingStore(self._data_dir, self._shared)
            self._engine = self._shared.engine
        self._client = DBOSClient(system_database_engine=self._engine, application_name=_APPLICATION)
        self._jobs, self._workers = JobTable(self._engine), WorkerTable(self._engine)
        self._beat()
        config: DBOSConfig = {
            "name": _APPLICATION,
            "system_database_engine": self._engine,
            "executor_id": self.id,
            "application_version": str(self._release),
            "log_level": "ERROR",
        }
        DBOS(config=config)
        DBOS.workflow(name=_WORKFLOW, max_recovery_attempts=None)(self._workflow())
        DBOS.listen_queues([self._queue])
        self._clear_unwanted_work()
        DBOS.launch()
        self._threads = [
            threading.Thread(target=self._keep_beating, name="rholoc-heartbeat", daemon=True),
            threading.Thread(target=self._keep_taking, name="rholoc-jobs", daemon=True),
        ]
        for thread in self._threads:
            thread.start()
        _log.info("worker %s started", self.id)

    def stop(self) -> None:
        """Stop within a few seconds; jobs that were running go back to the queue."""
        self._stopping.set()
        for thread in self._threads:
            thread.join()
        DBOS.destroy(destroy_registry=True)
        with self._idle:
            claims = list(self._claims.values())
        for claim in claims:
            self._jobs.release(claim.lease)
        with self._idle:
            self._idle.wait_for(lambda: not self._claims, timeout=self._timing.cancel_grace_s + 5.0)
        self._workers.remove(self.id)
        self._client.delete_queue(self._queue)
        self._client.destroy()
        self._engine.dispose()
        _log.info("worker %s stopped", self.id)

    # -- taking jobs ---------------------------------------------------------------------------------------------------

    def _keep_taking(self) -> None:
        while not self._stopping.wait(self._timing.poll_s):
            try:
                while self._take():
                    pass
            except Exception:
                _log.exception("no job could be taken; it is tried again")

    def _take(self) -> bool:
        """Take a job, if there is one for which there is room."""
        with self._idle:
            taken = list(self._claims.values())
        if len(taken) >= self._capacity.jobs:
            return False
        free_bytes = self._capacity.memory_bytes - sum(claim.memory_bytes for claim in taken)
        claim = self._jobs.take(self.id, self._offered_bytes, free_bytes, self._release)
        if claim is None:
            return False
        with self._idle:
            self._claims[claim.lease.workflow] = claim
        try:
            self._begin(claim.lease)
        except Exception:  # the sweep gives the job back
            self._drop(claim)
            raise
        return True

    def _begin(self, lease: Lease) -> None:
        """Begin the workflow of a job, or go on with it."""
        known = self._client.list_workflows(workflow_ids=[lease.workflow], load_input=False, load_output=False)
        if not known:
            self._client.enqueue(
                {
                    "workflow_name": _WORKFLOW,
                    "queue_name": self._queue,
                    "workflow_id": lease.workflow,
                    "app_version": str(self._release),
                },
                lease.job,
            )
        elif known[0].status in _ACTIVE:  # the worker died that had it
            self._client.resume_workflows([lease.workflow], queue_name=self._queue)
        else:  # it ended and the job did not: it was handed on, or the database failed
            self._client.rewind_workflow(lease.workflow, queue_name=self._queue)

    def _drop(self, claim: Claim) -> None:
        with self._idle:
            self._claims.pop(claim.lease.workflow, None)
            self._idle.notify_all()

    @property
    def _offered_bytes(self) -> float:
        """The most that one job may take here."""
        return min(self._capacity.memory_bytes, self._limits.memory_bytes)

    def _most_offered_bytes(self) -> float:
        """The most that one job may take at any worker that can do it."""
        living = self._workers.living(self._timing.dead_after_s)
        able = [worker.memory_bytes for worker in living if worker.release >= self._release]
        return max(able, default=self._offered_bytes)

    # -- doing them ----------------------------------------------------------------------------------------------------

    def _workflow(self) -> Callable[[str], None]:
        def map_recording(job_id: str) -> None:
            workflow = DBOS.workflow_id
            assert workflow is not None
            self._work(job_id, workflow)

        return map_recording

    def _work(self, job_id: str, workflow: str) -> None:
        """The workflow. A worker that continues it finds the results of completed steps."""
        with self._idle:
            claim = self._claims.get(workflow)
        if claim is None:
            return
        work = claim.work
        about: dict[str, telemetry.Value] = {
            "rholoc.job": job_id,
            "rholoc.map": work.map_name,
            "rholoc.attempt": claim.lease.attempt,
        }
        try:
            with telemetry.job_span(f"job {work.options.kind}", about, work.asked_in) as marks:
                self._build_and_publish(claim.lease, work, marks)
        except Cancelled:
            _log.info("job %s left: cancelled, or given to another worker", job_id)
            self._clear_unwanted_work()
        finally:
            self._drop(claim)

    def _build_and_publish(self, lease: Lease, work: JobWork, marks: telemetry.Marks) -> None:
        stopped = self._too_often(lease) or DBOS.run_step({"name": "build"}, self._build, lease, work)
        done = stopped or DBOS.run_step({"name": "publish"}, self._publish, lease, work)
        if isinstance(done, MoreMemoryNeeded):
            _log.info("job %s is handed on: it needs %.1f GiB of memory", lease.job, done.memory_bytes / 2**30)
            ended = self._jobs.hand_on(lease, done.memory_bytes)
        elif isinstance(done, Failure):
            _log.warning("job %s failed: %s", lease.job, done.message)
            marks.fail(done.message)
            ended = self._jobs.fail(lease, done)
        else:
            ended = self._jobs.publish(lease, done)
        if ended:  # otherwise another worker has the job, and needs the map that was built
            shutil.rmtree(self._work_dir(lease), ignore_errors=True)

    def _too_often(self, lease: Lease) -> Failure | None:
        if lease.attempt <= _MAX_ATTEMPTS:
            return None
        return Failure(
            "internal",
            f"{_MAX_ATTEMPTS} workers ended while they worked on this job.",
            "It may need more memory than they have. Give them more and retry, or record a shorter walk.",
        )

    def _build(self, lease: Lease, work: JobWork) -> Failure | MoreMemoryNeeded | None:
        stages = StageSpans()

        def note(stage: Stage, fraction: float, message: str = "") -> None:
            stages.note(stage)
            self._note(lease, stage, fraction, message)

        try:
            with telemetry.span("inputs"):
                task = self._patiently(lease, lambda: self._task(lease, work))
            granted_bytes = self._free_bytes(lease)
            stopped = build_in_process(
                self._pipeline,
                task,
                note=note,
                check=lambda: self._check_held(lease),
                poll_s=self._timing.poll_s,
                cancel_grace_s=self._timing.cancel_grace_s,
                limits=replace(self._limits, memory_bytes=granted_bytes),
            )
            if work.recording:
                self._recordings.share_notes(work.recording, READ_FILES)
            if isinstance(stopped, KilledForMemory):
                more = MoreMemoryNeeded.after(stopped.held_bytes, granted_bytes, self._most_offered_bytes())
                return more or stopped.failure
            return stopped
        except Cancelled:
            raise
        except RholocError as error:
            return describe(error)
        finally:
            stages.end()

    def _publish(self, lease: Lease, work: JobWork) -> tuple[str, ...] | Failure | MoreMemoryNeeded:
        """Publish the map; returns why it is not to be trusted, or why it could not be published here."""
        if not self._jobs.begin_publishing(lease):
            raise Cancelled("This worker no longer has the job.")
        try:
            task = self._patiently(lease, lambda: self._task(lease, work))
            if not task.built_file.exists():  # it was built on another machine, whose disk this one does not see
                failure = self._build(lease, work)
                if failure is not None:
                    return failure
            with telemetry.span("publish"):
                reasons = self._patiently(lease, lambda: self._put(lease, work, task))
            if work.recording:
                self._recordings.release(work.recording)
            return reasons
        except Cancelled:
            raise
        except RholocError as error:
            return describe(error)
        except OSError as error:
            return describe(storage_full()) if is_full(error) else unexpected(error)
        except Exception as error:
            return unexpected(error)

    def _put(self, lease: Lease, work: JobWork, task: MappingTask) -> tuple[str, ...]:
        """Put what was built where everybody finds it; returns why it is not to be trusted, or not complete."""
        library = self._library(lease)
        if work.options.site is None:
            return self._pipeline.publish(task, library)
        return store_links(task.built_file, work.options.site, self._sites(), library)

    def _patiently(self, lease: Lease, act: Callable[[], _T]) -> _T:
        """Do what needs the shared storage; while that does not answer, try again, for a time.

        Raises:
            Cancelled: the job is not this worker's any more.
            StorageUnavailable: it has not answered for that time.
        """
        last_s = time.monotonic() + _STORAGE_PATIENCE_S
        while True:
            try:
                return act()
            except StorageUnavailable as error:
                if time.monotonic() > last_s or self._stopping.is_set():
                    raise
                _log.warning("job %s waits for the storage: %s", lease.job, error.message)
            self._stopping.wait(_STORAGE_AGAIN_S)
            self._check_held(lease)

    def _library(self, lease: Lease) -> MapLibrary:
        """Where the map goes; in a shared one the job's end is noted with it, or neither."""
        if self._shared is None:
            return MapLibrary(self._maps_dir)

        def note(connection: sa.Connection, map_: Map) -> None:
            if not self._jobs.publish(lease, doubts(map_), connection):
                raise Cancelled("This worker no longer has the job.")

        self._shared.refresh()
        return self._shared.library.publishing_with(note)

    def _task(self, lease: Lease, work: JobWork) -> MappingTask:
        folder = self._work_dir(lease)
        with reporting_full_disk():
            folder.mkdir(parents=True, exist_ok=True)
        needs_recording = work.options.kind.reads_recording
        return MappingTask(
            recording=self._recordings.path(work.recording) if needs_recording else None,
            built_file=folder / _built_name(work),
            maps_dir=self._maps_dir if self._shared is None else self._inputs(folder, work),
            map_name=work.map_name,
            options=work.options,
            max_frame_pixels=self._limits.frame_pixels,
            folder=self._recordings.folder(work.recording) if needs_recording else None,
            data_dir=self._data_dir if self._shared is None else folder / _INPUTS,
            memory_bytes=self._granted_bytes(lease),
        )

    def _granted_bytes(self, lease: Lease) -> float:
        """How much memory a job may turn out to need. Beside others none, until that is known: with what is found it is
        handed on, and taken where there is room for it."""
        with self._idle:
            claim = self._claims.get(lease.workflow)
        is_unknown = claim is not None and claim.memory_bytes == 0
        return 0.0 if is_unknown and self._capacity.jobs > 1 else self._free_bytes(lease)

    def _free_bytes(self, lease: Lease) -> float:
        """How much memory the other jobs leave to one."""
        with self._idle:
            others = [claim.memory_bytes for claim in self._claims.values() if claim.lease != lease]
        return min(self._limits.memory_bytes, self._capacity.memory_bytes - sum(others))

    def _inputs(self, folder: Path, work: JobWork) -> Path:
        """A folder with copies of the maps, site, camera and queries that a job needs of the shared ones."""
        assert self._shared is not None
        self._shared.refresh()
        inputs = folder / _INPUTS
        inputs.mkdir(exist_ok=True)
        if (folder / _built_name(work)).exists():
            return inputs
        if work.options.site is not None:
            site = self._sites().get(work.options.site)
            SiteLibrary(inputs).put(work.options.site, site)
            present = set(self._shared.library.names())
            self._copy_maps([one.map for one in site.maps if one.map in present], inputs)
        elif work.options.kind is not JobKind.BUILD:
            self._copy_maps([work.map_name], inputs)
        if work.options.kind is JobKind.LEARN:
            queries = SharedQueryStore(self._shared.objects)
            queries.fetch(self._shared.library.map_id(work.map_name), inputs)
        cameras = CameraLibrary(inputs, self._shared.documents(CAMERAS))
        if work.options.camera is not None and "," not in work.options.camera:
            CameraLibrary(inputs).put(work.options.camera, cameras.get(work.options.camera))
        return inputs

    def _copy_maps(self, names: Sequence[str], folder: Path) -> None:
        """Copy shared maps that are not in the folder yet."""
        assert self._shared is not None
        for name in names:
            copy = MapLibrary(folder).path(name)
            if not copy.exists():
                arriving = copy.with_name(f".{copy.name}")
                shutil.copyfile(self._shared.library.path(name), arriving)
                arriving.replace(copy)

    def _sites(self) -> SiteLibrary:
        return SiteLibrary(self._maps_dir, None if self._shared is None else self._shared.documents(SITES))

    def _work_dir(self, lease: Lease) -> Path:
        return self._data_dir / "work" / lease.workflow

    def _clear_unwanted_work(self) -> None:
        """Remove the files of jobs that were cancelled, or ended while no worker had them."""
        folders = list((self._data_dir / "work").glob("*"))
        wanted = self._jobs.wanted_workflows()  # after listing the folders, so that a new job's is not removed
        for folder in folders:
            if folder.name not in wanted:
                shutil.rmtree(folder, ignore_errors=True)

    def _note(self, lease: Lease, stage: Stage, fraction: float, message: str = "") -> None:
        try:
            self._jobs.note(lease, stage, fraction, message)
        except SQLAlchemyError:
            _log.exception("progress of job %s could not be noted", lease.job)

    def _check_held(self, lease: Lease) -> None:
        """Raises Cancelled if this worker no longer has the job."""
        try:
            held = self._jobs.holds(lease)
        except SQLAlchemyError:
            _log.exception("job %s could not be looked up", lease.job)
            return
        if not held:
            raise Cancelled("The job was cancelled, or another worker has it.")

    # -- looking after each other --------------------------------------------------------------------------------------

    def _keep_beating(self) -> None:
        while not self._stopping.wait(self._timing.heartbeat_s):
            try:
                self._beat()
                self._sweep()
            except Exception:
                _log.exception("the heartbeat failed; it is tried again")

    def _beat(self) -> None:
        self._workers.beat(self.id, self._offered_bytes, self._release)
        # Each time: while the database was gone no heart was seen to beat, and another may have removed the queue.
        self._client.register_queue(self._queue, polling_interval_sec=self._timing.poll_s)

    def _sweep(self) -> None:
        """Queue the jobs of dead workers again, and those that a failure of the database stopped here."""
        for dead in self._workers.forget(self._timing.dead_after_s):
            self._client.delete_queue(f"{WORKER_QUEUE}{dead}")
        living = self._workers.living(self._timing.dead_after_s)
        # Workers of before rows named them look after each other, as long as one is left.
        are_all_named = all(worker.release > 1 for worker in living)
        taken_back = self._jobs.take_back([self.id, *(worker.id for worker in living)], with_nameless=are_all_named)
        for lease in self._left_behind():
            self._jobs.release(lease)
            taken_back += 1
        if taken_back:
            _log.warning("%d jobs that nobody works on are queued again", taken_back)

    def _left_behind(self) -> set[Lease]:
        """This worker's jobs that none of its threads works on, neither now nor at the last sweep.

        This happens when a full disk, or a database that fails, prevents a job's end from being recorded.
        """
        held = self._jobs.held_by(self.id)
        with self._idle:
            left = {lease for lease in held if lease.workflow not in self._claims}
        found, self._left_before = left & self._left_before, left
        return found


def _built_name(work: JobWork) -> str:
    """Of the file in which a job keeps what it built."""
    return _MAP_FILE if work.options.site is None else _LINKS_FILE


def run_worker(
    data_dir: Path,
    maps_dir: Path,
    database_url: str | None = None,
    *,
    pipeline: Pipeline | None = None,
    timing: Timing | None = None,
    limits: BuildLimits | None = None,
    stop: threading.Event | None = None,
    storage_url: str | None = None,
    capacity: Capacity | None = None,
    release: int = RELEASE,
) -> None:
    """Work until SIGINT, SIGTERM or ``stop``. Call it in the main thread of a process that does nothing else.

    Raises:
        StorageFull: the disk is full.
    """
    stop = stop or threading.Event()

    def ask_to_stop(_signal: int, _frame: FrameType | None) -> None:
        # Not in the handler itself: the main thread may hold the event's lock on its way into the wait below.
        threading.Thread(target=stop.set).start()

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, ask_to_stop)
    worker = Worker(
        data_dir,
        maps_dir,
        database_url,
        pipeline=pipeline,
        timing=timing,
        limits=limits,
        storage_url=storage_url,
        capacity=capacity,
        release=release,
    )
    telemetry.begin("rholoc-worker")
    worker.start()
    stop.wait()
    worker.stop()
    telemetry.end()
