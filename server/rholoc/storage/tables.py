"""The tables of the database: jobs, workers, and the catalogue of stored objects.

A change of a table needs an update of older databases (``UPDATES``), which a test opens.
"""

import time
from collections.abc import Callable

import sqlalchemy as sa

from rholoc.errors import Conflict, StorageUnavailable

metadata = sa.MetaData()

# One row: the number of the schema.
schema_table = sa.Table("rholoc_schema", metadata, sa.Column("version_num", sa.String(32), nullable=False))

jobs_table = sa.Table(
    "rholoc_jobs",
    metadata,
    sa.Column("id", sa.String(32), primary_key=True),
    sa.Column("recording", sa.String(32), nullable=False),
    sa.Column("map_name", sa.Text, nullable=False),
    sa.Column("options", sa.JSON, nullable=False),
    sa.Column("state", sa.String(16), nullable=False),
    sa.Column("stage", sa.String(16), nullable=False),
    sa.Column("progress", sa.Float, nullable=False),
    sa.Column("message", sa.Text, nullable=False),
    sa.Column("log", sa.JSON, nullable=False),
    sa.Column("warnings", sa.JSON, nullable=False),
    sa.Column("error_code", sa.Text),
    sa.Column("error_message", sa.Text),
    sa.Column("error_hint", sa.Text),
    sa.Column("created", sa.Float, nullable=False),
    sa.Column("started", sa.Float),
    sa.Column("ended", sa.Float),
    sa.Column("attempts", sa.Integer, nullable=False),  # number of workers that have taken the job
    sa.Column("deaths", sa.Integer, nullable=False),  # number of them that died while they had it
    sa.Column("run", sa.String(41), nullable=False),  # of the last submission or retry; names the job's work folder
    sa.Column("worker", sa.String(100)),  # the lease: worker that has the job
    sa.Column("turn", sa.Float, nullable=False),  # sort key of the queue
    sa.Column("memory_bytes", sa.BigInteger),  # null: not known yet
    sa.Column("asked_in", sa.Text),  # the request's trace, as a W3C traceparent; null if not traced
)

workers_table = sa.Table(
    "rholoc_workers",
    metadata,
    sa.Column("id", sa.String(100), primary_key=True),
    sa.Column("heartbeat", sa.Float, nullable=False),
    sa.Column("memory_bytes", sa.BigInteger),  # for its jobs; null: without limit
    sa.Column("error", sa.Text),  # reason of repeated deaths; null: alive
)

# One row. Whoever changes the catalogue counts it up first and so holds the row until the transaction ends: revisions
# become visible in their order, and a reader that has seen one has seen all before it.
catalogue_table = sa.Table(
    "rholoc_catalogue",
    metadata,
    sa.Column("id", sa.Integer, primary_key=True),
    sa.Column("revision", sa.BigInteger, nullable=False),
)

maps_table = sa.Table(
    "rholoc_maps",
    metadata,
    sa.Column("name", sa.String(64), primary_key=True),
    sa.Column("blob", sa.String(32)),  # null: the map was deleted
    sa.Column("size_bytes", sa.BigInteger, nullable=False),
    sa.Column("modified", sa.Float, nullable=False),
    sa.Column("map_id", sa.Text, nullable=False),
    sa.Column("version", sa.Integer, nullable=False),
    sa.Column("revision", sa.BigInteger, nullable=False, index=True),
)

# Replaced maps; ``number`` counts from 1 for the last replaced one of each name.
map_versions_table = sa.Table(
    "rholoc_map_versions",
    metadata,
    sa.Column("name", sa.String(64), primary_key=True),
    sa.Column("number", sa.Integer, primary_key=True),
    sa.Column("blob", sa.String(32), nullable=False),
    sa.Column("size_bytes", sa.BigInteger, nullable=False),
    sa.Column("map_id", sa.Text, nullable=False),
    sa.Column("version", sa.Integer, nullable=False),
)

# Small files that every server needs: cameras, keys.
documents_table = sa.Table(
    "rholoc_documents",
    metadata,
    sa.Column("path", sa.String(200), primary_key=True),
    sa.Column("content", sa.LargeBinary),  # null: it was deleted
    sa.Column("revision", sa.BigInteger, nullable=False, index=True),
)

recordings_table = sa.Table(
    "rholoc_recordings",
    metadata,
    sa.Column("id", sa.String(32), primary_key=True),
    sa.Column("files", sa.JSON, nullable=False),
    sa.Column("size_bytes", sa.BigInteger, nullable=False),
    sa.Column("created", sa.Float, nullable=False),
)

# Notes on a recording: hidden files with what a job read from it, and waypoints that people corrected.
recording_notes_table = sa.Table(
    "rholoc_recording_notes",
    metadata,
    sa.Column("recording", sa.String(32), primary_key=True),
    sa.Column("file", sa.String(100), primary_key=True),
    sa.Column("content", sa.LargeBinary, nullable=False),
)

uploads_table = sa.Table(
    "rholoc_uploads",
    metadata,
    sa.Column("id", sa.String(32), primary_key=True),
    sa.Column("file_name", sa.Text, nullable=False),
    sa.Column("length", sa.BigInteger, nullable=False),
    sa.Column("offset", sa.BigInteger, nullable=False),
    sa.Column("map_name", sa.Text, nullable=False),
    sa.Column("options", sa.JSON, nullable=False),
    sa.Column("touched", sa.Float, nullable=False),
)

# Requests that changed something, of all servers; see :mod:`rholoc.service.access.audit`.
changes_table = sa.Table(
    "rholoc_changes",
    metadata,
    sa.Column("id", sa.BigInteger().with_variant(sa.Integer, "sqlite"), primary_key=True),
    sa.Column("time", sa.Float, nullable=False),
    sa.Column("who", sa.Text, nullable=False),
    sa.Column("method", sa.String(8), nullable=False),
    sa.Column("path", sa.Text, nullable=False),
    sa.Column("status", sa.Integer, nullable=False),
    sa.Column("job", sa.String(64), nullable=False),
    sa.Column("request_id", sa.String(64), nullable=False),
)

# Things that API keys have stored or begun, for their quotas. ``holder`` is the root of the chain of keys that handed
# ``key`` on, if any. A row may outlive its thing.
holdings_table = sa.Table(
    "rholoc_holdings",
    metadata,
    sa.Column("kind", sa.String(16), primary_key=True),
    sa.Column("name", sa.String(64), primary_key=True),
    sa.Column("key", sa.String(64), nullable=False, index=True),
    sa.Column("holder", sa.String(64), nullable=False, index=True),
    sa.Column("size_bytes", sa.BigInteger, nullable=False),
)

upload_pieces_table = sa.Table(
    "rholoc_upload_pieces",
    metadata,
    sa.Column("upload", sa.String(32), primary_key=True),
    sa.Column("start", sa.BigInteger, primary_key=True),
    sa.Column("size_bytes", sa.BigInteger, nullable=False),
    sa.Column("blob", sa.String(32), nullable=False),
)


UPDATES: tuple[Callable[[sa.Connection], None], ...] = ()
"""Changes of the tables since 1.0.0, in order; the first turns schema 1 into schema 2."""

_LOCK_NUMBER = 0x72686F6C6F63  # of PostgreSQL's advisory locks: "rholoc"
_LOCK_TIMEOUT_S, _RETRY_S = 60.0, 0.02


def prepare_tables(connection: sa.Connection) -> None:
    """Create or update the tables, and commit; a transaction open on the connection is rolled back. Nothing if current.

    If several processes start at once, one does so and the others wait: with PostgreSQL a minute, with SQLite 10 s.

    Raises:
        Conflict: the tables are of a later release.
        StorageUnavailable (PostgreSQL), OperationalError (SQLite): another process still creates or updates them.
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
