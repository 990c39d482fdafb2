"""Runs one job: builds its map in a process of its own, publishes the map, and records how the job ended."""

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import sqlalchemy as sa
from sqlalchemy.exc import SQLAlchemyError

from rholoc import telemetry
from rholoc.disk import is_full, storage_full
from rholoc.errors import Cancelled, RholocError, StorageUnavailable
from rholoc.jobs.job import MoreMemoryNeeded
from rholoc.jobs.leases import Claim, Failure, Lease, Leases
from rholoc.jobs.table import JobWork
from rholoc.jobs.workers_table import WorkerTable
from rholoc.maps import Map
from rholoc.progress import Stage
from rholoc.worker.build_process import KilledForMemory, build_in_process, describe, unexpected
from rholoc.worker.heartbeat import Timing
from rholoc.worker.job_folders import JobFolders
from rholoc.worker.pipeline import MappingTask, Pipeline, doubts
from rholoc.worker.running_jobs import RunningJobs
from rholoc.worker.setup import BuildLimits
from rholoc.worker.site_placing import store_links

_log = logging.getLogger("rholoc.worker")

_MAX_DEATHS = 5
_STORAGE_PATIENCE_S, _STORAGE_AGAIN_S = 600.0, 2.0
_T = TypeVar("_T")


class StageSpans:
    """Trace spans of a build's stages. A stage ends when the next one begins."""

    def __init__(self) -> None:
        self._stage: Stage | None = None
        self._begun_s = 0.0

    def note(self, stage: Stage) -> None:
        """Record that the build is in a stage. May be called repeatedly during the stage."""
        if stage is not self._stage:
            self.end()
            self._stage, self._begun_s = stage, time.perf_counter()

    def end(self) -> None:
        """Record the end of the last stage."""
        if self._stage is not None:
            telemetry.note(str(self._stage), time.perf_counter() - self._begun_s)
        self._stage = None


class JobRunner:
    """Runs the jobs of one worker, each in the calling thread.

    Both steps may be repeated by the next worker: a build whose file exists is not done again, and a map is published
    only under a valid lease.

    Args:
        leases: on the jobs of the queue.
        workers: the table of workers.
        folders: where inputs and built files are.
        pipeline: how maps are built and published.
        running: jobs of this worker.
        limits: limits of one build.
        timing: how quickly a cancellation is noticed.
        stopping: set when the worker stops.
    """

    def __init__(
        self,
        leases: Leases,
        workers: WorkerTable,
        folders: JobFolders,
        pipeline: Pipeline,
        running: RunningJobs,
        limits: BuildLimits,
        timing: Timing,
        stopping: threading.Event,
    ) -> None:
        self._leases, self._workers = leases, workers
        self._folders, self._pipeline = folders, pipeline
        self._running, self._limits, self._timing, self._stopping = running, limits, timing, stopping

    def run(self, claim: Claim) -> None:
        """Build and publish. Returns when the job has ended, was given to another worker, or this worker has lost it.

        Raises:
            SQLAlchemyError: the end could not be recorded. The next worker continues.
        """
        lease, work = claim.lease, claim.work
        about: dict[str, telemetry.Value] = {
            "rholoc.job": lease.job,
            "rholoc.map": work.map_name,
            "rholoc.attempt": lease.attempt,
        }
        try:
            with telemetry.job_span(f"job {work.options.kind}", about, work.asked_in) as marks:
                self._record(claim, self._outcome(claim), marks)
        except Cancelled:
            _log.info("job %s left: cancelled, or given to another worker", lease.job)
            self._folders.clear(self._leases.unfinished_runs)

    def _outcome(self, claim: Claim) -> tuple[str, ...] | Failure | MoreMemoryNeeded:
        """Build and publish. Returns reasons not to trust the map, or why there is none. After five dead workers the
        job fails. Raises Cancelled if this worker has lost the job, SQLAlchemyError if the database does not answer.
        """
        if claim.deaths >= _MAX_DEATHS:
            return Failure(
                "internal",
                f"{_MAX_DEATHS} workers died while they worked on this job.",
                "It may need more memory than they have. Give them more and retry, or record a shorter walk.",
            )
        try:
            return self._build(claim.lease, claim.work) or self._publish(claim.lease, claim.work)
        except Cancelled:
            raise
        except RholocError as error:
            return describe(error)
        except OSError as error:
            return describe(storage_full()) if is_full(error) else unexpected(error)
        except SQLAlchemyError:
            raise
        except Exception as error:
            return unexpected(error)

    def _record(
        self, claim: Claim, outcome: tuple[str, ...] | Failure | MoreMemoryNeeded, marks: telemetry.Marks
    ) -> None:
        """Record a job's end, or hand it on; after a publication draw the room. Removes the run's folder."""
        lease = claim.lease
        if isinstance(outcome, MoreMemoryNeeded):
            _log.info("job %s is handed on: it needs %.1f GiB of memory", lease.job, outcome.memory_bytes / 2**30)
            ended = self._leases.hand_on(lease, outcome.memory_bytes)
        elif isinstance(outcome, Failure):
            _log.warning("job %s failed: %s", lease.job, outcome.message)
            marks.fail(outcome.message)
            ended = self._leases.fail(lease, outcome)
        else:
            ended = self._leases.publish(lease, outcome)
        if ended:  # otherwise another worker has the job and needs the built map
            if isinstance(outcome, tuple):
                self._furnish(claim)
            self._folders.remove(lease)

    def _build(self, lease: Lease, work: JobWork) -> Failure | MoreMemoryNeeded | None:
        """Build in a child process unless the file exists; store notes on the recording. Returns why nothing was built,
        or None. A build killed for its memory needs more if some worker has more. Raises Cancelled.
        """
        if self._folders.built_file(lease, work).exists():
            return None
        stages = StageSpans()

        def note(stage: Stage, fraction: float, message: str = "") -> None:
            stages.note(stage)
            self._note(lease, stage, fraction, message)

        try:
            with telemetry.span("inputs"):
                task = self._task(lease, work)
            granted_bytes = self._running.free_bytes(lease)
            stopped = build_in_process(
                self._pipeline,
                task,
                note=note,
                check=lambda: self._check_held(lease),
                poll_s=self._timing.poll_s,
                cancel_grace_s=self._timing.cancel_grace_s,
                limits=replace(self._limits, memory_bytes=granted_bytes),
            )
        finally:
            stages.end()
        self._folders.store_notes(lease, work)
        if isinstance(stopped, KilledForMemory):
            more = MoreMemoryNeeded.after(stopped.held_bytes, granted_bytes, self._most_offered_bytes())
            return more or stopped.failure
        return stopped

    def _most_offered_bytes(self) -> float:
        """Memory for one job on the largest living worker [bytes]."""
        living = self._workers.living(self._timing.dead_after_s)
        return max((worker.memory_bytes for worker in living), default=self._running.offered_bytes)

    def _publish(self, lease: Lease, work: JobWork) -> tuple[str, ...]:
        """Publish the built file. Returns reasons not to trust it. Raises Cancelled (a lost lease), RholocError."""
        if not self._leases.begin_publishing(lease):
            raise Cancelled("This worker no longer has the job.")
        task = self._task(lease, work)
        with telemetry.span("publish"):
            reasons = self._patiently(lease, lambda: self._put(lease, work, task))
        return reasons

    def _furnish(self, claim: Claim) -> None:
        """Let the pipeline draw the room of a published map if the job read a recording; failures are logged. Removes
        local copies of the recording.
        """
        lease, work = claim.lease, claim.work
        if work.options.kind.reads_recording:
            limits = replace(self._limits, memory_bytes=self._running.free_bytes(lease))
            try:
                self._pipeline.furnish(self._task(lease, work), self._folders.maps(), self._check_going_on, limits)
            except Cancelled:
                _log.info("the room of %s was not drawn: the worker stops", work.map_name)
            except Exception:
                _log.warning("the room of %s could not be drawn", work.map_name, exc_info=True)
        self._folders.release(work)

    def _check_going_on(self) -> None:
        """Raise Cancelled if the worker stops."""
        if self._stopping.is_set():
            raise Cancelled("The worker stops.")

    def _put(self, lease: Lease, work: JobWork, task: MappingTask) -> tuple[str, ...]:
        """Publish the built map or links. Returns reasons not to trust them. Raises Cancelled if the lease was lost."""

        def note(connection: sa.Connection, map_: Map) -> None:
            if not self._leases.publish(lease, doubts(map_), connection):
                raise Cancelled("This worker no longer has the job.")

        library = self._folders.library(note)
        if work.options.site is None:
            return self._pipeline.publish(task, library)
        return store_links(task.built_file, work.options.site, self._folders.sites(), library)

    def _task(self, lease: Lease, work: JobWork) -> MappingTask:
        """The job's task; waits for the storage. Raises the errors of :meth:`JobFolders.task`, and Cancelled."""
        memory_bytes = self._running.granted_bytes(lease)
        return self._patiently(lease, lambda: self._folders.task(lease, work, memory_bytes))

    def _patiently(self, lease: Lease, act: Callable[[], _T]) -> _T:
        """Call ``act``, again and again for ten minutes while the storage does not answer.

        Raises:
            Cancelled: this worker no longer has the job.
            StorageUnavailable: the storage has not answered for that time, or until this worker stops.
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

    def _note(self, lease: Lease, stage: Stage, fraction: float, message: str = "") -> None:
        """Record progress; errors of the database are logged."""
        try:
            self._leases.note(lease, stage, fraction, message)
        except SQLAlchemyError:
            _log.exception("progress of job %s could not be noted", lease.job)

    def _check_held(self, lease: Lease) -> None:
        """Raise Cancelled if this worker no longer has the job; not if the database does not say."""
        try:
            held = self._leases.holds(lease)
        except SQLAlchemyError:
            _log.exception("job %s could not be looked up", lease.job)
            return
        if not held:
            raise Cancelled("The job was cancelled, or another worker has it.")
