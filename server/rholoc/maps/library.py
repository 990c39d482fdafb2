"""The maps in a folder, by name."""

from __future__ import annotations

import contextlib
import math
import os
import re
import stat
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from uuid import uuid4

from rholoc.errors import Conflict, InvalidInput, InvalidMap, InvalidName, RholocError, UnknownMap
from rholoc.maps.documents import Documents
from rholoc.maps.files import replace_file
from rholoc.maps.formats.rho_file import SUFFIX, MapOutline, load_info, load_map, load_outline, map_to_bytes
from rholoc.maps.info import MapInfo
from rholoc.maps.map import Map
from rholoc.maps.map_cache import MapCache, Signature

_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9._-]{0,63}")
_NAMES_SHOWN = 5
_PIECE_BYTES = 2**20
_ALL = "all"
_PREVIOUS = ".previous"  # the folder within a library's that keeps the maps that were replaced
KEPT_VERSIONS = 5  # of each map that was replaced


def is_name(name: str) -> bool:
    """Whether maps and cameras may have this name: 1–64 letters, digits, ``.``, ``_``, ``-``; no ``.``, ``-`` first."""
    return _NAME.fullmatch(name) is not None


def check_name(name: str, what: str) -> str:
    """The name, if it is valid for a ``what``.

    Raises:
        InvalidName: it is not.
    """
    if not is_name(name):
        shown = name if len(name) <= 64 else name[:61] + "…"
        raise InvalidName(
            f"{shown!r} is not a valid {what} name.",
            "Use 1 to 64 letters, digits, '.', '_' and '-', the first a letter, a digit or '_'.",
        )
    return name


def some_of(names: Sequence[str]) -> str:
    """The first few names, for people."""
    return ", ".join(names[:_NAMES_SHOWN]) + (", …" if len(names) > _NAMES_SHOWN else "")


def stored_names(files: Documents, suffix: str) -> list[str]:
    """The names of what is kept in files called a name and ``suffix``, sorted."""
    names = [file.removesuffix(suffix) for file in files.names() if file.endswith(suffix)]
    return sorted(name for name in names if is_name(name))


def check_map_name(name: str) -> str:
    """The name, if it is valid for a map: not ``all``, which means all maps where several can be named.

    Raises:
        InvalidName: it is not.
    """
    if name == _ALL:
        raise InvalidName(f"A map cannot be named {name}: that means all maps.", "Choose another name.")
    return check_name(name, "map")


@dataclass(frozen=True)
class MapStat:
    """What the file system says about a map.

    Attributes:
        name: the map's name.
        size_bytes: the file's size.
        modified: seconds since 1970, UTC.
        signature: changes whenever the file is replaced.
    """

    name: str
    size_bytes: int
    modified: float
    signature: Signature


class MapLibrary:
    """Maps as ``NAME.rho`` in one folder; safe to share between threads, and between processes except for renaming.

    A map that :meth:`get` returned is unaffected when its file is replaced or deleted; the next :meth:`get` sees that.

    Args:
        folder: of the maps.
        cache_bytes: how much memory cached maps may take, including what is derived from them.
    """

    def __init__(self, folder: Path, cache_bytes: float = math.inf) -> None:
        self.folder = folder
        self._cache = MapCache(cache_bytes)
        self._outlines: dict[str, tuple[Signature, MapOutline]] = {}
        self._known_readable: dict[str, Signature] = {}
        self._lock = threading.RLock()  # held while the folder is changed
        self._reading: dict[str, threading.Lock] = {}

    def names(self) -> list[str]:
        """The names of all maps, sorted; empty if the folder does not exist."""
        files = [file for file in self.folder.glob(f"*{SUFFIX}") if file.is_file()]
        return sorted(file.stem for file in files if is_name(file.stem) and file.stem != _ALL)

    def readable(self) -> list[str]:
        """The names, sorted, of the maps that can be read; each file is read once to find out."""
        return [name for name in self.names() if self._is_readable(name)]

    def _is_readable(self, name: str) -> bool:
        try:
            signature = self.stat(name).signature
            if self._known_readable.get(name) != signature:
                self.get(name)
                self._known_readable[name] = signature
        except (UnknownMap, InvalidMap):
            return False
        return True

    def path(self, name: str) -> Path:
        """The path for a map of that name, whether or not it exists.

        Raises:
            InvalidName: it is not a valid name.
        """
        return self.folder / (check_map_name(name) + SUFFIX)

    def stat(self, name: str) -> MapStat:
        """Size, time and signature of a map's file.

        Raises:
            InvalidName: it is not a name.
            UnknownMap: there is no such map.
        """
        path = self.path(name)
        try:
            status = path.stat()
        except FileNotFoundError as error:
            raise self._unknown(name) from error
        if not stat.S_ISREG(status.st_mode):
            raise self._unknown(name)
        return MapStat(name, status.st_size, status.st_mtime, (status.st_ino, status.st_mtime_ns, status.st_size))

    def map_id(self, name: str) -> str:
        """The id of the map of that name, which all its versions have; the map itself is not read.

        Raises:
            InvalidName: it is not a name.
            UnknownMap: there is no such map.
            InvalidMap: its file is not a map.
        """
        self.stat(name)
        return load_info(self.path(name)).id

    def outline(self, name: str) -> MapOutline:
        """Description and size of the map of that name, by the header of its file; the map itself is not read.

        Raises:
            InvalidName: it is not a name.
            UnknownMap: there is no such map.
            InvalidMap: its file is not a map.
        """
        signature = self.stat(name).signature
        known = self._outlines.get(name)
        if known is None or known[0] != signature:
            known = self._outlines[name] = (signature, load_outline(self.path(name)))
        return known[1]

    def stamp(self) -> int | None:
        """Changes whenever a map is published, renamed or deleted, by any process; None where that is not known."""
        try:
            return self.folder.stat().st_mtime_ns
        except OSError:
            return None

    def get(self, name: str) -> Map:
        """The map of that name, from memory unless its file was replaced. Reading one does not block others.

        Raises:
            InvalidName: it is not a name.
            UnknownMap: there is no such map.
            InvalidMap: its file is not a map.
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
        path = self.path(name)
        try:
            return load_map(path, f"{name}{SUFFIX}")
        except UnknownMap as error:  # it was deleted meanwhile
            raise self._unknown(name) from error

    def is_known(self, name: str) -> bool:
        """Whether a map of this name was seen lately, judged by what is in memory: no disk is asked, no database."""
        return self._cache.has(name)

    def is_here(self, name: str) -> bool:
        """Whether :meth:`get` would need nothing but memory and this machine's disk."""
        return True

    def keeps(self, name: str, map_: Map) -> bool:
        """Whether this very object is the cached map of that name: neither replaced nor evicted."""
        return self._cache.holds(name, map_)

    def put(self, name: str, map_: Map) -> None:
        """Store a map under a name, replacing any of that name.

        Raises:
            InvalidName, InvalidMap, StorageFull, InvalidInput: nothing was replaced.
        """
        self._put(name, map_to_bytes(map_), lambda _: map_)

    def put_file(self, name: str, source: Path | bytes, check: Callable[[Map], None] = lambda _: None) -> Map:
        """Store the content of a ``.rho`` file under a name, replacing any map of that name; returns the map.

        Args:
            name: the map's.
            source: the file, or its content.
            check: raises if the map must not be stored.

        Raises:
            InvalidName, InvalidMap, StorageFull, InvalidInput, and what ``check`` raises: nothing was replaced.
        """

        called = check_map_name(name) + SUFFIX

        def read(arrived: Path) -> Map:
            map_ = load_map(arrived, called)
            check(map_)
            return map_

        return self._put(name, source if isinstance(source, bytes) else _pieces(source), read)

    def _put(self, name: str, data: bytes | Iterator[bytes], read: Callable[[Path], Map]) -> Map:
        """Store a file under a name, once ``read`` has found a map in it; keep the map that it replaces."""
        called = check_map_name(name) + SUFFIX
        self._make_folder()
        arrived = self.folder / f".{uuid4().hex}.upload"  # in the same folder, so that it can be renamed into place
        replace_file(arrived, data, called=called)
        try:
            map_ = read(arrived)
            if not self._holds_same(name, arrived):
                self._publish(name, arrived, map_)
        finally:
            arrived.unlink(missing_ok=True)
        return map_

    def _holds_same(self, name: str, arrived: Path) -> bool:
        """Whether the file of the map of a name has the same content: storing it again makes no version."""
        try:
            return self.outline(name).checksum == load_outline(arrived).checksum
        except RholocError:  # there is none, or it cannot be read
            return False

    def _publish(self, name: str, arrived: Path, map_: Map) -> None:
        """Put a file that holds a map in the place of the map of a name, which is kept."""
        with self._lock:
            self._keep_previous(name)
            arrived.replace(self.path(name))

    def replace(self, name: str, next_version: Map) -> None:
        """Store the next version of a map in place of its predecessor; do nothing if it is already there.

        Raises:
            InvalidName: it is not a valid name.
            UnknownMap: the map no longer exists.
            Conflict: the map has changed since, and another update would be lost. Nothing was replaced.
            InvalidMap, StorageFull, InvalidInput: as :meth:`put`; nothing was replaced.
        """
        with self._lock:
            present = self.get(name).info
            if present == next_version.info:
                return
            if (present.id, present.version) != (next_version.info.id, next_version.info.version - 1):
                raise changed(name)
            self.put(name, next_version)

    def previous(self, name: str) -> MapInfo | None:
        """The description of the map that was last replaced under a name; None if there is none to restore.

        Raises:
            InvalidName: it is not a valid name.
        """
        return self.versions(name).get(1)

    def versions(self, name: str) -> dict[int, MapInfo]:
        """The descriptions of the maps that were replaced under a name, by number: 1 was replaced last.

        Raises:
            InvalidName: it is not a name.
        """
        found = {}
        for number in range(1, KEPT_VERSIONS + 1):
            with contextlib.suppress(InvalidMap):
                found[number] = load_info(self.previous_path(name, number))
        return found

    def restore(self, name: str, number: int = 1) -> None:
        """Restore a map that was replaced, by its number in :meth:`versions`.

        The present one is kept in turn: restoring number 1 twice changes nothing.

        Raises:
            InvalidName: it is not a valid name.
            UnknownMap: there is no such map.
            Conflict: none was replaced, or it is no longer kept.
            InvalidMap: the one that was replaced cannot be read; nothing was changed.
        """
        with self._lock:
            path, previous = self.path(name), self.previous_path(name, number)
            self.stat(name)
            if not previous.is_file():
                raise no_version(name, number)
            load_map(previous, f"The map before {name}")
            present = previous.with_name(f".{uuid4().hex}.present")
            _link(path, present)
            previous.replace(path)
            self._make_room(name, number)
            present.replace(self.previous_path(name))

    def previous_path(self, name: str, number: int = 1) -> Path:
        """The file of a map that was replaced under a name, whether there is one of that number or not."""
        path = self.folder / _PREVIOUS / self.path(name).name
        return path if number == 1 else path.with_name(f"{path.name}.{number}")

    def _previous_paths(self, name: str) -> list[Path]:
        """The files of all replaced maps that are kept."""
        paths = [self.previous_path(name, number) for number in range(1, KEPT_VERSIONS + 1)]
        return [path for path in paths if path.is_file()]

    def _keep_previous(self, name: str) -> None:
        """Keep the map that is about to be replaced, if there is one, as number 1."""
        path, previous = self.path(name), self.previous_path(name)
        if not path.is_file():
            return
        previous.parent.mkdir(exist_ok=True)
        arrived = previous.with_name(f".{uuid4().hex}.kept")
        _link(path, arrived)
        self._make_room(name, KEPT_VERSIONS)
        arrived.replace(previous)

    def _make_room(self, name: str, last: int) -> None:
        """Free number 1 by moving numbers up by one, as far as the first free one; ``last`` is dropped if none is."""
        free = next((n for n in range(1, last) if not self.previous_path(name, n).is_file()), last)
        for number in range(free, 1, -1):
            self.previous_path(name, number - 1).replace(self.previous_path(name, number))

    def delete(self, name: str) -> None:
        """Delete a map, and those that it replaced.

        Raises:
            InvalidName: it is not a name.
            UnknownMap: there is no such map.
        """
        with self._lock:
            self._cache.drop(name)
            try:
                self.path(name).unlink()
            except FileNotFoundError as error:
                raise self._unknown(name) from error
            for path in self._previous_paths(name):
                path.unlink(missing_ok=True)

    def rename(self, name: str, new_name: str) -> None:
        """Give a map another name.

        Raises:
            InvalidName: one of them is not a name.
            UnknownMap: there is no such map.
            Conflict: there is a map of the new name.
        """
        with self._lock:
            old, new = self.path(name), self.path(new_name)
            if not old.is_file():
                raise self._unknown(name)
            if new.exists():
                raise name_taken(new_name)
            old.rename(new)
            for path in self._previous_paths(new_name):
                path.unlink(missing_ok=True)
            for path in self._previous_paths(name):
                path.rename(path.with_name(new_name + path.name.removeprefix(name)))
            self._cache.drop(name)

    def sweep(self) -> None:
        """Remove what is stored and belongs to no map: here, nothing."""

    def _make_folder(self) -> None:
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InvalidInput(
                f"The folder {self.folder.name} cannot be created: {error.strerror}.", "Check the map folder."
            ) from error

    def _unknown(self, name: str) -> UnknownMap:
        names = self.names()
        return UnknownMap(
            f"There is no map {name}.", f"There are: {some_of(names)}." if names else "There are none yet."
        )


def changed(name: str) -> Conflict:
    """The error for a change that started from a map that is no longer there."""
    return Conflict(
        f"The map {name} was changed in the meantime.", "Try again: the change will start from the new one."
    )


def no_version(name: str, number: int) -> Conflict:
    """The error for a version that is not kept."""
    if number == 1:
        return Conflict(f"The map {name} has not replaced another.", "There is nothing to restore.")
    return Conflict(f"The map {name} keeps no version {number}.", "Its versions are listed by number.")


def name_taken(name: str) -> Conflict:
    """The error for a name that a map has already."""
    return Conflict(f"There is already a map {name}.", "Choose another name, or delete that map first.")


def _link(path: Path, other: Path) -> None:
    """Give a file a second name; on file systems without hard links, copy it.

    Raises:
        StorageFull: the disk is full.
    """
    try:
        os.link(path, other)
    except OSError:
        replace_file(other, path.read_bytes(), called=path.name)


def _pieces(path: Path) -> Iterator[bytes]:
    """A file's content, never all of it at once."""
    try:
        with path.open("rb") as file:
            while piece := file.read(_PIECE_BYTES):
                yield piece
    except OSError as error:
        raise InvalidMap(f"{path.name} cannot be read: {error.strerror}.") from error
