"""A folder as a catalogue of maps: a map's name is its file's."""

import os
import shutil
import stat
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from rholoc.disk import link_file, locked_folder, make_folder, reporting_full_disk, sync_folder, temporary_folder
from rholoc.library.map_catalogue import KEPT_VERSIONS, MapCatalogue, MapChange, MapFile
from rholoc.maps.formats.rho_file import SUFFIX, MapOutline, load_outline
from rholoc.maps.map import Map
from rholoc.maps.name_rules import is_map_name

_PREVIOUS = ".previous"  # folder of replaced files
_BEGUN, _DECIDED = ".change-begun", ".change-decided"  # folders with a change's links


def place_of(name: str, number: int = 0) -> str:
    """Path, relative to the folder, of a map's file (``number`` 0), or of its replaced files (1 is the last)."""
    if number == 0:
        return name + SUFFIX
    return f"{_PREVIOUS}/{name}{SUFFIX}" + (f".{number}" if number > 1 else "")


class MapFolder(MapCatalogue):
    """Maps as ``NAME.rho`` in a folder; those that they replaced are in ``.previous``.

    Putting, replacing or removing a file publishes, replaces or deletes a map. A change of several files is committed
    by renaming one folder; if its process is killed, the next process that changes the folder completes it.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._changing = threading.Lock()  # for file systems without locks

    @property
    def folder(self) -> Path:
        return self._folder

    def names(self) -> list[str]:
        """Sorted names of the ``NAME.rho`` files in the folder whose names a map may have."""
        files = (file for file in self.folder.glob(f"*{SUFFIX}") if file.is_file())
        return sorted(file.stem for file in files if is_map_name(file.stem))

    def find(self, name: str) -> MapFile | None:
        """The present file of a name; None if there is none."""
        return self.at(place_of(name))

    def versions(self, name: str) -> list[MapFile]:
        """The files that were replaced under a name, the last replaced first; at most :data:`KEPT_VERSIONS`."""
        found = (self.at(place_of(name, number)) for number in range(1, KEPT_VERSIONS + 1))
        return [file for file in found if file is not None]

    def at(self, place: str) -> MapFile | None:
        """The file at a place below the folder; None if there is none, or it is no regular file."""
        try:
            status = (self.folder / place).stat()
        except FileNotFoundError:
            return None
        if not stat.S_ISREG(status.st_mode):
            return None
        return _file(place, status)

    def stamp(self) -> int | None:
        """The folder's time of change [ns]; None if it cannot be read."""
        try:
            return self.folder.stat().st_mtime_ns
        except OSError:
            return None

    def local(self, file: MapFile) -> Path:
        """Path of the file, which is in the folder itself."""
        return self.folder / file.key

    def outline(self, file: MapFile, name: str) -> MapOutline:
        """Description and size from a file's header. Raises InvalidMap if it is not a map."""
        return load_outline(self.local(file))

    def make_room(self) -> None:
        """Make the folder if it is missing. Raises InvalidInput, StorageFull: it cannot be made."""
        make_folder(self.folder)

    def store(self, arrived: Path, map_: Map) -> MapFile:
        """The file ``arrived`` as it is in the folder, still hidden; nothing is moved. ``map_`` is not used."""
        return _file(arrived.name, arrived.stat())

    @contextmanager
    def changing(self, published: Map | None = None) -> Iterator[MapChange]:
        """Yield a change, applied at the end of the block unless it raises; the folder is locked meanwhile."""
        with self._changing, locked_folder(self.folder):
            self._complete()
            change = _Change(self)
            yield change
            with reporting_full_disk():
                self._decide(change.wanted)
                self._complete(is_new=True)

    def snapshot(self) -> Iterator[tuple[str, int, Path]]:
        """Name, number (0: present, 1: the last replaced, …) and a link of each file; the links vanish at the end."""
        if not self.folder.is_dir():
            return
        with temporary_folder(self.folder) as links:
            with locked_folder(self.folder):
                self._complete()
                found = [
                    (name, number, self.local(file))
                    for name in self.names()
                    for number, file in enumerate([self.find(name), *self.versions(name)])
                    if file is not None
                ]
                for row, (_, _, path) in enumerate(found):
                    link_file(path, links / str(row))
            for row, (name, number, _) in enumerate(found):
                yield name, number, links / str(row)

    def sweep(self) -> None:
        """Complete a change that a crash interrupted; there are no files without a name."""
        if (self.folder / _DECIDED).exists():
            with locked_folder(self.folder):
                self._complete()

    def _decide(self, wanted: dict[str, str | None]) -> None:
        """Prepare a change's links (an empty file for a deletion), and commit it by renaming their folder.

        Args:
            wanted: path below the folder → path of the file to put there, or None to delete it.
        """
        changes = {place: file for place, file in wanted.items() if file != place}
        if not changes:
            return
        begun = self.folder / _BEGUN
        shutil.rmtree(begun, ignore_errors=True)
        (begun / _PREVIOUS).mkdir(parents=True)
        for place, file in changes.items():
            if file is None:
                (begun / place).touch()
            else:
                link_file(self.folder / file, begun / place)
        sync_folder(begun / _PREVIOUS)
        sync_folder(begun)
        begun.rename(self.folder / _DECIDED)
        sync_folder(self.folder)

    def _complete(self, is_new: bool = False) -> None:
        """Apply a committed change, if there is one. If the first link of a new change cannot be put in its place, the
        change is rolled back. Raises OSError.
        """
        decided = self.folder / _DECIDED
        if not decided.exists():
            return
        for link in sorted(path for path in decided.rglob("*") if path.is_file()):
            try:
                self._put_in_place(link, self.folder / link.relative_to(decided))
            except OSError:
                if is_new:
                    decided.rename(self.folder / _BEGUN)
                raise
            is_new = False
        for folder in (self.folder, self.folder / _PREVIOUS):
            if folder.is_dir():
                sync_folder(folder)
        shutil.rmtree(decided)

    def _put_in_place(self, link: Path, place: Path) -> None:
        """Move a file to its place; an empty one stands for a deletion."""
        if link.stat().st_size == 0:
            place.unlink(missing_ok=True)
        else:
            place.parent.mkdir(exist_ok=True)
            link.replace(place)


class _Change:
    """Pending changes of a folder's files."""

    def __init__(self, folder: MapFolder) -> None:
        self._folder = folder
        self.present, self.versions = folder.find, folder.versions
        self.wanted: dict[str, str | None] = {}

    def arrange(self, name: str, present: MapFile | None, versions: Sequence[MapFile]) -> None:
        """At the change's end, set a name's file (None deletes it), and keep the first five of ``versions``."""
        files = [present, *versions[:KEPT_VERSIONS]]
        for number in range(KEPT_VERSIONS + 1):
            file = files[number] if number < len(files) else None
            if file is not None or self._folder.at(place_of(name, number)) is not None:
                self.wanted[place_of(name, number)] = None if file is None else file.key


def _file(place: str, status: os.stat_result) -> MapFile:
    """File at ``place`` below the folder, of this status; map id and version are not known."""
    return MapFile(
        place, status.st_size, status.st_mtime, signature=(status.st_ino, status.st_mtime_ns, status.st_size)
    )
