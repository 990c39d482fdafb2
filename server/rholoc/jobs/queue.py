"""The queue of mapping jobs, for the server and the command. It runs no jobs itself."""

from __future__ import annotations

import time
import uuid
from contextlib import suppress
from pathlib import Path

import sqlalchemy as sa
from dbos import DBOSClient, EnqueueOptions
from sqlalchemy.exc import IntegrityError

from rholoc.errors import Conflict, UnknownRecording
from rholoc.jobs.job import Job, JobKind, JobOptions, JobState
from rholoc.jobs.recording_store import RecordingStore
from rholoc.jobs.table import JobTable, JobWork, WorkerTable
from rholoc.maps import check_map_name
from rholoc.storage.database import open_database, reporting_full_database

APPLICATION = "rholoc"
QUEUE_NAME = "rholoc-mapping"
WORKFLOW_NAME = "rholoc-map-recording"

# Pinned, so that a new release continues the jobs of the one before. Change it only if the workflow's steps change so
# much that a half-done job cannot be continued.
APPLICATION_VERSION = "1"


class JobQueue:
    """The queue of mapping jobs."""

    def __init__(
        self, data_dir: Path, database_url: str | None = None, recordings: RecordingStore | None = None
    ) -> None:
        """Open the queue, and create its tables where they are missing.

        Args:
            data_dir: where the SQLite file is kept, and the recordings.
            database_url: ``postgresql://…``, or None for the SQLite file.
            recordings: those that jobs are about, where they are kept elsewhere.

        Raises:
            StorageFull: the disk is full.
        """
        self._recordings = recordings or RecordingStore(data_dir)
        self._engine = open_database(data_dir, database_url)
        self._client = open_client(self._engine)
        self._jobs = JobTable(self._engine)

    def submit(
        self, recording_id: str, map_name: str, options: JobOptions | None = None, job_id: str | None = None
    ) -> Job:
        """Queue the building of a map.

        Args:
            recording_id: what to build it from; empty where the job needs no recording.
            map_name: under which name to publish it.
            options: how to build it.
            job_id: 32 hex digits, or None for a new id. Submitting again under the same id changes nothing, so it is
                safe to repeat.

        Raises:
            UnknownRecording: there is no such recording.
            InvalidName: ``map_name`` is not a valid map name.
            StorageFull: the disk is full.
        """
        check_map_name(map_name)
        options = options or JobOptions()
        if options.kind is not JobKind.LEARN:
            self._recordings.get(recording_id)
        job_id = job_id or uuid.uuid4().hex
        workflow = _workflow_id(job_id)
        work = JobWork(recording_id, map_name, options)
        with reporting_full_database(), suppress(IntegrityError), self._engine.begin() as connection:
            self._jobs.insert(connection, job_id, work, workflow)
            self._enqueue(connection, job_id, workflow)
        return self._jobs.get(job_id)

    def get(self, job_id: str) -> Job:
        """The job.

        Raises:
            UnknownJob: no job has this id.
        """
        return self._jobs.get(job_id)

    def list(self, most: int | None = None, before: str | None = None) -> list[Job]:
        """Jobs, the newest first.

        Args:
            most: how many at most; None: all.
            before: only those older than the job with this id.

        Raises:
            UnknownJob: there is no job ``before``.
        """
        return self._jobs.list(most, before)

    def learning(self, map_name: str) -> Job | None:
        """The job by which the map of a name learns from its queries, if one is queued or running."""
        return self._jobs.learning(map_name)

    def last_learning(self, map_name: str) -> Job | None:
        """The job by which the map of a name last learned from its queries, or could not; None where there is none."""
        return self._jobs.last_learning(map_name)

    def counts(self) -> dict[JobState, int]:
        """How many jobs are in each state."""
        return self._jobs.counts()

    def cancel(self, job_id: str) -> Job:
        """End a queued or running job. A worker that has it stops within two seconds.

        Raises:
            UnknownJob: no job has this id.
            Conflict: it has ended.
        """
        self._jobs.get(job_id)
        with reporting_full_database():
            # DBOS need not know: a worker that has or takes the job sees that it was cancelled, and ends its workflow.
            self._jobs.cancel(job_id)
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
        if job.recording:
            self._recordings.get(job.recording)
        workflow = _workflow_id(job_id)
        with reporting_full_database(), self._engine.begin() as connection:
            self._jobs.requeue(connection, job_id, workflow)
            self._enqueue(connection, job_id, workflow)
        return self._jobs.get(job_id)

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
        """Delete the recordings whose maps were published more than ``retention_s`` ago.

        Recordings that a later job failed on, or still needs, are kept.
        """
        for recording_id in self._jobs.mapped_before(time.time() - retention_s):
            with suppress(UnknownRecording):  # it was deleted before
                self._recordings.delete(recording_id)

    def has_worker(self) -> bool:
        """Whether a worker is alive, here or elsewhere, by its last heartbeat."""
        return WorkerTable(self._engine).any_alive()

    def close(self) -> None:
        """Close the connections."""
        self._client.destroy()
        self._engine.dispose()

    def _enqueue(self, connection: sa.Connection, job_id: str, workflow: str) -> None:
        options: EnqueueOptions = {
            "workflow_name": WORKFLOW_NAME,
            "queue_name": QUEUE_NAME,
            "workflow_id": workflow,
            "app_version": APPLICATION_VERSION,
        }
        self._client.enqueue_in_transaction(connection, options, job_id)


def open_client(engine: sa.Engine) -> DBOSClient:
    """A client of DBOS, for use outside its workflows, on our own connections."""
    return DBOSClient(system_database_engine=engine, application_name=APPLICATION)


def _workflow_id(job_id: str) -> str:
    """A new workflow for the job: a retry must not find the steps of the run before."""
    return f"{job_id}-{uuid.uuid4().hex[:8]}"
