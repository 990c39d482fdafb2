"""The database table of workers: heartbeats, and reasons of repeated deaths."""

import math
import os
import socket
import time
from dataclasses import dataclass

import sqlalchemy as sa

from rholoc.storage.database import change_rows, read_rows
from rholoc.storage.tables import workers_table

DEAD_AFTER_S = 15.0  # since the last heartbeat
_TROUBLE_FOR_S = 600.0  # age at which a report expires


@dataclass(frozen=True)
class WorkerOffer:
    """A living worker and its capacity.

    Attributes:
        id: the worker's id.
        memory_bytes: memory for its jobs.
    """

    id: str
    memory_bytes: float


def process_name(pid: int | None = None) -> str:
    """Name of a process across machines, by default of this one. Its workers' ids are the name, a dash and a suffix."""
    return f"{socket.gethostname()[:40]}-{os.getpid() if pid is None else pid}"


class WorkerTable:
    """The table of workers."""

    def __init__(self, engine: sa.Engine) -> None:
        self._engine = engine

    def beat(self, worker: str, memory_bytes: float = math.inf) -> None:
        """Record that the worker is alive, and its memory for jobs."""
        self._put(worker, int(memory_bytes) if math.isfinite(memory_bytes) else None, None)

    def report(self, starter: str, error: str) -> None:
        """Record why workers started by the process ``starter`` die. Raises SQLAlchemyError."""
        self._put(starter, None, error)

    def remove(self, worker: str) -> None:
        """Remove a worker, or the report of a process that starts workers."""
        change_rows(self._engine, workers_table.delete().where(workers_table.c.id == worker))

    def remove_all(self, process: str) -> None:
        """Remove the workers that ran as a process, named as :func:`process_name` does."""
        of_process = workers_table.c.id.startswith(f"{process}-", autoescape=True)
        change_rows(self._engine, workers_table.delete().where(of_process))

    def living(self, dead_after_s: float = DEAD_AFTER_S) -> list[WorkerOffer]:
        """Workers with a heartbeat younger than ``dead_after_s``."""
        recent = workers_table.c.heartbeat > time.time() - dead_after_s
        wanted = sa.select(workers_table).where(recent, workers_table.c.error.is_(None))
        return [
            WorkerOffer(row["id"], math.inf if row["memory_bytes"] is None else row["memory_bytes"])
            for row in read_rows(self._engine, wanted)
        ]

    def error(self) -> str | None:
        """The last error reported in the last ten minutes; None if there is none."""
        recent = workers_table.c.heartbeat > time.time() - _TROUBLE_FOR_S
        reported = sa.select(workers_table.c.error).where(workers_table.c.error.is_not(None), recent)
        newest = reported.order_by(workers_table.c.heartbeat.desc()).limit(1)
        return next((row["error"] for row in read_rows(self._engine, newest)), None)

    def forget(self, dead_after_s: float) -> None:
        """Remove workers with a heartbeat older than ``dead_after_s``, and errors older than ten minutes too."""
        now, heartbeat, error = time.time(), workers_table.c.heartbeat, workers_table.c.error
        old = sa.or_(
            sa.and_(error.is_(None), heartbeat < now - dead_after_s),
            heartbeat < now - max(_TROUBLE_FOR_S, dead_after_s),
        )
        if read_rows(self._engine, sa.select(workers_table.c.id).where(old)):
            change_rows(self._engine, workers_table.delete().where(old))

    def _put(self, row_id: str, memory_bytes: int | None, error: str | None) -> None:
        """Insert or update a row with the present time: a worker's memory [bytes], or a starter's error."""
        values = {"heartbeat": time.time(), "memory_bytes": memory_bytes, "error": error}
        with self._engine.begin() as connection:
            changed = connection.execute(workers_table.update().where(workers_table.c.id == row_id).values(**values))
            if not changed.rowcount:
                connection.execute(workers_table.insert().values(id=row_id, **values))
