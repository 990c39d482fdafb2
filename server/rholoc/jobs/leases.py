"""Leases of workers on jobs: a job's row names the worker that has it, and only that worker changes the row."""

import math
import time
from collections.abc import Collection, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from itertools import accumulate

import sqlalchemy as sa

from rholoc.jobs.job import JobOptions, JobState
from rholoc.jobs.table import UNFINISHED, JobWork
from rholoc.progress import Stage
from rholoc.reports import report_from_json
from rholoc.storage.database import change_rows, read_rows
from rholoc.storage.tables import jobs_table

LOG_LINES = 50
MAX_LINE_LENGTH = 500  # characters of a job's messages
MAX_WARNINGS = 20
_GIVEN_BACK: dict[str, object] = {"state": JobState.QUEUED, "worker": None, "message": "waiting for another worker"}


# Share of a job's time in each stage, measured with a phone's video and IMU. A job with links has no other stage.
_SHARES = {
    Stage.RECEIVED: 0.0,
    Stage.READ: 0.02,
    Stage.KEYFRAMES: 0.37,
    Stage.FEATURES: 0.06,
    Stage.POSES: 0.39,
    Stage.OBSERVATIONS: 0.13,
    Stage.DENSITIES: 0.02,
    Stage.REPORT: 0.01,
    Stage.PUBLISHED: 0.0,
}
# A running sum, so that each stage begins where the one before it ends, to the bit: sum() rounds otherwise since 3.12.
_BEFORE = dict(zip(_SHARES, accumulate(_SHARES.values(), initial=0.0), strict=False))


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


class Leases:
    """The leases on the jobs of a database.

    Args:
        engine: of the database.
    """

    def __init__(self, engine: sa.Engine) -> None:
        self._engine = engine

    def take(self, worker: str, memory_bytes: float = math.inf, free_bytes: float = math.inf) -> Claim | None:
        """Take the job whose turn it is, of those that fit a worker. Any earlier lease on the job is lost.

        If that job has to wait for free memory, so do all jobs after it; otherwise long walks might wait for ever.
        A job whose memory is not known yet fits every worker.

        Args:
            worker: the worker's id.
            memory_bytes: the worker's memory for jobs.
            free_bytes: the free part of it.

        Returns:
            The job; None if there is none, it has to wait for free memory, or another worker was quicker.
        """
        fits = [jobs_table.c.state == JobState.QUEUED]
        if math.isfinite(memory_bytes):
            fits.append(sa.func.coalesce(jobs_table.c.memory_bytes, 0) <= int(memory_bytes))
        wanted = sa.select(jobs_table).where(*fits).order_by(jobs_table.c.turn, jobs_table.c.id).limit(1)
        row = next(iter(read_rows(self._engine, wanted)), None)
        if row is None or (row["memory_bytes"] or 0) > free_bytes:
            return None
        lease = Lease(row["id"], row["run"], row["attempts"] + 1)
        taken = {
            "state": JobState.RUNNING,
            "worker": worker,
            "attempts": lease.attempt,
            "started": time.time(),
        }
        as_seen = [jobs_table.c[name] == row[name] for name in ("id", "state", "run", "attempts")]
        if not change_rows(self._engine, jobs_table.update().where(*as_seen).values(**taken)):
            return None
        work = JobWork(row["recording"], row["map_name"], report_from_json(JobOptions, row["options"]), row["asked_in"])
        return Claim(lease, work, row["memory_bytes"] or 0, row["deaths"])

    def held_by(self, worker: str) -> set[Lease]:
        """Leases of a worker's running jobs."""
        return self._running(jobs_table.c.worker == worker)

    def held_at(self, process: str) -> set[Lease]:
        """Leases of a process's running jobs; :func:`rholoc.jobs.workers_table.process_name` names processes."""
        return self._running(jobs_table.c.worker.startswith(f"{process}-", autoescape=True))

    def take_back(self, living: Collection[str]) -> int:
        """Requeue running jobs whose worker is not in ``living``, counting the death. Returns their number."""
        dead = jobs_table.c.worker.not_in(list(living))
        return sum(self.lose(lease, "its worker died") for lease in self._running(dead))

    def lose(self, lease: Lease, why: str) -> bool:
        """Requeue a job after its worker's death, counted and logged. False if the lease was lost before."""
        message = shortened(f"waiting for another worker: {why}")
        with self._engine.begin() as connection:
            row = connection.execute(sa.select(jobs_table).where(*_held(lease))).mappings().first()
            if row is None:
                return False
            values = {"deaths": row["deaths"] + 1, "message": message, "log": _appended(row["log"], message)}
            update = jobs_table.update().where(*_held(lease))
            return connection.execute(update.values(**{**_GIVEN_BACK, **values})).rowcount > 0

    def _running(self, of: sa.ColumnElement[bool]) -> set[Lease]:
        """Leases on the running jobs that fulfil a condition."""
        wanted = sa.select(jobs_table).where(jobs_table.c.state == JobState.RUNNING, of)
        return {Lease(row["id"], row["run"], row["attempts"]) for row in read_rows(self._engine, wanted)}

    def holds(self, lease: Lease) -> bool:
        """Whether the lease is still valid."""
        return bool(read_rows(self._engine, sa.select(jobs_table.c.id).where(*_held(lease))))

    def note(self, lease: Lease, stage: Stage, fraction: float, message: str) -> None:
        """Record progress, which never decreases; a new stage or message is logged. A lost lease records nothing."""
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
        return {row["run"] for row in read_rows(self._engine, sa.select(jobs_table.c.run).where(UNFINISHED))}

    def give_back(self, lease: Lease) -> None:
        """Requeue the job of a worker that stops, without counting a death; does nothing if the lease is lost."""
        self._update(lease, **_GIVEN_BACK)

    def hand_on(self, lease: Lease, memory_bytes: int) -> bool:
        """Requeue the job for a worker with at least ``memory_bytes``. Returns False if the lease was lost before."""
        return self._update(lease, **_GIVEN_BACK, memory_bytes=memory_bytes)

    def begin_publishing(self, lease: Lease) -> bool:
        """Set the job's stage to published, in which it cannot be cancelled. False if the lease was lost before."""
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
        published = sa.select(jobs_table.c.id).where(*_held(lease, JobState.PUBLISHED))
        return ended or bool(read_rows(self._engine, published))

    def fail(self, lease: Lease, failure: Failure) -> bool:
        """Record why the job failed. Returns False, and records nothing, if the lease was lost before."""
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
        **values: object,
    ) -> bool:
        """Set a job's final state, and log the lines. False if the lease was lost."""
        with nullcontext(connection) if connection is not None else self._engine.begin() as within:
            log = within.execute(sa.select(jobs_table.c.log).where(*_held(lease))).scalar()
            if log is None:
                return False
            values |= {"state": state, "message": message, "log": _appended(log, *lines), "ended": time.time()}
            values["worker"] = None
            within.execute(jobs_table.update().where(*_held(lease)).values(**values))
            return True

    def _update(self, lease: Lease, **values: object) -> bool:
        """Set columns of a leased job. False if the lease was lost."""
        return change_rows(self._engine, jobs_table.update().where(*_held(lease)).values(**values)) > 0


def shortened(text: str) -> str:
    """A job's message, cut to 500 characters and made well-formed UTF-8."""
    line = text if len(text) <= MAX_LINE_LENGTH else f"{text[: MAX_LINE_LENGTH - 1]}…"
    return line.encode("utf-8", "replace").decode()


def overall(stage: Stage, fraction: float) -> float:
    """The progress 0..1 over all stages, of ``fraction`` (clipped to 0..1) within ``stage``. ``Stage.LINKS`` is the
    only stage of its job.
    """
    within = min(1.0, max(0.0, fraction))
    if stage is Stage.LINKS:
        return within
    return min(1.0, _BEFORE[stage] + _SHARES[stage] * within)


def _held(lease: Lease, state: JobState = JobState.RUNNING) -> tuple[sa.ColumnElement[bool], ...]:
    """Conditions on a job's row for the lease to hold."""
    return (
        jobs_table.c.id == lease.job,
        jobs_table.c.run == lease.run,
        jobs_table.c.attempts == lease.attempt,
        jobs_table.c.state == state,
    )


def _appended(log: list[str], *lines: str) -> list[str]:
    """The last ``LOG_LINES`` lines of a log with further lines, which get the present time."""
    now = time.strftime("%H:%M:%S", time.gmtime())
    return [*log, *(f"{now} {line}" for line in lines)][-LOG_LINES:]
