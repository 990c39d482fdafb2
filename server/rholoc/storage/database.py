"""The database: an SQLite file by default, PostgreSQL by URL. DBOS keeps its tables in the same one."""

from __future__ import annotations

import sqlite3
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import sqlalchemy as sa
from dbos import DBOS
from sqlalchemy.exc import DatabaseError, OperationalError

from rholoc import telemetry
from rholoc.disk import reporting_full_disk, storage_full
from rholoc.errors import Conflict, InvalidInput
from rholoc.storage.tables import VERSION_TABLE

HEAD = "0004"  # the last of the migrations; their numbers are in order as text
_BUSY_TIMEOUT_MS = 10_000
_WAL_AGAIN_S = 0.02
_MAX_STATEMENT = 1000  # characters, without values
_MIGRATIONS = Path(__file__).with_name("migrations")
_LOCK_NUMBER = 0x72686F6C6F63  # of PostgreSQL's advisory locks: "rholoc"


def open_database(data_dir: Path, database_url: str | None = None) -> sa.Engine:
    """The engine of the database, with rholoc's tables and DBOS's in it.

    Args:
        data_dir: where the SQLite file is kept.
        database_url: ``postgresql://…``, or None for the SQLite file.

    Raises:
        StorageFull: the disk is full.
        InvalidInput: the URL is not valid, or its database cannot be reached.
        Conflict: the file exists, but is not an SQLite database.
    """
    engine = database_engine(data_dir, database_url)
    prepare_database(engine)
    return engine


def database_engine(data_dir: Path, database_url: str | None = None) -> sa.Engine:
    """The engine of the database, which is connected to when it is first used.

    Raises:
        InvalidInput: the URL is not valid.
    """
    if database_url is not None:
        engine = sa.create_engine(_postgres_url(database_url), pool_pre_ping=True)
    else:
        engine = sa.create_engine(f"sqlite:///{Path(data_dir).resolve() / 'jobs.sqlite'}", pool_pre_ping=True)
        sa.event.listen(engine, "connect", _prepare_sqlite)
    if telemetry.is_on() or telemetry.wanted():
        _trace_statements(engine)
    return engine


def _trace_statements(engine: sa.Engine) -> None:
    """Note each statement's time where what it is for is traced."""

    def begin(connection: sa.Connection, *_: object) -> None:
        connection.info["statement_begun_s"] = time.perf_counter()

    def end(connection: sa.Connection, _cursor: object, statement: str, *_: object) -> None:
        took_s = time.perf_counter() - connection.info["statement_begun_s"]
        attributes = {"db.system.name": engine.dialect.name, "db.query.text": statement[:_MAX_STATEMENT]}
        telemetry.note(f"database {statement.split(maxsplit=1)[0]}", took_s, attributes, of_others=True)

    sa.event.listen(engine, "before_cursor_execute", begin)
    sa.event.listen(engine, "after_cursor_execute", end)


def prepare_database(engine: sa.Engine) -> None:
    """Make the tables, or bring those of an earlier release up to date.

    Raises:
        StorageFull: the disk is full.
        InvalidInput: the database cannot be reached.
        Conflict: the file is there, and no SQLite database.
    """
    if engine.dialect.name == "sqlite":
        with reporting_full_disk():
            Path(str(engine.url.database)).parent.mkdir(parents=True, exist_ok=True)
    else:
        _check_connection(engine)
    with reporting_full_database(), _reporting_no_database(engine.url):
        DBOS.migrate(engine.url.render_as_string(hide_password=False))
        _migrate(engine)


def _migrate(engine: sa.Engine) -> None:
    """Bring rholoc's tables up to date; of several processes that start at once, one does and the others wait."""
    present = _revision(engine)
    if present is not None and present >= HEAD:  # a later release's tables serve this one, too
        return
    from alembic import command  # only where there is something to do: it takes a start's time to import
    from alembic.config import Config

    config = Config()
    config.set_main_option("script_location", str(_MIGRATIONS))
    with engine.connect() as connection:
        _lock(connection)
        config.attributes["connection"] = connection
        command.upgrade(config, "head")
        connection.commit()


def _revision(engine: sa.Engine) -> str | None:
    """The last migration that the database has seen; None where it has seen none."""
    with engine.connect() as connection:
        if not sa.inspect(connection).has_table(VERSION_TABLE):
            return None
        return connection.execute(sa.select(sa.column("version_num")).select_from(sa.table(VERSION_TABLE))).scalar()


def _lock(connection: sa.Connection) -> None:
    """Until the transaction ends, no other process may migrate."""
    if connection.dialect.name == "sqlite":
        connection.exec_driver_sql("BEGIN IMMEDIATE")
    else:
        connection.execute(sa.select(sa.func.pg_advisory_xact_lock(_LOCK_NUMBER)))


@contextmanager
def _reporting_no_database(url: sa.URL) -> Iterator[None]:
    try:
        yield
    except DatabaseError as error:
        if "not a database" not in str(error):
            raise
        raise Conflict(
            f"{url.database} is damaged, or not a database of jobs.",
            "Move it away; a new one will be created in its place.",
        ) from error


def _postgres_url(text: str) -> sa.URL:
    try:
        url = sa.make_url(text)
    except sa.exc.ArgumentError:
        url = None
    if url is None or url.get_backend_name() not in ("postgresql", "postgres"):
        raise InvalidInput(  # without the text: it may hold a password
            "RHOLOC_DATABASE_URL is not the URL of a Postgres database.",
            "Give postgresql://user:password@host:port/name, or nothing for an SQLite file.",
        )
    return url.set(drivername="postgresql+psycopg")


def _check_connection(engine: sa.Engine) -> None:
    try:
        engine.connect().close()
    except OperationalError as error:
        where = f"{engine.url.host or 'this machine'}, database {engine.url.database}"
        reason = str(error.orig).strip().splitlines()[0].rstrip(".")
        raise InvalidInput(
            f"The database of jobs at {where} cannot be reached: {reason}.", "Check RHOLOC_DATABASE_URL."
        ) from error


@contextmanager
def reporting_full_database() -> Iterator[None]:
    """Turn the database's "disk is full" into :class:`rholoc.errors.StorageFull`."""
    try:
        yield
    except OperationalError as error:
        if "is full" in str(error.orig) or "No space left" in str(error.orig):
            raise storage_full() from error
        raise


def _prepare_sqlite(connection: Any, _: object) -> None:
    """Readers do not block the writer (WAL), writers wait their turn, a commit survives a power cut."""
    connection.isolation_level = "IMMEDIATE"
    connection.execute(f"PRAGMA busy_timeout={_BUSY_TIMEOUT_MS}")
    _use_wal(connection)
    connection.execute("PRAGMA synchronous=FULL")
    connection.execute("PRAGMA foreign_keys=ON")


def _use_wal(connection: Any) -> None:
    """Of several that open a new file at once some are refused, whatever the time-out: SQLite does not wait here."""
    given_up_s = time.monotonic() + _BUSY_TIMEOUT_MS / 1000
    while True:
        try:
            connection.execute("PRAGMA journal_mode=WAL")
            return
        except sqlite3.OperationalError as error:
            if "locked" not in str(error) or time.monotonic() > given_up_s:
                raise
            time.sleep(_WAL_AGAIN_S)
