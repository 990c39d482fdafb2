"""What several servers and workers share: a database, an object storage, and a place for copies of their own."""

from __future__ import annotations

import math
from pathlib import Path

import sqlalchemy as sa

from rholoc.disk import reporting_full_disk
from rholoc.storage.copies import Copies
from rholoc.storage.database import check_database, database_engine, reporting_full_database
from rholoc.storage.documents import CatalogueDocuments
from rholoc.storage.maps import SharedMapLibrary, StoredMap
from rholoc.storage.objects import ObjectStorage
from rholoc.storage.replica import MapRow, Replica
from rholoc.storage.tables import documents_table

ASKERS, CAMERAS, KEYS, SITES = "askers", "cameras", "keys", "sites"  # kinds of small files
_MAPS = "maps"
_COPIES = "copies"
_CATALOGUE = "catalogue.json"  # as it was last seen


class SharedStorage:
    """The storage of one process. Nothing is asked of the database before :meth:`open`.

    Args:
        storage_url: of the objects, as :class:`ObjectStorage` takes it.
        data_dir: where copies are kept, and the database where it is an SQLite file.
        database_url: ``postgresql://…``, or None for the SQLite file.
        copies_bytes: what copies of maps may take on this disk.
        cache_bytes: what maps may take in memory.

    Raises:
        InvalidInput: an URL is not valid.
    """

    def __init__(
        self,
        storage_url: str,
        data_dir: Path,
        database_url: str | None = None,
        copies_bytes: float = math.inf,
        cache_bytes: float = math.inf,
    ) -> None:
        self.objects = ObjectStorage(storage_url)
        self._copies = Copies(self.objects, _MAPS, Path(data_dir) / _COPIES, copies_bytes)
        self._replica = Replica(database_engine(data_dir, database_url), self._prepare, self._is_prepared)
        self.library = SharedMapLibrary(self._replica, self._copies, cache_bytes)

    @property
    def engine(self) -> sa.Engine:
        """The database's."""
        return self._replica.engine

    def documents(self, kind: str) -> CatalogueDocuments:
        """The small files of one kind."""
        return CatalogueDocuments(self._replica, kind)

    def snapshot(self) -> tuple[list[StoredMap], dict[str, bytes]]:
        """The files of all maps, and all small files by kind and name, ``cameras/phone.json``, of one moment.

        Raises:
            SQLAlchemyError: the database does not answer.
        """
        of_one_moment = {} if self.engine.dialect.name == "sqlite" else {"isolation_level": "REPEATABLE READ"}
        with self.engine.connect().execution_options(**of_one_moment) as connection, connection.begin():
            maps = self.library.stored(connection)
            wanted = sa.select(documents_table.c.path, documents_table.c.content)
            rows = connection.execute(wanted.where(documents_table.c.content.is_not(None)))
            return maps, {row.path: bytes(row.content) for row in rows}

    def recall(self) -> None:
        """Show what the catalogue held when this machine last followed it, until :meth:`open` succeeds."""
        self._replica.recall(self._copies.folder / _CATALOGUE)

    def follow(self) -> None:
        """Go on seeing what others change, in a thread, until :meth:`close`."""
        self._replica.follow()

    def open(self, follow: bool = False) -> None:
        """Read what the catalogue holds. Create its tables if they are missing.

        Args:
            follow: whether to :meth:`follow` as well.

        Raises:
            StorageFull: the disk is full.
            StorageUnavailable: the database does not answer, for now.
            InvalidInput: PostgreSQL refuses the connection.
            Conflict: the SQLite file is none.
        """
        with reporting_full_disk():
            self._copies.folder.mkdir(parents=True, exist_ok=True)
        check_database(self.engine)
        with reporting_full_database():
            self._replica.refresh()
        if follow:
            self.follow()

    def refresh(self) -> None:
        """See what others have changed.

        Raises:
            SQLAlchemyError: the database does not answer.
        """
        self._replica.refresh()

    def close(self) -> None:
        """Stop following, and close the connections."""
        self._replica.close()
        self.engine.dispose()

    def _prepare(self, before: MapRow, after: MapRow) -> None:
        self.library.prepare(before, after)

    def _is_prepared(self, before: MapRow, after: MapRow) -> bool:
        return self.library.is_prepared(before, after)
