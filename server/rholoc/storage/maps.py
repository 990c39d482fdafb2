"""The maps that several servers share: files in object storage, which of them has which name in the catalogue."""

from __future__ import annotations

import copy
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

import sqlalchemy as sa
from sqlalchemy.exc import SQLAlchemyError

from rholoc.errors import InvalidMap
from rholoc.maps import Map, MapInfo, MapLibrary, MapStat, check_map_name, load_map
from rholoc.maps.formats.rho_file import LENGTH_BYTES, MapOutline, header_bytes, load_info, outline_of
from rholoc.maps.library import KEPT_VERSIONS, changed, name_taken, no_version
from rholoc.storage.copies import Copies
from rholoc.storage.objects import MissingObject
from rholoc.storage.replica import MapRow, Replica
from rholoc.storage.tables import map_versions_table, maps_table

_ORPHANED_AFTER_S = 6 * 3600.0  # an object that the catalogue does not name may be on its way into it

WithPublishing = Callable[[sa.Connection, Map], None]


@dataclass(frozen=True)
class _Version:
    """A map's file, wherever it stands: under the name, or replaced."""

    blob: str
    size_bytes: int
    map_id: str
    version: int


@dataclass(frozen=True)
class StoredMap:
    """The file of a map in the storage.

    Attributes:
        name: the map's.
        number: 0 of the map of that name; of those that it replaced as in :meth:`MapLibrary.versions`.
        blob: the object's name.
        size_bytes: its size.
    """

    name: str
    number: int
    blob: str
    size_bytes: int


class SharedMapLibrary(MapLibrary):
    """Maps of which the catalogue knows the names and the storage holds the files.

    It does what :class:`rholoc.maps.MapLibrary` does, for all servers and workers that share the two. Files never
    change once they are stored: a change of a map is one transaction of the catalogue, whole or not at all.

    Args:
        replica: the catalogue.
        copies: the files, as far as they are here.
        cache_bytes: what the maps that are kept in memory may take, with what is derived from them.
    """

    def __init__(self, replica: Replica, copies: Copies, cache_bytes: float) -> None:
        super().__init__(copies.folder, cache_bytes)
        self._replica = replica
        self._copies = copies
        self._with_publishing: WithPublishing = lambda connection, map_: None
        self._acts_on_publishing = False

    def publishing_with(self, act: WithPublishing) -> SharedMapLibrary:
        """This library, which does something more in each transaction that publishes a map, or does neither."""
        library = copy.copy(self)
        library._with_publishing, library._acts_on_publishing = act, True
        return library

    def names(self) -> list[str]:
        """The names of all maps, sorted."""
        return sorted(self._replica.maps)

    def is_known(self, name: str) -> bool:
        """As :meth:`MapLibrary.is_known`, by the catalogue as it was last seen."""
        return name in self._replica.maps

    def is_here(self, name: str) -> bool:
        """As :meth:`MapLibrary.is_here`: in memory, or copied to this disk."""
        row = self._replica.maps.get(name)
        if row is None:
            return False
        return self._cache.get(name, self.stat(name).signature) is not None or self._copies.has(row.blob)

    def path(self, name: str) -> Path:
        """A copy of the map's file, on this machine; it is fetched where there is none.

        Raises:
            InvalidName: it is not a name.
            UnknownMap: there is no such map.
            StorageUnavailable, StorageFull: it cannot be fetched.
        """
        row = self._row(name)
        try:
            return self._copies.path(row.blob, row.size_bytes)
        except MissingObject:  # it was replaced, and the file removed, before this server heard of it
            self._replica.refresh()
            row = self._row(name)
            return self._copies.path(row.blob, row.size_bytes)

    def stored(self, connection: sa.Connection) -> list[StoredMap]:
        """The files of all maps, and of those that they replaced, as a transaction sees them."""
        present = _selected(maps_table).add_columns(maps_table.c.name, sa.literal(0).label("number"))
        replaced = _selected(map_versions_table).add_columns(map_versions_table.c.name, map_versions_table.c.number)
        found = []
        for wanted in (present.where(maps_table.c.blob.is_not(None)), replaced):
            rows = connection.execute(wanted).mappings()
            found += [StoredMap(row["name"], row["number"], row["blob"], row["size_bytes"]) for row in rows]
        return found

    def fetch(self, stored: StoredMap, target: Path) -> None:
        """Copy the file of a map from the storage.

        Raises:
            MissingObject: it was removed since, as the map was replaced often.
            StorageUnavailable, StorageFull: it cannot be fetched.
        """
        self._copies.fetch(stored.blob, stored.size_bytes, target)

    def stat(self, name: str) -> MapStat:
        """Size, time and signature of a map's file.

        Raises:
            InvalidName: it is not a name.
            UnknownMap: there is no such map.
        """
        row = self._row(name)
        return MapStat(name, row.size_bytes, row.modified, (row.revision, int(row.modified * 1e9), row.size_bytes))

    def map_id(self, name: str) -> str:
        """As :meth:`MapLibrary.map_id`, without fetching the map."""
        return self._row(name).map_id

    def outline(self, name: str) -> MapOutline:
        """As :meth:`MapLibrary.outline`; of a file that is not here only the header is fetched.

        Raises:
            StorageUnavailable: it cannot be fetched.
        """
        row, signature = self._row(name), self.stat(name).signature
        known = self._outlines.get(name)
        if known is not None and known[0] == signature:
            return known[1]
        if self._copies.has(row.blob):
            return super().outline(name)
        length = header_bytes(self._copies.read(row.blob, 0, LENGTH_BYTES), name)
        found = outline_of(self._copies.read(row.blob, LENGTH_BYTES, length), name)
        self._outlines[name] = (signature, found)
        return found

    def stamp(self) -> int:
        """As :meth:`MapLibrary.stamp`: the catalogue's revision."""
        return self._replica.revision

    def replace(self, name: str, next_version: Map) -> None:
        """As :meth:`MapLibrary.replace`; what another server published meanwhile is seen, too."""
        with suppress(SQLAlchemyError):
            self._replica.refresh()
        present = self.get(name).info
        if present == next_version.info:
            return
        expected = (next_version.info.id, next_version.info.version - 1)
        if (present.id, present.version) != expected:
            raise changed(name)

        def check(connection: sa.Connection, map_: Map) -> None:
            stands = _present(connection, name)
            if stands is None or (stands.map_id, stands.version) != expected:
                raise changed(name)
            self._with_publishing(connection, map_)

        self.publishing_with(check).put(name, next_version)

    def previous(self, name: str) -> MapInfo | None:
        """As :meth:`MapLibrary.previous`."""
        return self._infos(name, most=1).get(1)

    def versions(self, name: str) -> dict[int, MapInfo]:
        """As :meth:`MapLibrary.versions`."""
        return self._infos(name, most=KEPT_VERSIONS)

    def restore(self, name: str, number: int = 1) -> None:
        """As :meth:`MapLibrary.restore`."""
        self.stat(name)
        with self._replica.engine.connect() as connection:
            wanted = _versions(connection, name).get(number)
        if wanted is not None:
            self._check_readable(name, wanted)
        with self._replica.changing() as (connection, revision):
            present, kept = _present(connection, name), _versions(connection, name)
            if present is None:
                raise self._unknown(name)
            if wanted is None or kept.get(number) != wanted:
                raise no_version(name, number)
            del kept[number]
            _set_versions(connection, name, [present, *kept.values()])
            _set_map(connection, name, wanted, revision)

    def delete(self, name: str) -> None:
        """As :meth:`MapLibrary.delete`."""
        self.stat(name)
        with self._replica.changing() as (connection, revision):
            if _present(connection, name) is None:
                raise self._unknown(name)
            _set_versions(connection, name, [])
            _set_map(connection, name, None, revision)
        self._cache.drop(name)

    def rename(self, name: str, new_name: str) -> None:
        """As :meth:`MapLibrary.rename`."""
        check_map_name(new_name)
        self.stat(name)
        with self._replica.changing() as (connection, revision):
            present, kept = _present(connection, name), _versions(connection, name)
            if present is None:
                raise self._unknown(name)
            if _present(connection, new_name) is not None:
                raise name_taken(new_name)
            _set_versions(connection, name, [])
            _set_versions(connection, new_name, list(kept.values()))
            _set_map(connection, name, None, revision)
            _set_map(connection, new_name, present, revision)
        self._cache.drop(name)

    def sweep(self) -> None:
        """Remove the files from the storage that the catalogue has not named for hours.

        Raises:
            SQLAlchemyError, StorageUnavailable: it is done the next time.
        """
        self._copies.sweep()
        old = time.time() - _ORPHANED_AFTER_S
        stored = [blob for blob, modified in self._copies.stored() if modified < old]
        with self._replica.engine.connect() as connection:  # after the listing: what was named since then is kept
            named = set(connection.execute(sa.select(maps_table.c.blob)).scalars())
            named |= set(connection.execute(sa.select(map_versions_table.c.blob)).scalars())
        for blob in stored:
            if blob not in named:
                self._copies.remove(blob)

    def prepare(self, before: MapRow, after: MapRow) -> None:
        """Fetch a map's new file where the old one was in use here, so that the next request need not wait for it.

        Raises:
            StorageUnavailable, StorageFull: it cannot be fetched.
        """
        if not self.is_prepared(before, after):
            self._copies.path(after.blob, after.size_bytes)

    def is_prepared(self, before: MapRow, after: MapRow) -> bool:
        """Whether :meth:`prepare` would fetch nothing."""
        return self._copies.has(after.blob) or not self._copies.has(before.blob)

    def readable(self) -> list[str]:
        """The names of all maps: files were checked before the catalogue named them, and none is fetched to do so."""
        return self.names()

    def _make_folder(self) -> None:
        super()._make_folder()
        self._copies.make_room()  # something else may have filled the disk

    def _holds_same(self, name: str, arrived: Path) -> bool:
        return not self._acts_on_publishing and super()._holds_same(name, arrived)

    def _publish(self, name: str, arrived: Path, map_: Map) -> None:
        size_bytes = arrived.stat().st_size
        published = _Version(self._copies.store(arrived), size_bytes, map_.info.id, map_.info.version)
        with self._replica.changing() as (connection, revision):
            self._with_publishing(connection, map_)
            present, kept = _present(connection, name), _versions(connection, name)
            if present is not None:
                _set_versions(connection, name, [present, *kept.values()])
            _set_map(connection, name, published, revision)

    def _row(self, name: str) -> MapRow:
        check_map_name(name)
        row = self._replica.maps.get(name)
        if row is None:
            self._replica.look_again()  # another server may have published it just now
            row = self._replica.maps.get(name)
        if row is None:
            raise self._unknown(name)
        return row

    def _infos(self, name: str, most: int) -> dict[int, MapInfo]:
        check_map_name(name)
        with self._replica.engine.connect() as connection:
            kept = _versions(connection, name)
        found = {}
        for number in range(1, most + 1):
            if number in kept:
                with suppress(InvalidMap, MissingObject):
                    found[number] = load_info(self._copies.path(kept[number].blob, kept[number].size_bytes))
        return found

    def _check_readable(self, name: str, version: _Version) -> None:
        load_map(self._copies.path(version.blob, version.size_bytes), f"The map before {name}")


def _present(connection: sa.Connection, name: str) -> _Version | None:
    """The map of a name, None where there is none."""
    row = connection.execute(_selected(maps_table).where(maps_table.c.name == name)).mappings().first()
    return None if row is None or row["blob"] is None else _Version(**row)


def _versions(connection: sa.Connection, name: str) -> dict[int, _Version]:
    """The maps that were replaced under a name, by number."""
    table = map_versions_table
    wanted = _selected(table).add_columns(table.c.number).where(table.c.name == name).order_by(table.c.number)
    rows = [dict(row) for row in connection.execute(wanted).mappings()]
    return {row.pop("number"): _Version(**row) for row in rows}


def _selected(table: sa.Table) -> sa.Select[tuple[str, int, str, int]]:
    return sa.select(table.c.blob, table.c.size_bytes, table.c.map_id, table.c.version)


def _set_versions(connection: sa.Connection, name: str, versions: Sequence[_Version]) -> None:
    """Keep these as the maps that were replaced under a name, the one that was replaced last first."""
    connection.execute(map_versions_table.delete().where(map_versions_table.c.name == name))
    for number, version in enumerate(versions[:KEPT_VERSIONS], start=1):
        connection.execute(map_versions_table.insert().values(name=name, number=number, **asdict(version)))


def _set_map(connection: sa.Connection, name: str, version: _Version | None, revision: int) -> None:
    """Give a name to a map's file; to none where ``version`` is None."""
    values: dict[str, object] = {"modified": time.time(), "revision": revision}
    values |= {"blob": None} if version is None else asdict(version)
    changed = connection.execute(maps_table.update().where(maps_table.c.name == name).values(**values))
    if not changed.rowcount:
        connection.execute(maps_table.insert().values(name=name, **values))
