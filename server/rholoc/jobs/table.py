"""The database table of jobs, as users see and change it. Workers change it by :mod:`rholoc.jobs.leases`."""

import time
import uuid
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import sqlalchemy as sa

from rholoc.errors import Conflict, UnknownJob
from rholoc.jobs.job import Job, JobKind, JobOptions, JobPriority, JobState
from rholoc.jobs.turns import changed_turn, turn_of
from rholoc.progress import Stage
from rholoc.reports import report_from_json
from rholoc.storage.database import change_rows, read_rows
from rholoc.storage.tables import jobs_table

_ID_LENGTH = 32


@dataclass(frozen=True)
class JobWork:
    """Input of a job for its worker."""

    recording: str
    map_name: str
    options: JobOptions
    asked_in: str | None = None  # the trace of the request, as a W3C traceparent


class JobTable:
    """The table of jobs."""

    def __init__(self, engine: sa.Engine) -> None:
        self._engine = engine

    def get(self, job_id: str) -> Job:
        """The job. Raises UnknownJob."""
        job = self._first(sa.select(jobs_table).where(jobs_table.c.id == job_id))
        if job is None:
            raise _unknown(job_id)
        return job

    def list(self, most: int | None = None, before: str | None = None) -> list[Job]:
        """At most ``most`` jobs, the newest first, older than the job ``before`` if given. Raises UnknownJob."""
        wanted = sa.select(jobs_table).order_by(jobs_table.c.created.desc(), jobs_table.c.id.desc()).limit(most)
        if before is not None:
            job = self.get(before)
            wanted = wanted.where(sa.tuple_(jobs_table.c.created, jobs_table.c.id) < (job.created, job.id))
        return [_job(row) for row in read_rows(self._engine, wanted)]

    def counts(self) -> dict[JobState, int]:
        """Number of jobs in each state."""
        wanted = sa.select(jobs_table.c.state, sa.func.count().label("number")).group_by(jobs_table.c.state)
        counted = {row["state"]: row["number"] for row in read_rows(self._engine, wanted)}
        return {state: counted.get(state, 0) for state in JobState}

    def queued(self) -> Sequence[Job]:
        """The queued jobs, unordered."""
        wanted = sa.select(jobs_table).where(jobs_table.c.state == JobState.QUEUED)
        return [_job(row) for row in read_rows(self._engine, wanted)]

    def unfinished(self) -> dict[str, str]:
        """Job id → map name of the queued and running jobs."""
        wanted = sa.select(jobs_table.c.id, jobs_table.c.map_name).where(UNFINISHED)
        return {row["id"]: row["map_name"] for row in read_rows(self._engine, wanted)}

    def needs(self, recording_id: str) -> bool:
        """Whether a job that is queued or running reads the recording."""
        wanted = sa.select(jobs_table.c.id).where(jobs_table.c.recording == recording_id, UNFINISHED)
        return bool(read_rows(self._engine, wanted))

    def learning(self, map_name: str) -> Job | None:
        """The queued or running job by which a map learns from its queries; None if there is none."""
        return self._first(sa.select(jobs_table).where(_learns(map_name), UNFINISHED))

    def placing(self, site: str) -> Job | None:
        """The queued or running job by which the maps of a site are placed; None if there is none."""
        of_site = jobs_table.c.options["site"].as_string() == site
        return self._first(sa.select(jobs_table).where(of_site, _kind_of_row == JobKind.PLACE, UNFINISHED))

    def last_learning(self, map_name: str) -> Job | None:
        """The last ended of the published or failed jobs by which a map learns from its queries; None without any."""
        ended = jobs_table.c.state.in_([JobState.PUBLISHED, JobState.FAILED])
        wanted = sa.select(jobs_table).where(_learns(map_name), ended).order_by(jobs_table.c.ended.desc())
        return self._first(wanted)

    def mapped_before(self, time_s: float) -> Sequence[str]:
        """Ids of recordings whose jobs all published their maps before ``time_s`` [s since the epoch]."""
        published_before = sa.and_(jobs_table.c.state == JobState.PUBLISHED, jobs_table.c.ended < time_s)
        others = sa.func.sum(sa.case((published_before, 0), else_=1))
        recordings = sa.select(jobs_table.c.recording).where(jobs_table.c.recording != "")
        wanted = recordings.group_by(jobs_table.c.recording).having(others == 0)
        return [row["recording"] for row in read_rows(self._engine, wanted)]

    def _first(self, wanted: sa.Select[Any]) -> Job | None:
        """The first job that a query finds; None if it finds none."""
        rows = read_rows(self._engine, wanted.limit(1))
        return _job(rows[0]) if rows else None

    def insert(self, job_id: str, work: JobWork, length_s: float, memory_bytes: int | None) -> None:
        """Add a queued job. Raises IntegrityError: there is one of this id.

        Args:
            job_id: 32 hex digits.
            work: the job's input.
            length_s: estimated length of the walk.
            memory_bytes: estimated memory; None if not known yet.
        """
        now = time.time()
        values = {
            "id": job_id,
            "recording": work.recording,
            "map_name": work.map_name,
            "options": asdict(work.options),
            "asked_in": work.asked_in,
            "created": now,
            "run": _new_run(job_id),
            "turn": turn_of(now, work.options.priority, length_s),
            "memory_bytes": memory_bytes,
        }
        change_rows(self._engine, jobs_table.insert().values(**values, **_QUEUED))

    def requeue(self, job_id: str, length_s: float, asked_in: str | None = None) -> None:
        """Queue a failed or cancelled job again: its turn is as if submitted now with a walk of ``length_s`` [s];
        its time of creation and its memory stay. Raises UnknownJob; Conflict for another state.
        """
        turn = turn_of(time.time(), self.get(job_id).priority, length_s)
        values = {"run": _new_run(job_id), "turn": turn, "asked_in": asked_in, **_QUEUED}
        ended = jobs_table.c.state.in_([JobState.FAILED, JobState.CANCELLED])
        update = jobs_table.update().where(jobs_table.c.id == job_id, ended)
        if not change_rows(self._engine, update.values(**values)):
            raise Conflict("Only a job that failed or was cancelled can be retried.", "Submit a new one.")

    def prioritize(self, job_id: str, priority: JobPriority) -> None:
        """Change the priority, and so the turn, of a queued job. Raises UnknownJob; Conflict if it is not queued."""
        with self._engine.begin() as connection:
            row = connection.execute(sa.select(jobs_table).where(jobs_table.c.id == job_id)).mappings().first()
            if row is None:
                raise _unknown(job_id)
            turn = changed_turn(row["turn"], row["options"]["priority"], priority)
            changed = connection.execute(
                jobs_table.update()
                .where(jobs_table.c.id == job_id, jobs_table.c.state == JobState.QUEUED)
                .values(options={**row["options"], "priority": priority}, turn=turn)
            )
        if not changed.rowcount:
            raise Conflict("The job no longer waits for a worker.", "Only a queued job's priority can be changed.")

    def cancel(self, job_id: str) -> None:
        """Set a queued or running job to cancelled. Raises Conflict if it has ended, is unknown or being published."""
        update = jobs_table.update().where(jobs_table.c.id == job_id, UNFINISHED, jobs_table.c.stage != Stage.PUBLISHED)
        values = {"state": JobState.CANCELLED, "message": "cancelled", "ended": time.time(), "worker": None}
        if not change_rows(self._engine, update.values(**values)):
            raise Conflict("The job has ended, or its map is being published.", "Retry it, or submit a new one.")

    def delete(self, job_id: str) -> None:
        """Remove a job that has ended. Raises Conflict if it has not, or is unknown."""
        ended = [state for state in JobState if state.ended]
        delete = jobs_table.delete().where(jobs_table.c.id == job_id, jobs_table.c.state.in_(ended))
        if not change_rows(self._engine, delete):
            raise Conflict("The job has not ended.", "Cancel it first.")


_QUEUED: dict[str, object] = {
    "state": JobState.QUEUED,
    "stage": Stage.RECEIVED,
    "progress": 0.0,
    "message": "waiting for a worker",
    "log": [],
    "warnings": [],
    "error_code": None,
    "error_message": None,
    "error_hint": None,
    "started": None,
    "ended": None,
    "attempts": 0,
    "deaths": 0,
    "worker": None,
}
UNFINISHED = jobs_table.c.state.in_([JobState.QUEUED, JobState.RUNNING])
"""Condition on the table of jobs: queued or running."""
_kind_of_row = jobs_table.c.options["kind"].as_string()


def _learns(map_name: str) -> sa.ColumnElement[bool]:
    """Condition on the table of jobs: a job by which the map learns from its queries."""
    return sa.and_(jobs_table.c.map_name == map_name, _kind_of_row == JobKind.LEARN)


def _new_run(job_id: str) -> str:
    """New id of a run of a job, so that a retry does not find the previous run's files."""
    return f"{job_id}-{uuid.uuid4().hex[:8]}"


def _unknown(job_id: str) -> UnknownJob:
    """Error for an id that no job has."""
    return UnknownJob(f"There is no job {job_id[:_ID_LENGTH]!r}.", "List the jobs to see their ids.")


def _job(row: sa.RowMapping) -> Job:
    """The job in a row of the table."""
    options = row["options"]
    return report_from_json(Job, {**row, **{name: options[name] for name in ("kind", "priority", "site")}})
