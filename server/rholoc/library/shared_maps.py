"""The catalogue of maps that several servers share: files in object storage, their names in the database."""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import sqlalchemy as sa
from sqlalchemy.exc import SQLAlchemyError

from rholoc.disk import make_folder, temporary_folder
from rholoc.library.map_catalogue import KEPT_VERSIONS, MapCatalogue, MapChange, MapFile
from rholoc.maps import Map
from rholoc.maps.formats.rho_file import LENGTH_BYTES, MapOutline, header_bytes, outline_of
from rholoc.storage.object_cache import ObjectCache
from rholoc.storage.replica import Replica
from rholoc.storage.tables import map_versions_table, maps_table

_ORPHANED_AFTER_S = 6 * 3600.0  # a younger object without a name may be about to get one

ActOnPublishing = Callable[[sa.Connection, Map], None]


class StoredMaps(MapCatalogue):
    """Catalogue of maps whose names are in the database and whose files are objects; see :class:`MapCatalogue`.

    Stored files never change; a change of the catalogue is one transaction. Methods that change something, and
    :meth:`versions`, raise SQLAlchemyError if the database does not answer.

    Args:
        replica: of the database's catalogue.
        copies: cache of the files.
        act: called in each transaction that publishes a map; if it raises, nothing is published.
    """

    holds_only_maps = True

    def __init__(self, replica: Replica, copies: ObjectCache, act: ActOnPublishing | None = None) -> None:
        self._replica, self._copies, self._act = replica, copies, act

    @property
    def folder(self) -> Path:
        """Folder of the cached copies."""
        return self._copies.folder

    def names(self) -> list[str]:
        """Sorted names of all maps as of the last refresh."""
        return sorted(self._replica.maps)

    def find(self, name: str) -> MapFile | None:
        """The present file of a name as of the last refresh; None if no map has it."""
        row = self._replica.maps.get(name)
        if row is None:
            return None
        return _present(row.blob, row.size_bytes, row.modified, row.revision, row.map_id, row.version)

    def versions(self, name: str) -> list[MapFile]:
        """The files that were replaced under a name, the last replaced first, from the database."""
        with self._replica.engine.connect() as connection:
            return _Change(connection, 0).versions(name)

    def stamp(self) -> int:
        """The catalogue's revision at the last refresh; -1 before the first."""
        return self._replica.revision

    def refresh(self) -> None:
        """Load other servers' changes; does nothing if the database does not answer."""
        with suppress(SQLAlchemyError):
            self._replica.refresh()

    def look_again(self) -> None:
        """:meth:`refresh` on a cache miss, at most every 0.1 s."""
        self._replica.look_again()

    def is_here(self, file: MapFile) -> bool:
        """Whether a copy of the file is in the cache."""
        return self._copies.has(file.key)

    def local(self, file: MapFile) -> Path:
        """Path of the file's copy in the cache, fetched if it is missing."""
        return self._copies.path(file.key, file.size_bytes)

    def outline(self, file: MapFile, name: str) -> MapOutline:
        """Description and size from the header of a file, its copy's or the stored object's."""
        length = header_bytes(self._copies.read(file.key, 0, LENGTH_BYTES), name)
        return outline_of(self._copies.read(file.key, LENGTH_BYTES, length), name)

    def make_room(self) -> None:
        """Make the folder of copies if it is missing, and evict copies to leave room on its disk."""
        make_folder(self.folder)
        self._copies.make_room()  # other files may have filled the disk

    def store(self, arrived: Path, map_: Map) -> MapFile:
        """Store the file as a new object without a name in the catalogue; ``arrived`` becomes its cached copy."""
        size_bytes = arrived.stat().st_size
        blob = self._copies.store(arrived)
        return _replaced(blob, size_bytes, map_.info.id, map_.info.version)

    @contextmanager
    def changing(self, published: Map | None = None) -> Iterator[MapChange]:
        """Yield a change in a transaction, committed at the end; ``act`` is called first if a map is published."""
        with self._replica.changing() as (connection, revision):
            if published is not None and self._act is not None:
                self._act(connection, published)
            yield _Change(connection, revision)

    def snapshot(self) -> Iterator[tuple[str, int, Path]]:
        """Name, number (0: present, 1: the last replaced, …) and a copy of each file; the next replaces the copy."""
        now, before = maps_table.c, map_versions_table.c
        present = sa.select(now.name, sa.literal(0), now.blob, now.size_bytes).where(now.blob.is_not(None))
        replaced = sa.select(before.name, before.number, before.blob, before.size_bytes)
        with self._replica.engine.connect() as connection:  # one statement for a consistent snapshot
            rows = connection.execute(present.union_all(replaced)).all()
        with temporary_folder(self.folder) as folder:
            for name, number, blob, size_bytes in rows:
                self._copies.fetch(blob, size_bytes, folder / "file")
                yield name, number, folder / "file"

    def sweep(self) -> None:
        """Remove objects that have had no name for 6 h, and partial files of the cache."""
        self._copies.sweep()
        old = time.time() - _ORPHANED_AFTER_S
        stored = [blob for blob, modified in self._copies.stored() if modified < old]
        with self._replica.engine.connect() as connection:  # after the listing, to keep files named since then
            named = set(connection.execute(sa.select(maps_table.c.blob)).scalars())
            named |= set(connection.execute(sa.select(map_versions_table.c.blob)).scalars())
        for blob in stored:
            if blob not in named:
                self._copies.remove(blob)


class _Change:
    """A transaction of the catalogue, at its revision."""

    def __init__(self, connection: sa.Connection, revision: int) -> None:
        self._connection, self._revision = connection, revision

    def present(self, name: str) -> MapFile | None:
        """The present file of a name; None if no map has it."""
        c = maps_table.c
        wanted = sa.select(c.blob, c.size_bytes, c.modified, c.revision, c.map_id, c.version).where(c.name == name)
        row = self._connection.execute(wanted.where(c.blob.is_not(None))).first()
        return None if row is None else _present(*row)

    def versions(self, name: str) -> list[MapFile]:
        """The files that were replaced under a name, the last replaced first."""
        c = map_versions_table.c
        wanted = sa.select(c.blob, c.size_bytes, c.map_id, c.version).where(c.name == name).order_by(c.number)
        return [_replaced(*row) for row in self._connection.execute(wanted)]

    def arrange(self, name: str, present: MapFile | None, versions: Sequence[MapFile]) -> None:
        """Set a name's file (None deletes it), and keep the first :data:`KEPT_VERSIONS` of ``versions``."""
        self._connection.execute(map_versions_table.delete().where(map_versions_table.c.name == name))
        for number, file in enumerate(versions[:KEPT_VERSIONS], start=1):
            self._connection.execute(map_versions_table.insert().values(name=name, number=number, **_columns(file)))
        values: dict[str, object] = {"modified": time.time(), "revision": self._revision}
        values |= {"blob": None} if present is None else _columns(present)
        changed = self._connection.execute(maps_table.update().where(maps_table.c.name == name).values(**values))
        if not changed.rowcount:
            self._connection.execute(maps_table.insert().values(name=name, **values))


def _present(blob: str, size_bytes: int, modified: float, revision: int, map_id: str, version: int) -> MapFile:
    """Present file of a map, from its row; its signature changes with the revision."""
    return MapFile(blob, size_bytes, modified, (revision, int(modified * 1e9), size_bytes), map_id, version)


def _replaced(blob: str, size_bytes: int, map_id: str, version: int) -> MapFile:
    """File of a replaced map, or of one without a name, from its row; the time is unknown."""
    return MapFile(blob, size_bytes, 0.0, (0, 0, size_bytes), map_id, version)


def _columns(file: MapFile) -> dict[str, object]:
    """The columns of a file in the tables of maps and versions, by name."""
    return {"blob": file.key, "size_bytes": file.size_bytes, "map_id": file.map_id, "version": file.version}
