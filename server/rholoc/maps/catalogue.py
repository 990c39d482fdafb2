"""Which file each map's name stands for: what a catalogue of maps can do, and which names maps may have."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from rholoc.errors import InvalidName
from rholoc.maps.formats.rho_file import MapOutline
from rholoc.maps.map import Map
from rholoc.maps.map_cache import Signature

KEPT_VERSIONS = 5
"""How many replaced maps are kept under each name."""

_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9._-]{0,63}")
_NAMES_SHOWN = 5
_ALL = "all"


def is_name(name: str) -> bool:
    """Whether maps and cameras may have this name: 1–64 letters, digits, ``.``, ``_``, ``-``; no ``.``, ``-`` first."""
    return _NAME.fullmatch(name) is not None


def is_map_name(name: str) -> bool:
    """Whether a map may have this name: not ``all``, which means all maps where several can be named."""
    return is_name(name) and name != _ALL


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


def check_map_name(name: str) -> str:
    """The name, if it is valid for a map.

    Raises:
        InvalidName: it is not.
    """
    if name == _ALL:
        raise InvalidName(f"A map cannot be named {name}: that means all maps.", "Choose another name.")
    return check_name(name, "map")


def some_of(names: Sequence[str]) -> str:
    """The first few names, for people."""
    return ", ".join(names[:_NAMES_SHOWN]) + (", …" if len(names) > _NAMES_SHOWN else "")


@dataclass(frozen=True)
class MapFile:
    """A map's file. Equal ones have the same content.

    Attributes:
        key: by which its catalogue finds it.
        size_bytes: its size.
        modified: when it was published, seconds since 1970, UTC.
        signature: changes whenever another file takes its place.
        map_id, version: of the map; None where they stand in the file alone.
    """

    key: str
    size_bytes: int
    modified: float
    signature: Signature
    map_id: str | None = None
    version: int | None = None


class MapChange(Protocol):
    """A change of a catalogue, made whole or not at all."""

    def present(self, name: str) -> MapFile | None:
        """The file of a name; None if no map has it."""
        ...

    def versions(self, name: str) -> list[MapFile]:
        """The files that were replaced under a name, the last replaced first."""
        ...

    def arrange(self, name: str, present: MapFile | None, versions: Sequence[MapFile]) -> None:
        """Give a name to a file, or to none, and keep the first :data:`KEPT_VERSIONS` of ``versions``."""
        ...


class MapCatalogue(ABC):
    """Which file each map's name stands for, and which it stood for before. Safe to share between threads, processes.

    Attributes:
        holds_only_maps: whether all files were found to be maps before they got a name.
    """

    holds_only_maps = False

    @property
    @abstractmethod
    def folder(self) -> Path:
        """The folder of files on this machine."""

    @abstractmethod
    def names(self) -> list[str]:
        """The names of all maps, sorted."""

    @abstractmethod
    def find(self, name: str) -> MapFile | None:
        """The file of a name; None if no map has it."""

    @abstractmethod
    def versions(self, name: str) -> list[MapFile]:
        """The files that were replaced under a name, the last replaced first."""

    @abstractmethod
    def stamp(self) -> int | None:
        """Changes whenever a map is published, renamed or deleted, by any process; None where that is not known."""

    def refresh(self) -> None:
        """See what other processes have changed, if that can be seen now."""
        return

    def look_again(self) -> None:
        """:meth:`refresh` on a miss, at most a few times a second."""
        return

    def is_here(self, file: MapFile) -> bool:
        """Whether :meth:`local` would need this machine's disk alone."""
        return True

    @abstractmethod
    def local(self, file: MapFile) -> Path:
        """The file on this machine, fetched if necessary.

        Raises:
            MissingObject: it was removed.
            StorageUnavailable, StorageFull: it cannot be fetched.
        """

    @abstractmethod
    def outline(self, file: MapFile, name: str) -> MapOutline:
        """Description and size of a map called ``name``, by the header of its file. No more than that is fetched.

        Raises:
            InvalidMap: the file is not a map.
            StorageUnavailable: the header cannot be fetched.
        """

    @abstractmethod
    def make_room(self) -> None:
        """Make room in :attr:`folder` for a file that arrives. Raises InvalidInput, StorageFull."""

    @abstractmethod
    def store(self, arrived: Path, map_: Map) -> MapFile:
        """Store the file of a map, which has no name yet. Raises StorageUnavailable, StorageFull."""

    @abstractmethod
    def changing(self, published: Map | None = None) -> AbstractContextManager[MapChange]:
        """A change that is made at the end of the block, unless that raises. ``published`` is the map that gets a name.

        Raises:
            StorageFull, OSError, SQLAlchemyError: nothing was changed.
        """

    @abstractmethod
    def snapshot(self) -> Iterator[tuple[str, int, Path]]:
        """Names, numbers and copies of all files of one moment. A copy may be gone when the next one is asked for.

        The number is 0 for the map of that name, from 1 for those that it replaced, the last replaced first.

        Raises:
            MissingObject: a file was removed meanwhile.
            StorageUnavailable, StorageFull: a file cannot be copied.
        """

    @abstractmethod
    def sweep(self) -> None:
        """Remove files that belong to no map, and complete a change that a crash broke off.

        Raises:
            StorageUnavailable, SQLAlchemyError: it is done the next time.
        """
