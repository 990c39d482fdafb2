"""The database of jobs: an SQLite file by default, Postgres by URL. DBOS keeps its tables in the same one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import sqlalchemy as sa
from dbos import DBOS
from sqlalchemy.exc import DatabaseError, OperationalError
from sqlalchemy.schema import CreateColumn, CreateTable

from rholoc.disk import reporting_full_disk, storage_full
from rholoc.errors import Conflict, InvalidInput

_BUSY_TIMEOUT_MS = 10_000

_metadata = sa.MetaData()

jobs_table = sa.Table(
    "rholoc_jobs",
    _metadata,
    sa.Column("id", sa.String(32), primary_key=True),
    sa.Column("recording", sa.String(32), nullable=False),
    sa.Column("map_name", sa.Text, nullable=False),
    sa.Column("options", sa.JSON, nullable=False),
    sa.Column("state", sa.String(16), nullable=False),
    sa.Column("stage", sa.String(16), nullable=False),
    sa.Column("progress", sa.Float, nullable=False),
    sa.Column("message", sa.Text, nullable=False),
    sa.Column("log", sa.JSON, nullable=False),
    sa.Column("warnings", sa.JSON),  # null in jobs from before there were warnings
    sa.Column("error_code", sa.Text),
    sa.Column("error_message", sa.Text),
    sa.Column("error_hint", sa.Text),
    sa.Column("created", sa.Float, nullable=False),
    sa.Column("started", sa.Float),
    sa.Column("ended", sa.Float),
    sa.Column("attempts", sa.Integer, nullable=False),
    # The DBOS workflow of the latest submission or retry; with ``attempts`` it says who holds the job.
    sa.Column("workflow_id", sa.Text, nullable=False),
)

workers_table = sa.Table(
    "rholoc_workers",
    _metadata,
    sa.Column("id", sa.String(100), primary_key=True),
    sa.Column("heartbeat", sa.Float, nullable=False),
)


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
    with reporting_full_disk():
        Path(data_dir).mkdir(parents=True, exist_ok=True)
    if database_url is None:
        url = sa.make_url(f"sqlite:///{Path(data_dir).resolve() / 'jobs.sqlite'}")
    else:
        url = _postgres_url(database_url)
    engine = sa.create_engine(url, pool_pre_ping=True)
    if database_url is None:
        sa.event.listen(engine, "connect", _prepare_sqlite)
    else:
        _check_connection(engine)
    with reporting_full_database(), _reporting_no_database(url):
        DBOS.migrate(url.render_as_string(hide_password=False))
        with engine.begin() as connection:
            for table in _metadata.sorted_tables:
                connection.execute(CreateTable(table, if_not_exists=True))
                _add_missing_columns(connection, table)
    return engine


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


def _add_missing_columns(connection: sa.Connection, table: sa.Table) -> None:
    """Bring a table of an earlier version up to date; later columns are nullable, so that old rows remain valid."""
    present = {column["name"] for column in sa.inspect(connection).get_columns(table.name)}
    for column in table.columns:
        if column.name not in present:
            definition = CreateColumn(column).compile(dialect=connection.dialect)
            connection.execute(sa.text(f"ALTER TABLE {table.name} ADD COLUMN {definition}"))


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
    connection.execute("PRAGMA journal_mode=WAL")
    connection.execute("PRAGMA synchronous=FULL")
    connection.execute("PRAGMA foreign_keys=ON")
