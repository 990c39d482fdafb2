"""Notifications of catalogue changes by PostgreSQL's LISTEN and NOTIFY; none with SQLite."""

from __future__ import annotations

import threading
import time
from contextlib import suppress
from typing import TYPE_CHECKING

import sqlalchemy as sa
from sqlalchemy.exc import SQLAlchemyError

if TYPE_CHECKING:
    import psycopg

_CHANNEL = "rholoc_catalogue"
_STOPPED_WITHIN_S = 0.5


def notify(connection: sa.Connection) -> None:
    """Notify listeners when the transaction is committed. Does nothing with SQLite."""
    if connection.dialect.name == "postgresql":
        connection.exec_driver_sql(f"NOTIFY {_CHANNEL}")


class ChangeListener:
    """Waits for changes. For one thread.

    Args:
        engine: of the database. The first wait takes one of its connections and keeps it (PostgreSQL only).
    """

    def __init__(self, engine: sa.Engine) -> None:
        self._engine = engine
        self._connection: sa.Connection | None = None

    def wait(self, at_most_s: float, stopping: threading.Event) -> None:
        """Return when something has changed, after ``at_most_s`` seconds, or soon after ``stopping`` is set.

        Changes before the first call, and while the database does not answer, are missed.
        """
        if self._engine.dialect.name != "postgresql":
            stopping.wait(at_most_s)
            return
        import psycopg  # not loaded for SQLite

        until_s = time.monotonic() + at_most_s
        try:
            listening = self._listening()
            while not stopping.is_set() and (left_s := until_s - time.monotonic()) > 0:
                if list(listening.notifies(timeout=min(left_s, _STOPPED_WITHIN_S), stop_after=1)):
                    return
        except (SQLAlchemyError, psycopg.Error, OSError):
            self.close()
            stopping.wait(at_most_s)

    def close(self) -> None:
        """Close the listener's own connection, if it has one, ignoring errors; the next wait opens another."""
        if self._connection is not None:
            with suppress(SQLAlchemyError):
                self._connection.invalidate()  # a listening connection must not return to the pool
                self._connection.close()
            self._connection = None

    def _listening(self) -> psycopg.Connection:
        """The driver's connection that listens, opened on first use. Raises SQLAlchemyError."""
        if self._connection is None:
            self._connection = self._engine.connect().execution_options(isolation_level="AUTOCOMMIT")
            self._connection.exec_driver_sql(f"LISTEN {_CHANNEL}")
        driver: psycopg.Connection = self._connection.connection.driver_connection  # type: ignore[assignment]
        return driver
