"""Create the database's tables, or update those of an earlier release."""

from __future__ import annotations

import time
from collections.abc import Callable

import sqlalchemy as sa

from rholoc.errors import Conflict, StorageUnavailable
from rholoc.storage.tables import catalogue_table, metadata, schema_table

UPDATES: tuple[Callable[[sa.Connection], None], ...] = ()
"""Changes of the tables since 1.0.0, in order; the first turns schema 1 into schema 2."""

_LOCK_NUMBER = 0x72686F6C6F63  # of PostgreSQL's advisory locks: "rholoc"
_LOCK_TIMEOUT_S, _RETRY_S = 60.0, 0.02


def prepare_tables(connection: sa.Connection) -> None:
    """Create or update the tables, and commit. Another transaction open on the connection is rolled back.

    If several processes start at once, one does so and the others wait: with PostgreSQL a minute, with SQLite 10 s.

    Raises:
        Conflict: the tables are of a later release.
        StorageUnavailable, OperationalError: PostgreSQL, SQLite: another process still creates or updates them.
    """
    newest = 1 + len(UPDATES)
    if _present_schema(connection) == newest:
        return
    connection.rollback()
    _lock(connection)
    present = _present_schema(connection)
    if present > newest:
        raise Conflict(
            "The database is of a later version of rholoc.", "Update this one, or restore a backup from before."
        )
    if present == 0:
        metadata.create_all(connection)
        connection.execute(catalogue_table.insert().values(id=1, revision=0))
        connection.execute(schema_table.insert().values(version_num=""))
    for update in UPDATES[present - 1 :] if present else ():
        update(connection)
    connection.execute(schema_table.update().values(version_num=f"{newest:04d}"))
    connection.commit()


def _present_schema(connection: sa.Connection) -> int:
    """Number of the database's schema; 0 if it has no tables yet."""
    if not sa.inspect(connection).has_table(schema_table.name):
        return 0
    return int(connection.execute(sa.select(schema_table.c.version_num)).scalar_one())


def _lock(connection: sa.Connection) -> None:
    """Keep other processes from changing the tables until the transaction ends. Raises StorageUnavailable (PostgreSQL,
    after a minute) or OperationalError (SQLite, after 10 s).
    """
    if connection.dialect.name == "sqlite":
        connection.exec_driver_sql("BEGIN IMMEDIATE")
        return
    last_s = time.monotonic() + _LOCK_TIMEOUT_S
    while not connection.execute(sa.select(sa.func.pg_try_advisory_xact_lock(_LOCK_NUMBER))).scalar():
        if time.monotonic() > last_s:
            raise StorageUnavailable("Another process is still creating the tables.", "Try again later.")
        time.sleep(_RETRY_S)
