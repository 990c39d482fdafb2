"""Back up a server's irreplaceable data to one file, and restore it.

The file is a tar archive. Its last entry, the manifest, has the size and SHA-256 of all others, so that a truncated
file is detected.
"""

import errno
import hashlib
import io
import json
import os
import tarfile
import time
from collections.abc import Generator, Iterable, Iterator
from contextlib import closing, suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path, PurePosixPath
from typing import IO, cast
from uuid import uuid4

from rholoc import __version__
from rholoc.disk import reporting_full_disk, sync_folder, temporary_folder
from rholoc.errors import Conflict, InvalidInput, MissingObject, UnknownRecording
from rholoc.library.data_import import ImportedData, import_data
from rholoc.library.folder_documents import FolderDocuments
from rholoc.library.map_folder import place_of
from rholoc.library.maps import MapLibrary
from rholoc.library.recordings import ENTRY_FILE, RecordingStore
from rholoc.library.stores import CAMERAS, KEYS, SITES, Stores, documents_folder

_FORMAT, _FORMAT_VERSION = "rholoc-backup", 1
_MANIFEST = "manifest.json"
_MAX_MANIFEST_BYTES = 2**28
_MAPS, _DATA = "maps", "data"
_FOLDERS = {kind: documents_folder(kind, Path(_MAPS), Path(_DATA)).as_posix() for kind in (CAMERAS, SITES, KEYS)}
_ATTEMPTS = 5
_PIECE_BYTES = 2**20
_PRIVATE = 0o600  # the mode of a backup
_NAMES_SHOWN = 3


@dataclass(frozen=True)
class BackedUp:
    """A file in a backup."""

    size_bytes: int
    sha256: str


@dataclass(frozen=True)
class Manifest:
    """Content of a backup.

    Attributes:
        created: seconds since the epoch.
        rholoc: the version that made it.
        files: by path, below ``maps/`` and ``data/``.
    """

    created: float
    rholoc: str
    files: dict[str, BackedUp] = field(default_factory=dict)

    def count(self, pattern: str) -> int:
        """Number of files whose path matches the glob ``pattern``."""
        return sum(PurePosixPath(path).match(pattern) for path in self.files)


def back_up(file: Path, stores: Stores, recordings: bool = False) -> Manifest:
    """Write maps with their previous versions, cameras, sites and hashes of keys to a file.

    Servers may run meanwhile: the maps are a consistent snapshot, and each file is complete. Jobs, unfinished uploads
    and reproducible data are left out; so are recordings, unless ``recordings``.

    Raises:
        Conflict: the file exists.
        InvalidInput: it cannot be written.
        StorageUnavailable, MissingObject: the storage does not give a file; try again.
        StorageFull: the disk is full; nothing is left of the file.
    """
    for attempt in range(_ATTEMPTS):
        try:
            with (
                temporary_folder(stores.data_dir) as folder,
                closing(_contents(stores, folder, recordings)) as contents,
            ):
                return _write(file, contents)
        except MissingObject:  # it was replaced or deleted, and removed, since the catalogue was read
            if attempt == _ATTEMPTS - 1:
                raise
    raise AssertionError("unreachable")


def restore(file: Path, stores: Stores) -> tuple[Manifest, ImportedData]:
    """Restore a backup into stores without replacing anything.

    Identical data is skipped, so that an interrupted restoration can be repeated.

    Raises:
        InvalidInput: the file is no backup, was cut off or changed, or cannot be read. Nothing was restored.
        Conflict: the stores have different data of the same name, as the message says. Nothing was restored.
        StorageUnavailable, StorageFull: some of it was restored; try again.
    """
    with temporary_folder(stores.data_dir) as folder:
        maps_dir, data_dir = folder / _MAPS, folder / _DATA
        manifest = unpack_backup(file, maps_dir, data_dir)
        other = [*_other_maps(MapLibrary(maps_dir), stores.library), *_other_documents(folder, stores)]
        if other:
            shown = ", ".join(other[:_NAMES_SHOWN]) + (", …" if len(other) > _NAMES_SHOWN else "")
            raise Conflict(
                f"{len(other)} of the backup's files exist already and are different: {shown}. Nothing was restored.",
                "Restore into empty folders (--maps and --data), or an empty storage and database.",
            )
        return manifest, import_data(maps_dir, data_dir, stores)


def unpack_backup(file: Path, maps_dir: Path, data_dir: Path) -> Manifest:
    """Unpack a backup into empty folders.

    Raises:
        InvalidInput: the file is no backup, was cut off or changed, or cannot be read.
        StorageFull: the disk is full.
    """
    with reporting_full_disk():
        return _unpacked(file, {_MAPS: maps_dir, _DATA: data_dir})


def _other_maps(folder: MapLibrary, library: MapLibrary) -> Iterator[str]:
    """Iterate over the files of maps that have the same name but other content in a folder and the library."""
    for name in sorted({*folder.names()} & {*library.names()}):
        if not library.holds(name, folder.path(name)):
            yield f"{_MAPS}/{folder.path(name).name}"


def _other_documents(folder: Path, stores: Stores) -> Iterator[str]:
    """Iterate over the paths of small files that have the same name but other content in a folder and the stores."""
    for kind, path in _FOLDERS.items():
        files, stored = FolderDocuments(folder / path), stores.documents(kind)
        for name in sorted({*files.names()} & {*stored.names()}):
            if files.read(name) != stored.read(name):
                yield f"{path}/{name}"


# -- writing ---------------------------------------------------------------------------------------------------------


def _write(file: Path, sources: Iterable[tuple[str, Path]]) -> Manifest:
    """Write a new backup of ``sources``, pairs of a path in it and a file. Each file is read before the next pair.

    Raises:
        Conflict: the file exists.
        InvalidInput: it cannot be written.
        StorageFull: the disk is full.
    """
    if file.exists():
        raise Conflict(f"{file} exists already.", "Name another file, or remove it first.")
    unfinished = file.with_name(f".{uuid4().hex}.backup")
    try:
        with reporting_full_disk():
            unfinished.touch(_PRIVATE, exist_ok=False)  # it holds keys' hashes and recordings
            with unfinished.open("wb") as out, tarfile.open(fileobj=out, mode="w", format=tarfile.PAX_FORMAT) as tar:
                manifest = Manifest(time.time(), __version__)
                for path, source in sources:
                    manifest.files[path] = _add(tar, path, source)
                _add_manifest(tar, manifest)
                tar.close()
                out.flush()
                os.fsync(out.fileno())
            _move(unfinished, file)
            sync_folder(file.parent)
    except FileExistsError as error:
        raise Conflict(f"{file} exists already.", "Name another file, or remove it first.") from error
    except OSError as error:
        raise InvalidInput(f"{file} cannot be written: {error.strerror}.", "Check the folder.") from error
    finally:
        unfinished.unlink(missing_ok=True)
    return manifest


def _contents(stores: Stores, folder: Path, recordings: bool) -> Generator[tuple[str, Path]]:
    """Iterate over pairs of a path in the backup and a file, which may be gone when the next pair is requested."""
    for name, number, file in stores.library.snapshot():
        yield f"{_MAPS}/{place_of(name, number)}", file
    for kind, path in _FOLDERS.items():
        documents = stores.documents(kind)
        for name in sorted(documents.names()):
            with suppress(FileNotFoundError):  # it was deleted meanwhile
                yield _file(folder, f"{path}/{name}", documents.read(name))
    if recordings:
        yield from _recordings(stores.recordings, folder)


def _file(folder: Path, path: str, content: bytes) -> tuple[str, Path]:
    """A path in the backup and a file of ``content``, which the next call overwrites."""
    file = folder / "file"
    file.write_bytes(content)
    return path, file


def _recordings(store: RecordingStore, folder: Path) -> Iterator[tuple[str, Path]]:
    """Iterate over pairs of a path in the backup and a file of each recording, its entry and notes included."""
    for entry in store.list():
        try:
            notes, _ = store.notes(entry.id), store.path(entry.id)
        except UnknownRecording:  # it was deleted meanwhile
            continue
        for name, content in (notes | {ENTRY_FILE: json.dumps(asdict(entry)).encode()}).items():
            yield _file(folder, f"{_DATA}/recordings/{entry.id}/{name}", content)
        for name in entry.files:
            yield f"{_DATA}/recordings/{entry.id}/{name}", store.root / entry.id / name
        store.release(entry.id)


class _Hashed(io.RawIOBase):
    """A file that is read while its hash is taken."""

    def __init__(self, source: IO[bytes]) -> None:
        self._source = source
        self.sha256 = hashlib.sha256()

    def readable(self) -> bool:
        """True, as for every file that is read."""
        return True

    def read(self, size: int = -1) -> bytes:
        """The next at most ``size`` bytes, counted in the hash; all for -1."""
        piece = self._source.read(size)
        self.sha256.update(piece)
        return piece


def _add(tar: tarfile.TarFile, path: str, source: Path) -> BackedUp:
    """Add a file to the archive; returns its size and hash."""
    with source.open("rb") as stream:
        status, hashed = os.fstat(stream.fileno()), _Hashed(stream)
        entry = tarfile.TarInfo(path)
        entry.size, entry.mtime, entry.mode = status.st_size, int(status.st_mtime), 0o600
        tar.addfile(entry, cast("IO[bytes]", hashed))
    return BackedUp(status.st_size, hashed.sha256.hexdigest())


def _add_manifest(tar: tarfile.TarFile, manifest: Manifest) -> None:
    """Add the manifest as the archive's last entry."""
    text = json.dumps({"format": _FORMAT, "format_version": _FORMAT_VERSION, **asdict(manifest)}).encode()
    entry = tarfile.TarInfo(_MANIFEST)
    entry.size, entry.mtime, entry.mode = len(text), int(manifest.created), 0o600
    tar.addfile(entry, io.BytesIO(text))


# -- reading ---------------------------------------------------------------------------------------------------------


def _unpacked(file: Path, staged: dict[str, Path]) -> Manifest:
    """Unpack a backup into staging folders, and verify sizes and hashes. Raises InvalidInput: it is no backup, was
    cut off, or differs from its manifest.
    """
    found: dict[str, BackedUp] = {}
    manifest: Manifest | None = None
    try:
        with file.open("rb") as stream, tarfile.open(fileobj=stream, mode="r:") as tar:
            for entry in tar:
                content = tar.extractfile(entry) if entry.isfile() else None
                if content is None or manifest is not None:
                    raise _invalid(file, "it has an entry that no backup has")
                if entry.name == _MANIFEST and entry.size <= _MAX_MANIFEST_BYTES:
                    manifest = _manifest(file, content.read())
                else:
                    found[entry.name] = _unpack(content, _at(staged, _checked(file, entry.name)))
    except (tarfile.TarError, EOFError) as error:
        raise _invalid(file, "it was cut off, or is no backup at all") from error
    except FileNotFoundError as error:
        if error.filename != str(file):
            raise
        raise InvalidInput(f"There is no file {file}.", "Check the path.") from error
    if manifest is None:
        raise _invalid(file, "it was cut off, or is no backup at all")
    if manifest.files != found:
        changed = sorted(path for path in manifest.files | found if manifest.files.get(path) != found.get(path))
        raise _invalid(file, f"{changed[0][:100]} is not what was backed up")
    return manifest


def _manifest(file: Path, text: bytes) -> Manifest:
    """The manifest in its entry's ``text``. Raises InvalidInput, naming the backup ``file``, if it is none."""
    try:
        read = json.loads(text)
        if read["format"] != _FORMAT or read["format_version"] > _FORMAT_VERSION:
            raise _invalid(file, "it is of a later version")
        files = {str(path): BackedUp(**entry) for path, entry in read["files"].items()}
        return Manifest(float(read["created"]), str(read["rholoc"]), files)
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise _invalid(file, "its manifest cannot be read") from error


def _checked(file: Path, name: str) -> str:
    """The path of an entry, unchanged. Raises InvalidInput: it is not below a backup's folders."""
    path = PurePosixPath(name)
    within = path.parts[0] in (_MAPS, _DATA) if path.parts else False
    if not within or len(path.parts) < 2 or ".." in path.parts or path.as_posix() != name or "\\" in name:
        raise _invalid(file, f"it has an entry that no backup has, {name[:100]!r}")
    return name


def _at(staged: dict[str, Path], path: str) -> Path:
    """Path of an entry in the staging folder of its first part, ``maps`` or ``data``."""
    root, _, rest = path.partition("/")
    return staged[root] / rest


def _unpack(content: IO[bytes], target: Path) -> BackedUp:
    """Write an entry's content durably to a new file; returns its size and hash."""
    target.parent.mkdir(parents=True, exist_ok=True)
    hashed = _Hashed(content)
    size = 0
    with target.open("xb") as out:
        while piece := hashed.read(_PIECE_BYTES):
            size += out.write(piece)
        out.flush()
        os.fsync(out.fileno())
    return BackedUp(size, hashed.sha256.hexdigest())


def _move(source: Path, target: Path) -> None:
    """Rename a new file, unless there is one of that name. Raises FileExistsError: there is one."""
    try:
        os.link(source, target)
    except (FileExistsError, FileNotFoundError):
        raise
    except OSError as error:  # a file system without links
        if target.exists():
            raise FileExistsError(errno.EEXIST, "File exists", str(source), None, str(target)) from error
        source.rename(target)
    else:
        source.unlink()


def _invalid(file: Path, why: str) -> InvalidInput:
    """Error for a backup that cannot be used; ``why`` is a clause."""
    return InvalidInput(f"{file} cannot be restored: {why}. Nothing was restored.", "Take another copy of the backup.")
