"""The database: an SQLite file by default, PostgreSQL by URL.

All waits are bounded. If PostgreSQL does not answer within seconds, a query raises SQLAlchemy's ``OperationalError``,
and :func:`open_database` raises :class:`rholoc.errors.StorageUnavailable`.
"""

import shutil
import sqlite3
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import sqlalchemy as sa
from sqlalchemy.exc import DatabaseError, OperationalError
from sqlalchemy.exc import TimeoutError as PoolTimeout

from rholoc import telemetry
from rholoc.disk import reporting_full_disk, storage_full
from rholoc.errors import Conflict, InvalidInput, RholocError, StorageUnavailable
from rholoc.storage.tables import prepare_tables

MIN_SQLITE = (3, 38)  # the first version that always has JSON functions
_BUSY_TIMEOUT_MS = 10_000
_RETRY_S = 0.02
_MAX_STATEMENT = 1000  # characters, without values
_POOL_TIMEOUT_S = 5.0
_POSTGRES_OPTIONS = {
    "connect_timeout": 3,
    "keepalives_idle": 5,
    "keepalives_interval": 2,
    "keepalives_count": 3,
    "tcp_user_timeout": 10_000,  # ms
}
_FULL = ("is full", "No space left")
_NO_SPACE_BYTES = 2**17  # SQLite's index of its write-ahead log and a few pages


def open_database(data_dir: Path, database_url: str | None = None) -> sa.Engine:
    """Engine of a database after a successful connection, with rholoc's tables.

    Args:
        data_dir: folder of the SQLite file.
        database_url: ``postgresql://…``, or None for the SQLite file.

    Raises:
        StorageUnavailable: the database does not answer.
        StorageFull: the disk is full.
        InvalidInput: not a PostgreSQL URL, PostgreSQL refuses the connection, or SQLite is too old.
        Conflict: the file is not an SQLite database, or its tables are of a later version.
    """
    engine = database_engine(data_dir, database_url)
    try:
        check_database(engine)
    except RholocError:
        engine.dispose()
        raise
    return engine


def database_engine(data_dir: Path, database_url: str | None = None) -> sa.Engine:
    """Engine that connects on first use. The first connection creates missing tables.

    A query raises ``OperationalError`` if the database does not answer within seconds.

    Raises:
        InvalidInput: not a PostgreSQL URL, or Python's SQLite is older than :data:`MIN_SQLITE`.
    """
    if database_url is None:
        url = sa.URL.create("sqlite", database=str(Path(data_dir).resolve() / "jobs.sqlite"))
    else:
        url = _postgres_url(database_url)
    engine = _engine(url, _Preparation(url).ensure)
    if telemetry.is_on() or telemetry.wanted():
        _trace_statements(engine)
    return engine


def check_database(engine: sa.Engine) -> None:
    """Connect once, and create the tables if they are missing.

    Raises:
        StorageUnavailable: the database does not answer.
        StorageFull: the disk is full.
        InvalidInput: PostgreSQL refuses the connection.
        Conflict: the file is not an SQLite database, or its tables are of a later version.
    """
    with _reporting_refusal(engine.url), reporting_full_database():
        engine.connect().close()


def read_rows(engine: sa.Engine, wanted: sa.Executable) -> Sequence[sa.RowMapping]:
    """All rows of a query, in a transaction of its own. Raises SQLAlchemyError."""
    with engine.connect() as connection:
        return connection.execute(wanted).mappings().all()


def change_rows(engine: sa.Engine, statement: sa.Executable) -> int:
    """Execute a change in a transaction of its own; returns the number of rows changed. Raises SQLAlchemyError."""
    with engine.begin() as connection:
        return connection.execute(statement).rowcount


@contextmanager
def reporting_full_database() -> Iterator[None]:
    """Convert the database's "disk is full" to :class:`rholoc.errors.StorageFull`."""
    try:
        yield
    except OperationalError as error:
        if any(text in str(error.orig) for text in _FULL):
            raise storage_full() from error
        raise


def _engine(url: sa.URL, before_connecting: Callable[[], None]) -> sa.Engine:
    """Engine that calls ``before_connecting`` before each connection. Raises InvalidInput if SQLite is too old."""
    is_sqlite = url.get_backend_name() == "sqlite"
    if is_sqlite:
        _check_sqlite()
    options = {} if is_sqlite else dict(_POSTGRES_OPTIONS)
    engine = sa.create_engine(url, pool_pre_ping=True, pool_timeout=_POOL_TIMEOUT_S, connect_args=options)
    if is_sqlite:
        sa.event.listen(engine, "connect", _prepare_sqlite)

    def connect(_dialect: object, _record: object, arguments: list[Any], options: dict[str, Any]) -> Any:
        before_connecting()
        return None if is_sqlite else _connect_to_postgres(arguments, options)

    sa.event.listen(engine, "do_connect", connect)
    return engine


def _check_sqlite() -> None:
    """Raise InvalidInput if Python's SQLite is older than :data:`MIN_SQLITE`."""
    if sqlite3.sqlite_version_info < MIN_SQLITE:
        wanted = ".".join(map(str, MIN_SQLITE))
        raise InvalidInput(
            f"This Python has SQLite {sqlite3.sqlite_version}; rholoc needs {wanted}.",
            "Use a Python with a later SQLite, or a PostgreSQL (RHOLOC_DATABASE_URL).",
        )


def _connect_to_postgres(arguments: list[Any], options: dict[str, Any]) -> Any:
    """New connection, from arguments as psycopg takes them, whose server cancels statements after 4 s."""
    from rholoc.storage.bounded_connection import STATEMENT_TIMEOUT_S, BoundedConnection  # not loaded for SQLite

    connection = BoundedConnection.connect(*arguments, **options)
    connection.execute(f"SET statement_timeout = {int(1000 * STATEMENT_TIMEOUT_S)}")
    connection.commit()
    return connection


class _Preparation:
    """Creates or updates the tables before the first connection of an engine, or before a later one if that failed."""

    def __init__(self, url: sa.URL) -> None:
        self._url = url
        self._lock = threading.Lock()
        self._done = False
        self._failure: Exception | None = None
        self._failed_s = 0.0

    def ensure(self) -> None:
        """Prepare the tables once. Threads that wait for another one's attempt share its failure. Raises as
        :func:`_prepare_tables`.
        """
        if self._done:
            return
        asked_s = time.monotonic()
        with self._lock:
            if self._done:
                return
            if self._failure is not None and self._failed_s > asked_s:
                raise self._failure
            try:
                _prepare_tables(self._url)
            except Exception as error:
                self._failure, self._failed_s = error, time.monotonic()
                raise
            self._done = True


def _prepare_tables(url: sa.URL) -> None:
    """Create or update the tables of a database, with a connection of its own. Raises Conflict, StorageUnavailable,
    OperationalError, StorageFull.
    """
    if url.get_backend_name() == "sqlite":
        with reporting_full_disk():
            Path(str(url.database)).parent.mkdir(parents=True, exist_ok=True)
    engine = _engine(url, before_connecting=lambda: None)
    try:
        with engine.connect() as connection:
            prepare_tables(connection)
    finally:
        engine.dispose()


@contextmanager
def _reporting_refusal(url: sa.URL) -> Iterator[None]:
    """Convert errors of a first connection that are expected: to StorageUnavailable (silent, busy), StorageFull,
    InvalidInput (cannot be reached) or Conflict (no database of jobs).
    """
    try:
        yield
    except PoolTimeout as error:
        raise StorageUnavailable("All connections to the database are in use.", "Try again later.") from error
    except DatabaseError as error:
        raise _refusal(url, error) from error


def _refusal(url: sa.URL, error: DatabaseError) -> Exception:
    """The error to report for a failed first connection; the error itself if it is unexpected."""
    reason = (str(error.orig).strip().splitlines() or [type(error.orig).__name__])[0].rstrip(".")
    if url.get_backend_name() != "sqlite":
        where = f"The database of jobs at {url.host or 'this machine'}, database {url.database}"
        if is_silence(error):
            return StorageUnavailable(f"{where} does not answer: {reason}.", "It is tried again; see that it runs.")
        if isinstance(error, OperationalError):
            return InvalidInput(f"{where} cannot be reached: {reason}.", "Check RHOLOC_DATABASE_URL.")
        return error
    if "not a database" in reason:
        return Conflict(
            f"{url.database} is damaged, or not a database of jobs.",
            "Move it away; a new one will be created in its place.",
        )
    if not isinstance(error, OperationalError):
        return error
    if shutil.disk_usage(Path(str(url.database)).parent).free < _NO_SPACE_BYTES:
        return storage_full()
    return StorageUnavailable(f"The database of jobs cannot be used: {reason}.", "Check its disk and its permissions.")


def is_silence(error: DatabaseError) -> bool:
    """Whether the error is a timeout, not an answer of the database."""
    from psycopg.errors import ConnectionTimeout

    from rholoc.storage.bounded_connection import AnswerTimeout

    return isinstance(error.orig, ConnectionTimeout | AnswerTimeout)


def _postgres_url(text: str) -> sa.URL:
    """The URL of a PostgreSQL database, for the driver psycopg. Raises InvalidInput for any other text."""
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


def _trace_statements(engine: sa.Engine) -> None:
    """Make the engine note a span for each statement within a traced operation."""

    def begin(connection: sa.Connection, *_: object) -> None:
        connection.info["statement_begun_s"] = time.perf_counter()

    def end(connection: sa.Connection, _cursor: object, statement: str, *_: object) -> None:
        took_s = time.perf_counter() - connection.info["statement_begun_s"]
        attributes = {"db.system.name": engine.dialect.name, "db.query.text": statement[:_MAX_STATEMENT]}
        telemetry.note(f"database {statement.split(maxsplit=1)[0]}", took_s, attributes, of_others=True)

    sa.event.listen(engine, "before_cursor_execute", begin)
    sa.event.listen(engine, "after_cursor_execute", end)


def _prepare_sqlite(connection: Any, _: object) -> None:
    """Configure a new SQLite connection: readers do not block writers (WAL), which wait up to 10 s; durable commits."""
    connection.isolation_level = "IMMEDIATE"
    connection.execute(f"PRAGMA busy_timeout={_BUSY_TIMEOUT_MS}")
    _use_wal(connection)
    connection.execute("PRAGMA synchronous=FULL")
    connection.execute("PRAGMA foreign_keys=ON")


def _use_wal(connection: Any) -> None:
    """Switch to WAL, with retries for 10 s: SQLite refuses concurrent switches of a new file without waiting. Raises
    sqlite3.OperationalError.
    """
    given_up_s = time.monotonic() + _BUSY_TIMEOUT_MS / 1000
    while True:
        try:
            connection.execute("PRAGMA journal_mode=WAL")
            return
        except sqlite3.OperationalError as error:
            if "locked" not in str(error) or time.monotonic() > given_up_s:
                raise
            time.sleep(_RETRY_S)
