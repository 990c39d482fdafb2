"""In-memory replica of the catalogue, refreshed when other processes change it (PostgreSQL: LISTEN and NOTIFY).

Requests are answered from memory, also while the database is down; changes appear when it is back.
"""

from __future__ import annotations

import json
import logging
import threading
import time
from base64 import b64decode, b64encode
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import sqlalchemy as sa
from sqlalchemy.exc import SQLAlchemyError

from rholoc.disk import replace_file
from rholoc.errors import RholocError
from rholoc.storage.tables import catalogue_table, documents_table, maps_table

if TYPE_CHECKING:
    import psycopg


_CHANNEL = "rholoc_catalogue"
_STOPPED_WITHIN_S = 0.5
FOLLOW_EVERY_S = 0.5
"""Interval [s] at which the database is polled, since notifications may be absent or lost."""
_LOOK_AGAIN_AFTER_S = 0.1
_STOP_S = 2.0


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
        """Return when something has changed (PostgreSQL only), after ``at_most_s`` seconds, or soon after ``stopping``
        is set.

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


_log = logging.getLogger("rholoc.storage")


@dataclass(frozen=True)
class MapRow:
    """A map in the catalogue.

    Attributes:
        name: of the map.
        blob: name of the object with its file.
        size_bytes: of the file.
        modified: when it was published, seconds since the epoch.
        map_id, version: as in the file.
        revision: of the catalogue when it was published.
    """

    name: str
    blob: str
    size_bytes: int
    modified: float
    map_id: str
    version: int
    revision: int


@dataclass(frozen=True)
class _Changes:
    """Changes up to a revision: maps and small files by name, None if deleted."""

    revision: int
    maps: Mapping[str, MapRow | None]
    documents: Mapping[str, bytes | None]


class Replica:
    """The catalogue as of the last :meth:`refresh`. Safe to share between threads.

    Args:
        engine: of the database.
        prepare: called with the old and new row of a map changed by another process, before the change becomes visible.
            If it raises, the old row stays visible until a retry succeeds.
        is_prepared: whether ``prepare`` would have nothing to do.
    """

    def __init__(
        self,
        engine: sa.Engine,
        prepare: Callable[[MapRow, MapRow], None] = lambda before, after: None,
        is_prepared: Callable[[MapRow, MapRow], bool] = lambda before, after: True,
    ) -> None:
        self._engine = engine
        self._prepare = prepare
        self._is_prepared = is_prepared
        self._maps: Mapping[str, MapRow] = {}
        self._documents: Mapping[str, bytes] = {}
        self._revision = -1
        self._looked_again_s = float("-inf")
        self._looking = threading.Lock()
        self._unprepared: Mapping[str, MapRow] = {}
        self._lock = threading.Lock()
        self._stopping = threading.Event()
        self._follower: threading.Thread | None = None
        self._kept_in: Path | None = None
        self._kept_revision = -1

    @property
    def maps(self) -> Mapping[str, MapRow]:
        """The maps by name, as of the last refresh."""
        return self._maps

    @property
    def revision(self) -> int:
        """Revision of the catalogue at the last refresh; -1 before the first."""
        return self._revision

    @property
    def documents(self) -> Mapping[str, bytes]:
        """Content of the small files by path, as of the last refresh."""
        return self._documents

    @property
    def engine(self) -> sa.Engine:
        """The database engine."""
        return self._engine

    def refresh(self) -> None:
        """Load changes. Maps that need preparation are left to the thread of :meth:`follow`, if it runs.

        Raises:
            SQLAlchemyError: the database does not answer; the replica is unchanged.
        """
        self._see(self._changes())
        if self._follower is None:
            self._see_late()

    def look_again(self) -> None:
        """Refresh on a cache miss, at most every 0.1 s; errors of the database are ignored.

        Only one thread waits for the database at a time.
        """
        if time.monotonic() - self._looked_again_s < _LOOK_AGAIN_AFTER_S or not self._looking.acquire(blocking=False):
            return
        try:
            with suppress(SQLAlchemyError):
                self.refresh()
        finally:
            self._looked_again_s = time.monotonic()
            self._looking.release()

    @contextmanager
    def changing(self) -> Iterator[tuple[sa.Connection, int]]:
        """A transaction that changes the catalogue, and its new revision; committed and refreshed at the end of the
        block.

        Raises:
            SQLAlchemyError: the database does not answer; nothing was changed.
        """
        with self._engine.begin() as connection:
            connection.execute(catalogue_table.update().values(revision=catalogue_table.c.revision + 1))
            revision: int = connection.execute(sa.select(catalogue_table.c.revision)).scalar_one()
            yield connection, revision
            notify(connection)
        try:
            self.refresh()
        except SQLAlchemyError:
            _log.warning("catalogue_not_refreshed", exc_info=True)  # the next refresh may succeed

    def recall(self, file: Path) -> None:
        """Load the catalogue's last state from ``file``, if it has one, and keep that file up to date from now on.

        The first :meth:`refresh` replaces the loaded state.
        """
        self._kept_in = file
        with suppress(OSError, ValueError, KeyError, TypeError):
            kept = json.loads(file.read_bytes())
            self._maps = {row["name"]: MapRow(**row) for row in kept["maps"]}
            self._documents = {path: b64decode(content) for path, content in kept["documents"].items()}

    def follow(self) -> None:
        """Start a thread that refreshes when other processes change the catalogue, at least every 0.5 s."""
        self._follower = threading.Thread(target=self._follow, name="rholoc-catalogue", daemon=True)
        self._follower.start()

    def close(self) -> None:
        """Stop the thread of :meth:`follow`; waits at most 2 s, not for a database that does not answer."""
        self._stopping.set()
        if self._follower is not None:
            self._follower.join(_STOP_S)

    def _changes(self) -> _Changes:
        """Changes since the replica's revision. Raises SQLAlchemyError."""
        seen = self._revision
        with self._engine.connect() as connection:
            newest = connection.execute(sa.select(catalogue_table.c.revision)).scalar_one()
            if newest == seen:
                return _Changes(newest, {}, {})
            maps = connection.execute(sa.select(maps_table).where(maps_table.c.revision > seen)).mappings().all()
            edited = sa.select(documents_table).where(documents_table.c.revision > seen)
            documents = connection.execute(edited).mappings().all()
        return _Changes(
            newest,
            {row["name"]: None if row["blob"] is None else MapRow(**row) for row in maps},
            {row["path"]: None if row["content"] is None else bytes(row["content"]) for row in documents},
        )

    def _see(self, changes: _Changes) -> None:
        """Apply changes. Maps that need preparation are queued and keep their old rows meanwhile."""
        with self._lock:
            if changes.revision <= self._revision:  # another thread has applied all of this
                return
            late = {name: row for name, row in changes.maps.items() if row is not None and self._must_wait(name, row)}
            is_first = self._revision < 0  # the whole catalogue, in place of the recalled state
            shown = {name: self._maps[name] if name in late else row for name, row in changes.maps.items()}
            self._maps = _merged({} if is_first else self._maps, shown)
            self._documents = _merged({} if is_first else self._documents, changes.documents)
            self._unprepared = _merged(self._unprepared, {name: late.get(name) for name in changes.maps})
            self._revision = changes.revision

    def _must_wait(self, name: str, row: MapRow) -> bool:
        """Whether ``row`` is newer than the map's row here, and its file is not prepared yet (:meth:`_see_late` does
        that); False for a map that is new here.
        """
        before = self._maps.get(name)
        return before is not None and before.revision < row.revision and not self._is_prepared(before, row)

    def _see_late(self) -> None:
        """Prepare queued maps outside the lock, and apply their changes unless they have changed again."""
        for name, row in list(self._unprepared.items()):
            before = self._maps.get(name)
            if before is None:
                continue  # just deleted
            try:
                self._prepare(before, row)
            except RholocError:
                _log.warning("map_not_fetched", extra={"map": name}, exc_info=True)
                continue
            with self._lock:
                if self._unprepared.get(name) == row:
                    self._unprepared = _merged(self._unprepared, {name: None})
                    self._maps = _merged(self._maps, {name: row})

    def _follow(self) -> None:
        """Refresh until :meth:`close`, prepare queued maps, and save the state; errors are logged once."""
        failing = False
        listener = ChangeListener(self._engine)
        while not self._stopping.is_set():
            listener.wait(FOLLOW_EVERY_S, self._stopping)
            try:
                self._see(self._changes())
                self._see_late()
                self._keep()
                failing = False
            except Exception:  # must not prevent later changes
                if not failing:
                    _log.warning("catalogue_not_refreshed", exc_info=True)
                failing = True
        listener.close()

    def _keep(self) -> None:
        """Save the state for :meth:`recall`, if it has changed and a file was given; failures are ignored."""
        if self._kept_in is None or self._kept_revision == self._revision:
            return
        revision, maps, documents = self._revision, self._maps, self._documents
        kept = {
            "maps": [asdict(row) for row in maps.values()],
            "documents": {path: b64encode(content).decode() for path, content in documents.items()},
        }
        with suppress(OSError, RholocError):  # on a full disk, keep the old file
            replace_file(self._kept_in, json.dumps(kept).encode(), called="the catalogue", mode=0o600)
            self._kept_revision = revision


T = TypeVar("T")


def _merged(before: Mapping[str, T], changes: Mapping[str, T | None]) -> dict[str, T]:
    """Mapping after ``changes``; a value of None deletes its key."""
    after = {name: value for name, value in before.items() if name not in changes}
    return after | {name: value for name, value in changes.items() if value is not None}
