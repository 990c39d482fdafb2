"""The library of maps: read, publish, replace and restore maps by name, over any catalogue."""

import filecmp
import math
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from uuid import uuid4

from rholoc.disk import replace_file
from rholoc.errors import Conflict, InvalidMap, MissingObject, UnknownMap
from rholoc.library.map_cache import MapCache, Signature
from rholoc.library.map_catalogue import MapCatalogue, MapFile
from rholoc.library.map_folder import MapFolder
from rholoc.maps.formats.rho_file import SUFFIX, MapOutline, load_map, load_outline, map_to_bytes
from rholoc.maps.info import MapInfo
from rholoc.maps.map import Map
from rholoc.maps.name_rules import check_map_name, some_of

_PIECE_BYTES = 2**20


class MapLibrary:
    """Maps by name. Safe to share between threads and processes.

    A map returned by :meth:`get` does not change when it is replaced or deleted. Methods that need
    a map raise InvalidName if its name is not valid, and UnknownMap if no map has it.

    Args:
        maps: the folder of the maps, or another catalogue of them.
        cache_bytes: memory for cached maps, including data derived from them.
    """

    def __init__(self, maps: Path | MapCatalogue, cache_bytes: float = math.inf) -> None:
        self._catalogue: MapCatalogue = MapFolder(maps) if isinstance(maps, Path) else maps
        self._cache = MapCache(cache_bytes)
        self._outlines: dict[str, tuple[Signature, MapOutline]] = {}
        self._known_readable: dict[str, Signature] = {}
        self._reading: dict[str, threading.Lock] = {}

    @property
    def folder(self) -> Path:
        """The folder of the maps' files on this machine."""
        return self._catalogue.folder

    def names(self) -> list[str]:
        """The names of all maps, sorted."""
        return self._catalogue.names()

    def readable(self) -> list[str]:
        """Sorted names of readable maps; reads each unchecked file once. Raises StorageUnavailable, StorageFull."""
        names = self.names()
        return names if self._catalogue.holds_only_maps else [name for name in names if self._is_readable(name)]

    def _is_readable(self, name: str) -> bool:
        """Whether a map of the name exists and can be read; remembered until its file is replaced."""
        try:
            signature = self.stat(name).signature
            if self._known_readable.get(name) != signature:
                self.get(name)
                self._known_readable[name] = signature
        except (UnknownMap, InvalidMap):
            return False
        return True

    def stat(self, name: str) -> MapFile:
        """Size, time and signature of a map's present file. Raises InvalidName, UnknownMap."""
        check_map_name(name)
        file = self._catalogue.find(name)
        if file is None:
            self._catalogue.look_again()  # another server may just have published it
            file = self._catalogue.find(name)
        if file is None:
            raise self._unknown(name)
        return file

    def path(self, name: str) -> Path:
        """A map's file on this machine, fetched if necessary.

        Raises:
            InvalidName, UnknownMap: there is no such map.
            StorageUnavailable, StorageFull: it cannot be fetched.
        """
        try:
            return self._catalogue.local(self.stat(name))
        except MissingObject:  # replaced, and removed, since this process last refreshed
            self._catalogue.refresh()
            return self._catalogue.local(self.stat(name))

    def map_id(self, name: str) -> str:
        """A map's id, kept by updates and edits. Raises InvalidName, UnknownMap, InvalidMap, StorageUnavailable."""
        return self.stat(name).map_id or self.outline(name).info.id

    def outline(self, name: str) -> MapOutline:
        """Description and size of a map, from the header of its file.

        Raises:
            InvalidName, UnknownMap: there is no such map.
            InvalidMap: its file is not a map.
            StorageUnavailable: the header cannot be fetched.
        """
        try:
            return self._outline(name, self.stat(name))
        except MissingObject:  # replaced, and removed, since this process last refreshed
            self._catalogue.refresh()
            return self._outline(name, self.stat(name))

    def _outline(self, name: str, file: MapFile) -> MapOutline:
        """Outline of the map in ``file``, cached by name until the file is replaced."""
        known = self._outlines.get(name)
        if known is None or known[0] != file.signature:
            known = self._outlines[name] = (file.signature, self._catalogue.outline(file, name))
        return known[1]

    def stamp(self) -> int | None:
        """Value that changes whenever a map is published, renamed or deleted, by any process; None if unknown."""
        return self._catalogue.stamp()

    def get(self, name: str) -> Map:
        """A map, cached until it is replaced. Reading one does not block others.

        Raises:
            InvalidName, UnknownMap: there is no such map.
            InvalidMap: its file is not a map.
            StorageUnavailable, StorageFull: it cannot be fetched.
        """
        try:
            map_ = self._cache.get(name, self.stat(name).signature)
            if map_ is not None:
                return map_
            with self._reading.setdefault(name, threading.Lock()):
                signature = self.stat(name).signature
                map_ = self._cache.get(name, signature)
                if map_ is None:
                    # If the file has been replaced since the signature was taken, the next call just loads it again.
                    map_ = self._load(name)
                    self._cache.put(name, signature, map_)
                return map_
        except (UnknownMap, InvalidMap):
            self._cache.drop(name)
            raise

    def _load(self, name: str) -> Map:
        """The map in the file of that name. Raises as :meth:`get`."""
        path = self.path(name)
        try:
            return load_map(path, f"{name}{SUFFIX}")
        except UnknownMap as error:  # it was deleted meanwhile
            raise self._unknown(name) from error

    def is_known(self, name: str) -> bool:
        """Whether a map of this name is in the memory cache; accesses neither disk nor database."""
        return self._cache.has(name)

    def is_here(self, name: str) -> bool:
        """Whether :meth:`get` needs no fetch; False for an unknown name."""
        file = self._catalogue.find(name)
        if file is None:
            return False
        return self._cache.get(name, file.signature) is not None or self._catalogue.is_here(file)

    def keeps(self, name: str, map_: Map) -> bool:
        """Whether ``map_`` is the cached object of that name, neither replaced nor evicted."""
        return self._cache.holds(name, map_)

    def put(self, name: str, map_: Map) -> None:
        """Publish a map under a name; the replaced one is kept as a version.

        Raises:
            InvalidMap, InvalidInput, StorageUnavailable, StorageFull: nothing was replaced.
        """
        self._put(name, map_to_bytes(map_), lambda _: map_)

    def put_file(self, name: str, source: Path | bytes, check: Callable[[Map], None] = lambda _: None) -> Map:
        """Publish a ``.rho`` file under a name, and return the map; the replaced one is kept as a version.

        Args:
            name: the map's.
            source: the file, or its content.
            check: raises if the map must not be published.

        Raises:
            InvalidMap, InvalidInput, StorageUnavailable, StorageFull, errors of ``check``: nothing was replaced.
        """
        called = check_map_name(name) + SUFFIX

        def read(arrived: Path) -> Map:
            map_ = load_map(arrived, called)
            check(map_)
            return map_

        return self._put(name, source if isinstance(source, bytes) else _pieces(source), read)

    def replace(self, name: str, next_version: Map) -> None:
        """Publish the next version of a map, with its number plus one; does nothing if it is published already.

        Raises:
            Conflict, UnknownMap: the map has changed since, or is gone; nothing was replaced.
            InvalidName, InvalidMap, InvalidInput, StorageUnavailable, StorageFull: nothing was replaced.
        """
        self._catalogue.refresh()
        file, present = self.stat(name), self.get(name).info
        if present == next_version.info:
            return
        if (present.id, present.version) != (next_version.info.id, next_version.info.version - 1):
            raise _changed(name)
        self._put(name, map_to_bytes(next_version), lambda _: next_version, instead_of=file)

    def furnish(self, name: str, before: Path, furnished: Path) -> None:
        """Replace a map's file by ``furnished``, the same map with more to show, without keeping a version.

        Nothing happens if the library's map is no longer that of the file ``before``.

        Raises:
            InvalidMap, InvalidInput, StorageUnavailable, StorageFull: nothing was replaced.
        """
        self._catalogue.refresh()
        with suppress(UnknownMap, Conflict):
            file = self.stat(name)
            if self.outline(name).info == load_outline(before).info:
                self._put(name, _pieces(furnished), load_map, instead_of=file, keeps_replaced=False)

    def _put(
        self,
        name: str,
        data: bytes | Iterator[bytes],
        read: Callable[[Path], Map],
        instead_of: MapFile | None = None,
        keeps_replaced: bool = True,
    ) -> Map:
        """Publish a file under a name, after ``read`` has parsed it; the map's present content again changes nothing.

        Args:
            name: the map's.
            data: the file's content.
            read: returns the map in a file, or raises.
            instead_of: the file that it must replace; None for any.
            keeps_replaced: whether the replaced file is kept as a version.

        Raises:
            Conflict: the present file is not ``instead_of``.
            InvalidMap, InvalidInput, StorageUnavailable, StorageFull: nothing was replaced.
        """
        called = check_map_name(name) + SUFFIX
        self._catalogue.make_room()
        arrived = self.folder / f".{uuid4().hex}.upload"
        replace_file(arrived, data, called=called)
        try:
            map_ = read(arrived)
            file = None if self.holds(name, arrived) else self._catalogue.store(arrived, map_)
            with self._catalogue.changing(map_) as change:
                present = change.present(name)
                if instead_of is not None and present != instead_of:
                    raise _changed(name)
                if file is not None:
                    replaced = [present] if present is not None and keeps_replaced else []
                    change.arrange(name, file, [*replaced, *change.versions(name)])
        finally:
            arrived.unlink(missing_ok=True)
        return map_

    def holds(self, name: str, file: Path) -> bool:
        """Whether a map has the same content as a file: by their checksums, or byte by byte if one of them is no map.

        False if no map has the name. Raises InvalidName, StorageUnavailable, StorageFull.
        """
        try:
            return self.outline(name).checksum == load_outline(file).checksum
        except UnknownMap:
            return False
        except InvalidMap:
            return filecmp.cmp(self.path(name), file, shallow=False)

    def previous(self, name: str) -> MapInfo | None:
        """Description of the last map replaced under a name; None if none is kept or readable. Raises InvalidName."""
        check_map_name(name)
        return self._infos(name, self._catalogue.versions(name)[:1]).get(1)

    def versions(self, name: str) -> dict[int, MapInfo]:
        """Descriptions of the maps replaced under a name by number, 1 the last; unreadable ones are left out. Raises
        InvalidName.
        """
        check_map_name(name)
        return self._infos(name, self._catalogue.versions(name))

    def _infos(self, name: str, files: Sequence[MapFile]) -> dict[int, MapInfo]:
        """Descriptions of readable files by their number, which counts from 1."""
        found = {}
        for number, file in enumerate(files, start=1):
            with suppress(InvalidMap, MissingObject):
                found[number] = self._catalogue.outline(file, name).info
        return found

    def version_path(self, name: str, number: int) -> Path:
        """File, on this machine, of a map replaced under a name, by its number in :meth:`versions`.

        Raises:
            Conflict: it is not kept.
            StorageUnavailable, StorageFull: it cannot be fetched.
        """
        return self._catalogue.local(self._version(name, number, self._catalogue.versions(name)))

    def restore(self, name: str, number: int = 1) -> None:
        """Restore a replaced map by its number in :meth:`versions`.

        The present map becomes a version: restoring number 1 twice changes nothing.

        Raises:
            InvalidName, UnknownMap, Conflict: there is no such map, it replaced none, or that is no longer kept.
            InvalidMap: the one that was replaced cannot be read; nothing was changed.
            StorageUnavailable, StorageFull: nothing was changed.
        """
        self.stat(name)
        wanted = self._version(name, number, self._catalogue.versions(name))
        load_map(self._catalogue.local(wanted), f"The map before {name}")
        with self._catalogue.changing() as change:
            present, kept = change.present(name), change.versions(name)
            if present is None:
                raise self._unknown(name)
            if self._version(name, number, kept) != wanted:
                raise _changed(name)
            change.arrange(name, wanted, [present, *(file for file in kept if file != wanted)])

    def delete(self, name: str) -> None:
        """Delete a map and its versions.

        Raises:
            InvalidName, UnknownMap: there is no such map.
            StorageUnavailable, StorageFull: nothing was deleted.
        """
        self.stat(name)
        with self._catalogue.changing() as change:
            if change.present(name) is None:
                raise self._unknown(name)
            change.arrange(name, None, [])
        self._cache.drop(name)

    def rename(self, name: str, new_name: str) -> None:
        """Rename a map and its versions.

        Raises:
            InvalidName, UnknownMap: a name is not valid, or there is no such map.
            Conflict, StorageUnavailable, StorageFull: a map has the new name, or it fails; nothing was renamed.
        """
        check_map_name(new_name)
        self.stat(name)
        with self._catalogue.changing() as change:
            present, kept = change.present(name), change.versions(name)
            if present is None:
                raise self._unknown(name)
            if change.present(new_name) is not None:
                raise Conflict(f"There is already a map {new_name}.", "Choose another name, or delete that map first.")
            change.arrange(name, None, [])
            change.arrange(new_name, present, kept)
        self._cache.drop(name)

    def snapshot(self) -> Iterator[tuple[str, int, Path]]:
        """Consistent snapshot of all maps' files, earlier versions included, see :meth:`MapCatalogue.snapshot`. Raises
        MissingObject, StorageUnavailable, StorageFull.
        """
        return self._catalogue.snapshot()

    def sweep(self) -> None:
        """Remove files without a name; complete an interrupted change. Raises StorageUnavailable, SQLAlchemyError."""
        self._catalogue.sweep()

    def _version(self, name: str, number: int, versions: Sequence[MapFile]) -> MapFile:
        """The file with ``number``, from 1, of ``versions``, those of ``name``. Raises Conflict if there is none."""
        if 1 <= number <= len(versions):
            return versions[number - 1]
        if number == 1:
            raise Conflict(f"The map {name} has not replaced another.", "There is nothing to restore.")
        raise Conflict(f"The map {name} keeps no version {number}.", "Its versions are listed by number.")

    def _unknown(self, name: str) -> UnknownMap:
        """Error for a name that no map has; its hint lists some that maps have."""
        names = self.names()
        return UnknownMap(
            f"There is no map {name}.", f"There are: {some_of(names)}." if names else "There are none yet."
        )


def _changed(name: str) -> Conflict:
    """Error for a map that another process has changed."""
    return Conflict(
        f"The map {name} was changed in the meantime.", "Try again: the change will start from the new one."
    )


def _pieces(path: Path) -> Iterator[bytes]:
    """Iterate over a file's content in pieces of 1 MiB. Raises InvalidMap if it cannot be read."""
    try:
        with path.open("rb") as file:
            while piece := file.read(_PIECE_BYTES):
                yield piece
    except OSError as error:
        raise InvalidMap(f"{path.name} cannot be read: {error.strerror}.") from error
