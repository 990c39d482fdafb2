"""The queue of mapping jobs, for the server and the command. Workers run the jobs."""

import time
import uuid
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import sqlalchemy as sa
from sqlalchemy.exc import IntegrityError, SQLAlchemyError

from rholoc import telemetry
from rholoc.errors import Conflict, RholocError, UnknownRecording
from rholoc.jobs.job import (
    SECONDS_PER_PICTURE,
    Job,
    JobKind,
    JobOptions,
    JobPriority,
    JobState,
    Obstacle,
    memory_for_walk,
)
from rholoc.jobs.leases import Leases, shortened
from rholoc.jobs.table import JobTable, JobWork
from rholoc.jobs.workers_table import WorkerOffer, WorkerTable, process_name
from rholoc.library.recording_notes import read_notes
from rholoc.library.recordings import RecordingStore
from rholoc.maps import check_map_name
from rholoc.storage.database import check_database, reporting_full_database

_BYTES_PER_SECOND = 1e6  # of a recording that no job has read yet


class JobQueue:
    """The queue of mapping jobs. It connects to the database on first use.

    Args:
        recordings: the jobs' recordings; their database is used.
    """

    def __init__(self, recordings: RecordingStore) -> None:
        self._recordings, self._engine = recordings, recordings.engine
        self._jobs, self._workers = JobTable(self._engine), WorkerTable(self._engine)
        self._starter = process_name()
        self._trouble: str | None = None

    def check(self) -> None:
        """Connect to the database once. Raises as :func:`rholoc.storage.database.check_database`."""
        check_database(self._engine)

    def submit(
        self, recording_id: str, map_name: str, options: JobOptions | None = None, job_id: str | None = None
    ) -> Job:
        """Queue a job that makes a map: by building, updating or learning, as ``options.kind`` says.

        Args:
            recording_id: of the recording; empty if the job needs none.
            map_name: name to publish the map under.
            options: of the job; None for the defaults.
            job_id: 32 hex digits, or None for a new id. Submitting the same id again changes nothing.

        Raises:
            UnknownRecording: there is no such recording.
            InvalidName: ``map_name`` is not a valid map name.
            StorageFull: the disk is full.
        """
        check_map_name(map_name)
        options = options or JobOptions()
        return self._insert(recording_id if options.kind.reads_recording else "", map_name, options, job_id)

    def submit_placing(self, site: str) -> Job:
        """Queue the search for links between the maps of a site.

        Raises:
            Conflict: one is queued or running.
            StorageFull: the disk is full.
        """
        if (unfinished := self._jobs.placing(site)) is not None:
            raise Conflict(
                f"The maps of the site {site} are being placed already.", f"Wait for the job {unfinished.id}."
            )
        return self._insert("", "", JobOptions(kind=JobKind.PLACE, site=site))

    def _insert(self, recording_id: str, map_name: str, options: JobOptions, job_id: str | None = None) -> Job:
        """Queue a job; a job that has the id already stays as it is."""
        work = JobWork(recording_id, map_name, options, telemetry.traceparent())
        length_s, memory_bytes = self._size_of(recording_id)
        if options.frames is not None:
            memory_bytes = None
        job_id = job_id or uuid.uuid4().hex
        with reporting_full_database(), suppress(IntegrityError):
            self._jobs.insert(job_id, work, length_s, memory_bytes)
        return self.get(job_id)

    def get(self, job_id: str) -> Job:
        """The job; a queued one with its obstacle.

        Raises:
            UnknownJob: no job has this id.
        """
        return self._explained([self._jobs.get(job_id)])[0]

    def list(self, most: int | None = None, before: str | None = None) -> list[Job]:
        """Jobs, the newest first.

        Args:
            most: how many at most; None: all.
            before: only those older than the job with this id.

        Raises:
            UnknownJob: there is no job ``before``.
        """
        return [*self._explained(self._jobs.list(most, before))]

    def learning(self, map_name: str) -> Job | None:
        """The queued or running job by which a map learns from its queries, or None."""
        return self._jobs.learning(map_name)

    def last_learning(self, map_name: str) -> Job | None:
        """The last published or failed job by which a map learns from its queries, or None."""
        return self._jobs.last_learning(map_name)

    def unfinished(self) -> dict[str, str]:
        """Job id → map name of the queued and running jobs."""
        return self._jobs.unfinished()

    def counts(self) -> dict[JobState, int]:
        """Number of jobs in each state."""
        return self._jobs.counts()

    def waiting(self) -> dict[Obstacle | None, int]:
        """Number of queued jobs by obstacle; None stands for jobs that only wait for their turn."""
        counted = Counter(job.obstacle for job in self._explained(self._jobs.queued()))
        return {obstacle: counted[obstacle] for obstacle in (None, *Obstacle)}

    def cancel(self, job_id: str) -> Job:
        """Cancel a queued or running job. Its worker stops within two seconds.

        Raises:
            UnknownJob: no job has this id.
            Conflict: it has ended, or its map is being published.
        """
        self._jobs.get(job_id)
        with reporting_full_database():
            self._jobs.cancel(job_id)  # its worker notices and stops
        return self._jobs.get(job_id)

    def delete(self, job_id: str) -> Job:
        """Remove a job that has ended; returns it as it was. Its recording and its map stay.

        Raises:
            UnknownJob: no job has this id.
            Conflict: it has not ended.
        """
        job = self._jobs.get(job_id)
        with reporting_full_database():
            self._jobs.delete(job_id)
        return job

    def retry(self, job_id: str) -> Job:
        """Queue a failed or cancelled job again, from its start.

        Raises:
            UnknownJob: no job has this id.
            Conflict: it neither failed nor was cancelled.
            UnknownRecording: its recording was deleted.
        """
        job = self._jobs.get(job_id)
        length_s, _ = self._size_of(job.recording)
        with reporting_full_database():
            self._jobs.requeue(job_id, length_s, telemetry.traceparent())
        return self.get(job_id)

    def prioritize(self, job_id: str, priority: JobPriority) -> Job:
        """Change the priority of a queued job.

        Raises:
            UnknownJob: no job has this id.
            Conflict: it is not queued.
        """
        with reporting_full_database():
            self._jobs.prioritize(job_id, priority)
        return self.get(job_id)

    def delete_recording(self, recording_id: str) -> None:
        """Delete a stored recording that no job needs.

        Raises:
            UnknownRecording: no recording has this id.
            Conflict: a job is waiting for it or working on it.
        """
        self._recordings.get(recording_id)
        if self._jobs.needs(recording_id):
            raise Conflict("A job is using the recording.", "Cancel the job, or wait until it has ended.")
        self._recordings.delete(recording_id)

    def delete_mapped_recordings(self, retention_s: float) -> None:
        """Delete each recording whose jobs all published their maps more than ``retention_s`` ago.

        A recording with a failed, cancelled or unfinished job is kept.
        """
        for recording_id in self._jobs.mapped_before(time.time() - retention_s):
            with suppress(UnknownRecording):  # it was deleted before
                self._recordings.delete(recording_id)

    @property
    def engine(self) -> sa.Engine:
        """The database engine."""
        return self._engine

    def has_worker(self) -> bool:
        """Whether any worker's last heartbeat is younger than 15 s."""
        return bool(self._workers.living())

    def requeue_jobs_of(self, pid: int, error: str) -> None:
        """Requeue the jobs of the workers of a process of this machine that has died, and forget the workers.

        Args:
            pid: its process id.
            error: how it died, in a line.
        """
        name = process_name(pid)
        self._workers.remove_all(name)
        leases = Leases(self._engine)
        for lease in leases.held_at(name):
            leases.lose(lease, f"its worker died ({error})")

    def report_worker(self, trouble: str | None) -> None:
        """Record why workers started by this process die; None if they do not."""
        self._trouble = trouble
        with suppress(SQLAlchemyError, RholocError):  # then only this process knows
            if trouble is None:
                self._workers.remove(self._starter)
            else:
                self._workers.report(self._starter, shortened(trouble))

    def worker_trouble(self) -> str | None:
        """Reason why workers die when started, of this process or reported within ten minutes; None without one."""
        return self._trouble or self._workers.error()

    def close(self) -> None:
        """Close the connections."""
        self._engine.dispose()

    def _size_of(self, recording_id: str) -> tuple[float, int | None]:
        """Estimated length of a recording's walk [s], and memory [bytes] of its job; None until a job has read it.
        Length 0 for a job without a recording. Raises UnknownRecording: there is no such recording.
        """
        if not recording_id:
            return 0.0, memory_for_walk(0.0, 0)
        length_s = self._recordings.get(recording_id).size_bytes / _BYTES_PER_SECOND
        notes = read_notes(self._recordings.notes(recording_id))
        if notes is None:
            return length_s, None
        length_s = notes.frames * SECONDS_PER_PICTURE if notes.length_s is None else notes.length_s
        return length_s, memory_for_walk(length_s, notes.width * notes.height)

    def _explained(self, jobs: Sequence[Job]) -> Sequence[Job]:
        """The jobs, queued ones with their obstacle and a message about it."""
        if not any(job.state is JobState.QUEUED for job in jobs):
            return jobs
        workers = self._workers.living()
        trouble = None if workers else self.worker_trouble()
        return [_explained(job, workers, trouble) if job.state is JobState.QUEUED else job for job in jobs]


def _explained(job: Job, workers: Sequence[WorkerOffer], trouble: str | None) -> Job:
    """A queued job with its obstacle: ``trouble`` if given, no workers, or too little memory; unchanged without one."""
    if trouble is not None:
        return replace(job, obstacle=Obstacle.WORKER_FAILS, message=f"waiting for a worker: {trouble}")
    if not workers:
        return replace(job, obstacle=Obstacle.NO_WORKER, message="waiting for a worker: none is running")
    most_bytes = max(worker.memory_bytes for worker in workers)
    if job.memory_bytes is None or job.memory_bytes <= most_bytes:
        return job
    needed, most = (f"{memory / 2**30:.1f} GiB" for memory in (job.memory_bytes, most_bytes))
    message = f"waiting for a worker with {needed} of memory for it: none has more than {most}"
    return replace(job, obstacle=Obstacle.MEMORY, message=message)
