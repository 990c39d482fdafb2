"""The database rows of jobs and workers, and who may change them."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass
from typing import Any

import sqlalchemy as sa

from rholoc.errors import Conflict, UnknownJob
from rholoc.jobs.job import Job, JobOptions, JobState
from rholoc.progress import Stage
from rholoc.storage.tables import jobs_table, workers_table

LOG_LINES = 50
MAX_LINE_LENGTH = 500  # characters of a job's messages
MAX_WARNINGS = 20
DEAD_AFTER_S = 15.0  # since the last heartbeat
_ID_LENGTH = 32

# Roughly what share of a job's time each stage takes.
_SHARES = {
    Stage.RECEIVED: 0.0,
    Stage.READ: 0.05,
    Stage.KEYFRAMES: 0.05,
    Stage.FEATURES: 0.15,
    Stage.POSES: 0.40,
    Stage.OBSERVATIONS: 0.10,
    Stage.DENSITIES: 0.05,
    Stage.REPORT: 0.20,
    Stage.PUBLISHED: 0.0,
}


@dataclass(frozen=True)
class Failure:
    """Why a job failed, for its user."""

    code: str
    message: str
    hint: str


@dataclass(frozen=True)
class Lease:
    """A worker's hold on a job. It is lost when the job is cancelled, retried, or taken up by another worker."""

    job: str
    workflow: str
    attempt: int


@dataclass(frozen=True)
class JobWork:
    """What a worker needs to know about a job."""

    recording: str
    map_name: str
    options: JobOptions


class JobTable:
    """The table of jobs."""

    def __init__(self, engine: sa.Engine) -> None:
        self._engine = engine

    def get(self, job_id: str) -> Job:
        """The job. Raises UnknownJob."""
        with self._engine.connect() as connection:
            row = connection.execute(sa.select(jobs_table).where(jobs_table.c.id == job_id)).mappings().first()
        if row is None:
            raise UnknownJob(f"There is no job {job_id[:_ID_LENGTH]!r}.", "List the jobs to see their ids.")
        return _job(row)

    def list(self, most: int | None = None, before: str | None = None) -> list[Job]:
        """The newest jobs, the newest first; ``before``: only those older than this job. Raises UnknownJob."""
        wanted = sa.select(jobs_table).order_by(jobs_table.c.created.desc(), jobs_table.c.id.desc()).limit(most)
        if before is not None:
            job = self.get(before)
            wanted = wanted.where(sa.tuple_(jobs_table.c.created, jobs_table.c.id) < (job.created, job.id))
        with self._engine.connect() as connection:
            rows = connection.execute(wanted).mappings().all()
        return [_job(row) for row in rows]

    def counts(self) -> dict[JobState, int]:
        """How many jobs are in each state."""
        with self._engine.connect() as connection:
            found = sa.select(jobs_table.c.state, sa.func.count()).group_by(jobs_table.c.state)
            counted = {JobState(state): number for state, number in connection.execute(found)}
        return {state: counted.get(state, 0) for state in JobState}

    def needs(self, recording_id: str) -> bool:
        """Whether a job that is queued or running reads the recording."""
        with self._engine.connect() as connection:
            found = sa.select(jobs_table.c.id).where(
                jobs_table.c.recording == recording_id,
                jobs_table.c.state.in_([JobState.QUEUED, JobState.RUNNING]),
            )
            return connection.execute(found).first() is not None

    def learning(self, map_name: str) -> Job | None:
        """The queued or running job by which a map learns from its queries."""
        found = sa.select(jobs_table).where(
            jobs_table.c.map_name == map_name,
            jobs_table.c.recording == "",
            jobs_table.c.state.in_([JobState.QUEUED, JobState.RUNNING]),
        )
        with self._engine.connect() as connection:
            row = connection.execute(found).mappings().first()
        return None if row is None else _job(row)

    def last_learning(self, map_name: str) -> Job | None:
        """The published or failed job, of those by which a map learns from its queries, that ended last."""
        found = (
            sa.select(jobs_table)
            .where(
                jobs_table.c.map_name == map_name,
                jobs_table.c.recording == "",
                jobs_table.c.state.in_([JobState.PUBLISHED, JobState.FAILED]),
            )
            .order_by(jobs_table.c.ended.desc())
            .limit(1)
        )
        with self._engine.connect() as connection:
            row = connection.execute(found).mappings().first()
        return None if row is None else _job(row)

    def mapped_before(self, time_s: float) -> Sequence[str]:
        """The recordings all of whose jobs published their maps before ``time_s``, seconds since the epoch."""
        published_before = sa.and_(jobs_table.c.state == JobState.PUBLISHED, jobs_table.c.ended < time_s)
        others = sa.func.sum(sa.case((published_before, 0), else_=1))
        with self._engine.connect() as connection:
            recordings = sa.select(jobs_table.c.recording).where(jobs_table.c.recording != "")
            found = recordings.group_by(jobs_table.c.recording).having(others == 0)
            return connection.execute(found).scalars().all()

    # What users do

    def insert(self, connection: sa.Connection, job_id: str, work: JobWork, workflow: str) -> None:
        """Add a queued job, within the caller's transaction."""
        connection.execute(
            jobs_table.insert().values(
                id=job_id,
                recording=work.recording,
                map_name=work.map_name,
                options=asdict(work.options),
                created=time.time(),
                workflow_id=workflow,
                **_QUEUED,
            )
        )

    def requeue(self, connection: sa.Connection, job_id: str, workflow: str) -> None:
        """Queue a failed or cancelled job again, within the caller's transaction. Raises Conflict."""
        changed = connection.execute(
            jobs_table.update()
            .where(jobs_table.c.id == job_id, jobs_table.c.state.in_([JobState.FAILED, JobState.CANCELLED]))
            .values(workflow_id=workflow, **_QUEUED)
        )
        if not changed.rowcount:
            raise Conflict("Only a job that failed or was cancelled can be retried.", "Submit a new one.")

    def cancel(self, job_id: str) -> None:
        """End a queued or running job, unless its map is being published. Raises Conflict."""
        with self._engine.begin() as connection:
            changed = connection.execute(
                jobs_table.update()
                .where(
                    jobs_table.c.id == job_id,
                    jobs_table.c.state.in_([JobState.QUEUED, JobState.RUNNING]),
                    jobs_table.c.stage != Stage.PUBLISHED,
                )
                .values(state=JobState.CANCELLED, message="cancelled", ended=time.time())
            )
        if not changed.rowcount:
            raise Conflict("The job has ended, or its map is being published.", "Retry it, or submit a new one.")

    def delete(self, job_id: str) -> None:
        """Remove a job that has ended. Raises Conflict."""
        ended = [state for state in JobState if state.ended]
        with self._engine.begin() as connection:
            removed = connection.execute(
                jobs_table.delete().where(jobs_table.c.id == job_id, jobs_table.c.state.in_(ended))
            )
        if not removed.rowcount:
            raise Conflict("The job has not ended.", "Cancel it first.")

    # What workers do

    def take_up(self, job_id: str, workflow: str) -> tuple[Lease, JobWork] | None:
        """Take a lease on the job, unless it was cancelled or retried in the meantime. Any earlier lease is lost."""
        with self._engine.begin() as connection:
            taken = connection.execute(
                jobs_table.update()
                .where(
                    jobs_table.c.id == job_id,
                    jobs_table.c.workflow_id == workflow,
                    jobs_table.c.state.in_([JobState.QUEUED, JobState.RUNNING]),
                )
                .values(
                    state=JobState.RUNNING,
                    attempts=jobs_table.c.attempts + 1,
                    started=sa.func.coalesce(jobs_table.c.started, time.time()),
                )
            )
            if not taken.rowcount:
                return None
            row = connection.execute(sa.select(jobs_table).where(jobs_table.c.id == job_id)).mappings().one()
        work = JobWork(row["recording"], row["map_name"], JobOptions.from_json(row["options"]))
        return Lease(job_id, workflow, row["attempts"]), work

    def holds(self, lease: Lease) -> bool:
        """Whether the lease is still valid."""
        with self._engine.connect() as connection:
            return connection.execute(sa.select(jobs_table.c.id).where(*_held(lease))).first() is not None

    def note(self, lease: Lease, stage: Stage, fraction: float, message: str) -> None:
        """Record progress; a new stage or message is added to the log."""
        message = shortened(message)
        with self._engine.begin() as connection:
            row = connection.execute(sa.select(jobs_table).where(*_held(lease))).mappings().first()
            if row is None:
                return
            news = (stage, message) != (row["stage"], row["message"])
            connection.execute(
                jobs_table.update()
                .where(*_held(lease))
                .values(
                    stage=stage,
                    message=message,
                    progress=max(row["progress"], overall(stage, fraction)),
                    log=_appended(row["log"], f"{stage}: {message}" if message else stage) if news else row["log"],
                )
            )

    def wanted_workflows(self) -> set[str]:
        """The workflows of all jobs that are queued or running."""
        with self._engine.connect() as connection:
            return set(
                connection.execute(
                    sa.select(jobs_table.c.workflow_id).where(
                        jobs_table.c.state.in_([JobState.QUEUED, JobState.RUNNING])
                    )
                ).scalars()
            )

    def release(self, lease: Lease) -> None:
        """Give the job back to the queue."""
        self._update(lease, state=JobState.QUEUED, message="waiting for another worker")

    def begin_publishing(self, lease: Lease) -> bool:
        """From here on the job cannot be cancelled. False if the lease was lost before."""
        return self._update(lease, stage=Stage.PUBLISHED, message="publishing the map")

    def publish(self, lease: Lease, warnings: Sequence[str], connection: sa.Connection | None = None) -> bool:
        """Record that the job's map is published, and any reasons why it is not to be trusted.

        Args:
            lease: on the job.
            warnings: why.
            connection: whose transaction it is noted in; None for one of its own.

        Returns:
            Whether the lease was still valid, or this was recorded under it before; otherwise nothing is recorded.
        """
        kept = [shortened(warning) for warning in warnings[:MAX_WARNINGS]]
        lines = [*(f"warning: {warning}" for warning in kept), "published"]
        values = {"stage": Stage.PUBLISHED, "progress": 1.0, "warnings": kept}
        ended = self._end(lease, JobState.PUBLISHED, "published", lines, connection, **values)
        return ended or self._has_published(lease)

    def _has_published(self, lease: Lease) -> bool:
        found = sa.select(jobs_table.c.id).where(*_held(lease, JobState.PUBLISHED))
        with self._engine.connect() as connection:
            return connection.execute(found).first() is not None

    def fail(self, lease: Lease, failure: Failure) -> bool:
        """Record why the job failed. Returns as :meth:`publish` does."""
        message = shortened(failure.message)
        return self._end(
            lease,
            JobState.FAILED,
            message,
            [f"failed: {message}"],
            error_code=failure.code,
            error_message=message,
            error_hint=shortened(failure.hint),
        )

    def _end(
        self,
        lease: Lease,
        state: JobState,
        message: str,
        lines: Sequence[str],
        connection: sa.Connection | None = None,
        **values: Any,
    ) -> bool:
        with nullcontext(connection) if connection is not None else self._engine.begin() as within:
            log = within.execute(sa.select(jobs_table.c.log).where(*_held(lease))).scalar()
            if log is None:
                return False
            values |= {"state": state, "message": message, "log": _appended(log, *lines), "ended": time.time()}
            within.execute(jobs_table.update().where(*_held(lease)).values(**values))
            return True

    def _update(self, lease: Lease, **values: Any) -> bool:
        with self._engine.begin() as connection:
            return connection.execute(jobs_table.update().where(*_held(lease)).values(**values)).rowcount > 0


class WorkerTable:
    """The table of workers and their heartbeats."""

    def __init__(self, engine: sa.Engine) -> None:
        self._engine = engine

    def beat(self, worker: str) -> None:
        """Record that the worker is alive."""
        with self._engine.begin() as connection:
            changed = connection.execute(
                workers_table.update().where(workers_table.c.id == worker).values(heartbeat=time.time())
            )
            if not changed.rowcount:
                connection.execute(workers_table.insert().values(id=worker, heartbeat=time.time()))

    def remove(self, worker: str) -> None:
        """Forget the worker."""
        with self._engine.begin() as connection:
            connection.execute(workers_table.delete().where(workers_table.c.id == worker))

    def any_alive(self) -> bool:
        """Whether some worker's heartbeat is younger than :data:`DEAD_AFTER_S`."""
        lately = sa.select(workers_table.c.id).where(workers_table.c.heartbeat > time.time() - DEAD_AFTER_S)
        with self._engine.connect() as connection:
            return connection.execute(lately).first() is not None

    def living(self, dead_after_s: float) -> set[str]:
        """The workers whose heartbeat is younger than ``dead_after_s``; the others are forgotten."""
        oldest = time.time() - dead_after_s
        with self._engine.begin() as connection:
            connection.execute(workers_table.delete().where(workers_table.c.heartbeat < oldest))
            return set(connection.execute(sa.select(workers_table.c.id)).scalars())


def shortened(text: str) -> str:
    """A job's message, cut to the length that is kept and made well-formed UTF-8."""
    line = text if len(text) <= MAX_LINE_LENGTH else f"{text[: MAX_LINE_LENGTH - 1]}…"
    return line.encode("utf-8", "replace").decode()


def overall(stage: Stage, fraction: float) -> float:
    """The progress 0..1 over all stages, of ``fraction`` within ``stage``."""
    stages = list(_SHARES)
    before = sum(_SHARES[earlier] for earlier in stages[: stages.index(stage)])
    return min(1.0, before + _SHARES[stage] * min(1.0, max(0.0, fraction)))


_QUEUED: dict[str, Any] = {
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
}


def _held(lease: Lease, state: JobState = JobState.RUNNING) -> tuple[sa.ColumnElement[bool], ...]:
    return (
        jobs_table.c.id == lease.job,
        jobs_table.c.workflow_id == lease.workflow,
        jobs_table.c.attempts == lease.attempt,
        jobs_table.c.state == state,
    )


def _appended(log: list[str], *lines: str) -> list[str]:
    now = time.strftime("%H:%M:%S", time.gmtime())
    return [*log, *(f"{now} {line}" for line in lines)][-LOG_LINES:]


def _job(row: sa.RowMapping) -> Job:
    return Job(
        id=row["id"],
        recording=row["recording"],
        map_name=row["map_name"],
        state=JobState(row["state"]),
        stage=Stage(row["stage"]),
        progress=row["progress"],
        message=row["message"],
        log=tuple(row["log"]),
        warnings=tuple(row["warnings"] or ()),
        error_code=row["error_code"],
        error_message=row["error_message"],
        error_hint=row["error_hint"],
        created=row["created"],
        started=row["started"],
        ended=row["ended"],
        attempts=row["attempts"],
    )
