"""The database table of jobs, and the rules for changing its rows."""

from __future__ import annotations

import math
import time
import uuid
from collections.abc import Collection, Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass
from typing import Any

import sqlalchemy as sa

from rholoc.errors import Conflict, UnknownJob
from rholoc.jobs.job import Job, JobKind, JobOptions, JobPriority, JobState
from rholoc.progress import Stage
from rholoc.storage.tables import jobs_table

LOG_LINES = 50
MAX_LINE_LENGTH = 500  # characters of a job's messages
MAX_WARNINGS = 20
_ID_LENGTH = 32
_DAY_S = 24 * 3600.0
_AHEAD_S = {JobPriority.HIGH: _DAY_S, JobPriority.NORMAL: 0.0, JobPriority.LOW: -_DAY_S}
_PATIENCE = 10.0  # seconds that each second of a walk delays its turn

# Approximate share of a job's time in each stage. A job with links has no other stage.
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
    """A worker's hold on a job. It is lost when the job is cancelled, retried, or taken up by another worker.

    Attributes:
        job: the job's id.
        run: id of the job's last submission or retry, also the name of its work folder.
        attempt: number of workers that have taken the run, including this one.
    """

    job: str
    run: str
    attempt: int


@dataclass(frozen=True)
class JobWork:
    """Input of a job for its worker."""

    recording: str
    map_name: str
    options: JobOptions
    asked_in: str | None = None  # the trace of the request, as a W3C traceparent


@dataclass(frozen=True)
class Claim:
    """A job that a worker has taken.

    Attributes:
        lease: the worker's lease on the job.
        work: the job's input.
        memory_bytes: estimated memory; 0 if not known yet.
        deaths: number of workers that died while they had the job.
    """

    lease: Lease
    work: JobWork
    memory_bytes: int
    deaths: int = 0


def turn_of(submitted_s: float, priority: JobPriority, length_s: float) -> float:
    """Sort key of the queue [s]: the job with the smallest turn is taken first.

    Shorter walks and higher priorities overtake jobs submitted at about the same time. Since a turn does not change,
    no job waits for ever.

    Args:
        submitted_s: seconds since the epoch.
        priority: of the job.
        length_s: estimated length of the walk.
    """
    return submitted_s - _AHEAD_S[priority] + _PATIENCE * length_s


class JobTable:
    """The table of jobs."""

    def __init__(self, engine: sa.Engine) -> None:
        self._engine = engine

    def get(self, job_id: str) -> Job:
        """The job. Raises UnknownJob."""
        with self._engine.connect() as connection:
            row = connection.execute(sa.select(jobs_table).where(jobs_table.c.id == job_id)).mappings().first()
        if row is None:
            raise _unknown(job_id)
        return _job(row)

    def list(self, most: int | None = None, before: str | None = None) -> list[Job]:
        """At most ``most`` jobs, the newest first, older than the job ``before`` if given. Raises UnknownJob."""
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

    def queued(self) -> Sequence[Job]:
        """The queued jobs, unordered."""
        with self._engine.connect() as connection:
            rows = connection.execute(sa.select(jobs_table).where(jobs_table.c.state == JobState.QUEUED)).mappings()
            return [_job(row) for row in rows]

    def unfinished(self) -> dict[str, str]:
        """Job id → map name of the queued and running jobs."""
        wanted = sa.select(jobs_table.c.id, jobs_table.c.map_name)
        with self._engine.connect() as connection:
            rows = connection.execute(wanted.where(jobs_table.c.state.in_([JobState.QUEUED, JobState.RUNNING])))
            return {row.id: row.map_name for row in rows}

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
        return self._unfinished(JobKind.LEARN, jobs_table.c.map_name == map_name)

    def placing(self, site: str) -> Job | None:
        """The queued or running job by which the maps of a site are placed."""
        return self._unfinished(JobKind.PLACE, jobs_table.c.options["site"].as_string() == site)

    def _unfinished(self, kind: JobKind, of: sa.ColumnElement[bool]) -> Job | None:
        unfinished = jobs_table.c.state.in_([JobState.QUEUED, JobState.RUNNING])
        with self._engine.connect() as connection:
            found = connection.execute(sa.select(jobs_table).where(of, _kind_of_row == kind, unfinished))
            row = found.mappings().first()
        return None if row is None else _job(row)

    def last_learning(self, map_name: str) -> Job | None:
        """The last published or failed job by which a map learns from its queries."""
        found = (
            sa.select(jobs_table)
            .where(
                jobs_table.c.map_name == map_name,
                _kind_of_row == JobKind.LEARN,
                jobs_table.c.state.in_([JobState.PUBLISHED, JobState.FAILED]),
            )
            .order_by(jobs_table.c.ended.desc())
            .limit(1)
        )
        with self._engine.connect() as connection:
            row = connection.execute(found).mappings().first()
        return None if row is None else _job(row)

    def mapped_before(self, time_s: float) -> Sequence[str]:
        """Ids of recordings whose jobs all published their maps before ``time_s`` [s since the epoch]."""
        published_before = sa.and_(jobs_table.c.state == JobState.PUBLISHED, jobs_table.c.ended < time_s)
        others = sa.func.sum(sa.case((published_before, 0), else_=1))
        with self._engine.connect() as connection:
            recordings = sa.select(jobs_table.c.recording).where(jobs_table.c.recording != "")
            found = recordings.group_by(jobs_table.c.recording).having(others == 0)
            return connection.execute(found).scalars().all()

    # What users do

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
        with self._engine.begin() as connection:
            connection.execute(jobs_table.insert().values(**values, **_QUEUED))

    def requeue(self, job_id: str, length_s: float, asked_in: str | None = None) -> None:
        """Queue a failed or cancelled job again, as if it were submitted now. Raises UnknownJob, Conflict."""
        turn = turn_of(time.time(), self.get(job_id).priority, length_s)
        values = {"run": _new_run(job_id), "turn": turn, "asked_in": asked_in, **_QUEUED}
        with self._engine.begin() as connection:
            changed = connection.execute(
                jobs_table.update()
                .where(jobs_table.c.id == job_id, jobs_table.c.state.in_([JobState.FAILED, JobState.CANCELLED]))
                .values(**values)
            )
        if not changed.rowcount:
            raise Conflict("Only a job that failed or was cancelled can be retried.", "Submit a new one.")

    def prioritize(self, job_id: str, priority: JobPriority) -> None:
        """Change the priority of a queued job. Raises UnknownJob, Conflict."""
        with self._engine.begin() as connection:
            row = connection.execute(sa.select(jobs_table).where(jobs_table.c.id == job_id)).mappings().first()
            if row is None:
                raise _unknown(job_id)
            turn = row["turn"] + _AHEAD_S[_priority(row)] - _AHEAD_S[priority]
            changed = connection.execute(
                jobs_table.update()
                .where(jobs_table.c.id == job_id, jobs_table.c.state == JobState.QUEUED)
                .values(options={**row["options"], "priority": priority}, turn=turn)
            )
        if not changed.rowcount:
            raise Conflict("The job no longer waits for a worker.", "Only a queued job's priority can be changed.")

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
                .values(state=JobState.CANCELLED, message="cancelled", ended=time.time(), worker=None)
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

    def take(self, worker: str, memory_bytes: float = math.inf, free_bytes: float = math.inf) -> Claim | None:
        """Take the job whose turn it is, of those that fit a worker. Any earlier lease on the job is lost.

        If that job has to wait for free memory, so do all jobs after it; otherwise long walks might wait for ever.

        Args:
            worker: the worker's id.
            memory_bytes: the worker's memory for jobs.
            free_bytes: the free part of it.

        Returns:
            The job; None if there is none, or another worker was quicker.
        """
        fits = [jobs_table.c.state == JobState.QUEUED]
        if math.isfinite(memory_bytes):
            fits.append(sa.func.coalesce(jobs_table.c.memory_bytes, 0) <= int(memory_bytes))
        wanted = sa.select(jobs_table).where(*fits).order_by(jobs_table.c.turn, jobs_table.c.id).limit(1)
        with self._engine.connect() as connection:
            row = connection.execute(wanted).mappings().first()
        if row is None or (row["memory_bytes"] or 0) > free_bytes:
            return None
        lease = Lease(row["id"], row["run"], row["attempts"] + 1)
        taken = {
            "state": JobState.RUNNING,
            "worker": worker,
            "attempts": lease.attempt,
            "started": row["started"] or time.time(),
        }
        as_seen = [jobs_table.c[name] == row[name] for name in ("id", "state", "run", "attempts")]
        with self._engine.begin() as connection:
            changed = connection.execute(jobs_table.update().where(*as_seen).values(**taken))
        if not changed.rowcount:
            return None
        work = JobWork(row["recording"], row["map_name"], JobOptions.from_json(row["options"]), row["asked_in"])
        return Claim(lease, work, row["memory_bytes"] or 0, row["deaths"])

    def held_by(self, worker: str) -> set[Lease]:
        """The jobs that a worker has."""
        return self._running(jobs_table.c.worker == worker)

    def held_at(self, process: str) -> set[Lease]:
        """The jobs of a process's workers. :func:`rholoc.jobs.workers.process_name` names processes."""
        return self._running(jobs_table.c.worker.startswith(f"{process}-", autoescape=True))

    def take_back(self, living: Collection[str]) -> int:
        """Requeue jobs whose worker is not in ``living``. Returns their number."""
        dead = jobs_table.c.worker.not_in(list(living))
        return sum(self.lose(lease, "its worker died") for lease in self._running(dead))

    def lose(self, lease: Lease, why: str) -> bool:
        """Requeue a job after its worker's death. Returns False if the lease was lost before."""
        message = shortened(f"waiting for another worker: {why}")
        with self._engine.begin() as connection:
            row = connection.execute(sa.select(jobs_table).where(*_held(lease))).mappings().first()
            if row is None:
                return False
            values = {"deaths": row["deaths"] + 1, "message": message, "log": _appended(row["log"], message)}
            update = jobs_table.update().where(*_held(lease))
            return connection.execute(update.values(**{**_GIVEN_BACK, **values})).rowcount > 0

    def _running(self, of: sa.ColumnElement[bool]) -> set[Lease]:
        found = sa.select(jobs_table).where(jobs_table.c.state == JobState.RUNNING, of)
        with self._engine.connect() as connection:
            rows = connection.execute(found).mappings().all()
        return {Lease(row["id"], row["run"], row["attempts"]) for row in rows}

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

    def unfinished_runs(self) -> set[str]:
        """The runs of all jobs that are queued or running."""
        unfinished = jobs_table.c.state.in_([JobState.QUEUED, JobState.RUNNING])
        with self._engine.connect() as connection:
            return set(connection.execute(sa.select(jobs_table.c.run).where(unfinished)).scalars())

    def give_back(self, lease: Lease) -> None:
        """Requeue the job of a worker that stops."""
        self._update(lease, **_GIVEN_BACK)

    def hand_on(self, lease: Lease, memory_bytes: int) -> bool:
        """Requeue the job for a worker with ``memory_bytes``. Returns False if the lease was lost before."""
        return self._update(lease, **_GIVEN_BACK, memory_bytes=memory_bytes)

    def begin_publishing(self, lease: Lease) -> bool:
        """Make the job uncancellable. Returns False if the lease was lost before."""
        return self._update(lease, stage=Stage.PUBLISHED, message="publishing")

    def publish(self, lease: Lease, warnings: Sequence[str], connection: sa.Connection | None = None) -> bool:
        """Record that the job's map is published, and any reasons why it is not to be trusted.

        Args:
            lease: on the job.
            warnings: reasons not to trust the map.
            connection: its transaction is used; None for a new one.

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
            values["worker"] = None
            within.execute(jobs_table.update().where(*_held(lease)).values(**values))
            return True

    def _update(self, lease: Lease, **values: Any) -> bool:
        with self._engine.begin() as connection:
            return connection.execute(jobs_table.update().where(*_held(lease)).values(**values)).rowcount > 0


def shortened(text: str) -> str:
    """A job's message, cut to the length that is kept and made well-formed UTF-8."""
    line = text if len(text) <= MAX_LINE_LENGTH else f"{text[: MAX_LINE_LENGTH - 1]}…"
    return line.encode("utf-8", "replace").decode()


def overall(stage: Stage, fraction: float) -> float:
    """The progress 0..1 over all stages, of ``fraction`` within ``stage``."""
    within = min(1.0, max(0.0, fraction))
    if stage is Stage.LINKS:
        return within
    stages = list(_SHARES)
    before = sum(_SHARES[earlier] for earlier in stages[: stages.index(stage)])
    return min(1.0, before + _SHARES[stage] * within)


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
_GIVEN_BACK: dict[str, object] = {"state": JobState.QUEUED, "worker": None, "message": "waiting for another worker"}

_kind_of_row = jobs_table.c.options["kind"].as_string()


def _new_run(job_id: str) -> str:
    """Id of a new run of a job, so that a retry does not find the previous run's files."""
    return f"{job_id}-{uuid.uuid4().hex[:8]}"


def _unknown(job_id: str) -> UnknownJob:
    return UnknownJob(f"There is no job {job_id[:_ID_LENGTH]!r}.", "List the jobs to see their ids.")


def _held(lease: Lease, state: JobState = JobState.RUNNING) -> tuple[sa.ColumnElement[bool], ...]:
    return (
        jobs_table.c.id == lease.job,
        jobs_table.c.run == lease.run,
        jobs_table.c.attempts == lease.attempt,
        jobs_table.c.state == state,
    )


def _appended(log: list[str], *lines: str) -> list[str]:
    now = time.strftime("%H:%M:%S", time.gmtime())
    return [*log, *(f"{now} {line}" for line in lines)][-LOG_LINES:]


def _priority(row: sa.RowMapping) -> JobPriority:
    return JobPriority(row["options"]["priority"])


def _kind(row: sa.RowMapping) -> JobKind:
    return JobKind(row["options"]["kind"])


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
        warnings=tuple(row["warnings"]),
        error_code=row["error_code"],
        error_message=row["error_message"],
        error_hint=row["error_hint"],
        created=row["created"],
        started=row["started"],
        ended=row["ended"],
        attempts=row["attempts"],
        priority=_priority(row),
        memory_bytes=row["memory_bytes"],
        worker=row["worker"],
        kind=_kind(row),
        site=row["options"]["site"],
    )
