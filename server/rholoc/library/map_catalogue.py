"""Catalogue of maps: name → file. A folder (:mod:`map_folder`), or a database and objects (:mod:`shared_maps`)."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from rholoc.library.map_cache import Signature
from rholoc.maps.formats.rho_file import MapOutline
from rholoc.maps.map import Map

KEPT_VERSIONS = 5
"""How many replaced maps are kept under each name."""


@dataclass(frozen=True)
class MapFile:
    """A map's file. Equal objects have equal content.

    Attributes:
        key: in its catalogue.
        size_bytes: its size.
        modified: when it was published [s since the epoch]; 0 if unknown.
        signature: changes whenever the file is replaced.
        map_id, version: of the map; None if only the file has them.
    """

    key: str
    size_bytes: int
    modified: float
    signature: Signature
    map_id: str | None = None
    version: int | None = None


class MapChange(Protocol):
    """An atomic change of a catalogue."""

    def present(self, name: str) -> MapFile | None:
        """The file of a name; None if no map has it."""
        ...

    def versions(self, name: str) -> list[MapFile]:
        """The files that were replaced under a name, the last replaced first."""
        ...

    def arrange(self, name: str, present: MapFile | None, versions: Sequence[MapFile]) -> None:
        """Set a name's file (None deletes it), and keep the first :data:`KEPT_VERSIONS` of ``versions``."""
        ...


class MapCatalogue(ABC):
    """Present and previous files of each map's name. Safe to share between threads and processes.

    Attributes:
        holds_only_maps: whether all files are verified to be maps before they get a name.
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
        """Value that changes with every publication, renaming or deletion by any process; None if unknown."""

    def refresh(self) -> None:
        """Load other processes' changes; does nothing if the database does not answer."""
        return

    def look_again(self) -> None:
        """:meth:`refresh` on a cache miss, at most a few times a second."""
        return

    def is_here(self, file: MapFile) -> bool:
        """Whether :meth:`local` needs no fetch."""
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
        """Description and size of a map called ``name``, from its file's header; fetches only the header.

        Raises:
            InvalidMap: the file is not a map.
            StorageUnavailable: the header cannot be fetched.
        """

    @abstractmethod
    def make_room(self) -> None:
        """Make :attr:`folder` if it is missing, and room on its disk for an incoming file as far as copies can be
        removed. Raises InvalidInput, StorageFull: the folder cannot be made.
        """

    @abstractmethod
    def store(self, arrived: Path, map_: Map) -> MapFile:
        """Store a map's file without a name. Raises StorageUnavailable, StorageFull."""

    @abstractmethod
    def changing(self, published: Map | None = None) -> AbstractContextManager[MapChange]:
        """A change applied at the end of the block unless it raises. ``published`` is the map that gets a name.

        Raises:
            StorageFull, OSError, SQLAlchemyError: nothing was changed.
        """

    @abstractmethod
    def snapshot(self) -> Iterator[tuple[str, int, Path]]:
        """Consistent snapshot of all files: names, numbers, copies. A copy may be gone when the next one is requested.

        Number 0 is the map of that name; from 1 on, the maps that it replaced, the last replaced first.

        Raises:
            MissingObject: a file was removed meanwhile.
            StorageUnavailable, StorageFull: a file cannot be copied.
        """

    @abstractmethod
    def sweep(self) -> None:
        """Remove files without a name, and complete a change interrupted by a crash.

        Raises:
            StorageUnavailable, SQLAlchemyError: the sweep is incomplete.
        """
