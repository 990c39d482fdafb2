"""Everything that a server cannot make again, in one file, and back.

The file is a tar archive whose last entry, the manifest, has the size and SHA-256 of each of the others: one that was
cut off has none.
"""

from __future__ import annotations

import errno
import hashlib
import io
import json
import os
import re
import shutil
import tarfile
import time
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path, PurePosixPath
from typing import IO, cast
from uuid import uuid4

from rholoc import __version__
from rholoc.disk import reporting_full_disk, sync_folder
from rholoc.errors import Conflict, InvalidInput, StorageUnavailable

_FORMAT, _FORMAT_VERSION = "rholoc-backup", 1
_MANIFEST = "manifest.json"
_MAX_MANIFEST_BYTES = 2**28
_MAPS, _DATA = "maps", "data"
_PREVIOUS, _KEYS, _RECORDINGS = ".previous", "keys", "recordings"
_OF_MAPS = ("*.rho", f"{_PREVIOUS}/*.rho*", "cameras/*.json", "sites/*.json")
_ID = re.compile(r"[0-9a-f]{32}")  # of a recording: what is not whole is called otherwise
_ATTEMPTS = 20  # to see the folder of maps unchanged while it is looked through
_PAUSE_S = 0.2
_PIECE_BYTES = 2**20
_NAMES_SHOWN = 3


@dataclass(frozen=True)
class BackedUp:
    """A file in a backup."""

    size_bytes: int
    sha256: str


@dataclass(frozen=True)
class Manifest:
    """What a backup holds.

    Attributes:
        created: seconds since the epoch.
        rholoc: the version that made it.
        files: by path, below ``maps/`` and ``data/``.
    """

    created: float
    rholoc: str
    files: dict[str, BackedUp] = field(default_factory=dict)

    def count(self, pattern: str) -> int:
        """How many of the files' paths match a pattern."""
        return sum(PurePosixPath(path).match(pattern) for path in self.files)


def back_up(file: Path, maps_dir: Path, data_dir: Path, recordings: bool = False) -> Manifest:
    """Write maps with the versions that they replaced, cameras, sites and keys, which are hashes, to a file.

    A server may run meanwhile: all maps are those of one moment, each file whole. Jobs, uploads that are not finished
    and what can be made again are left out; recordings too, unless they are asked for.

    Raises:
        Conflict: the file exists.
        InvalidInput: it cannot be written.
        StorageUnavailable: maps were published all the time; try again.
        StorageFull: the disk is full; nothing is left of the file.
    """
    return write_backup(file, _opened(maps_dir, data_dir, recordings))


def write_backup(file: Path, contents: AbstractContextManager[Iterable[tuple[str, Path]]]) -> Manifest:
    """Write files to a backup.

    Args:
        file: the backup.
        contents: opens the paths in the backup and the files, each of which is read before the next is asked for.

    Raises:
        Conflict: the file exists.
        InvalidInput: it cannot be written.
        StorageFull: the disk is full; nothing is left of the file.
    """
    if file.exists():
        raise Conflict(f"{file} exists already.", "Name another file, or remove it first.")
    unfinished = file.with_name(f".{uuid4().hex}.backup")
    try:
        with reporting_full_disk(), contents as sources:
            with unfinished.open("xb") as out, tarfile.open(fileobj=out, mode="w", format=tarfile.PAX_FORMAT) as tar:
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


def unpack_backup(file: Path, maps_dir: Path, data_dir: Path) -> Manifest:
    """Unpack a backup into empty folders.

    Raises:
        InvalidInput: it is none, was cut off or changed, or cannot be read.
        StorageFull: the disk is full.
    """
    with reporting_full_disk():
        return _unpacked(file, {_MAPS: maps_dir, _DATA: data_dir})


def restore(file: Path, maps_dir: Path, data_dir: Path) -> Manifest:
    """Bring everything in a backup back; nothing that is there is replaced.

    Raises:
        InvalidInput: the file is none, was cut off or changed, or cannot be read. Nothing was restored.
        Conflict: something of it is there already; says what. Nothing was restored.
        StorageFull: the disk is full. Nothing was restored.
    """
    roots = {_MAPS: maps_dir, _DATA: data_dir}
    with reporting_full_disk():
        for root in roots.values():
            root.mkdir(parents=True, exist_ok=True)
        staged = {name: root / f".{uuid4().hex}.restore" for name, root in roots.items()}
        try:
            manifest = _unpacked(file, staged)
            targets = {path: roots[path.partition("/")[0]] / path.partition("/")[2] for path in manifest.files}
            there = [path for path, target in targets.items() if target.exists()]
            if there:
                raise _is_there(there)
            _publish({_at(staged, path): target for path, target in targets.items()})
        finally:
            for folder in staged.values():
                shutil.rmtree(folder, ignore_errors=True)
    return manifest


def _is_there(paths: list[str]) -> Conflict:
    shown = ", ".join(paths[:_NAMES_SHOWN]) + (", …" if len(paths) > _NAMES_SHOWN else "")
    return Conflict(
        f"{len(paths)} of the backup's files exist already: {shown}. Nothing was restored.",
        "Restore into empty folders: --maps and --data.",
    )


# -- writing ---------------------------------------------------------------------------------------------------------


@contextmanager
def _opened(maps_dir: Path, data_dir: Path, recordings: bool) -> Iterator[Iterable[tuple[str, Path]]]:
    """Links to all files of one moment, by their paths in the backup; they outlive what is replaced or deleted."""
    folder = maps_dir / f".{uuid4().hex}.backup"
    try:
        maps = _linked(maps_dir, folder)
        data = [path for path in sorted((data_dir / _KEYS).glob("*")) if path.is_file() and not _is_hidden(path)]
        if recordings:
            whole = [one for one in sorted((data_dir / _RECORDINGS).glob("*")) if _ID.fullmatch(one.name)]
            data += [path for one in whole for path in sorted(one.rglob("*")) if path.is_file()]
        yield (maps | {f"{_DATA}/{path.relative_to(data_dir).as_posix()}": path for path in data}).items()
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _linked(maps_dir: Path, folder: Path) -> dict[str, Path]:
    """Links in a folder to the files of the maps as they were at one moment.

    Raises:
        StorageUnavailable: something was published each time.
    """
    for attempt in range(_ATTEMPTS):
        before, into = _stamps(maps_dir), folder / str(attempt)
        with suppress(FileNotFoundError):  # replaced or deleted meanwhile
            found = {}
            for number, path in enumerate(before):
                found[f"{_MAPS}/{path}"] = _link(maps_dir / path, into / str(number))
            if _stamps(maps_dir) == before:
                return found
        shutil.rmtree(into, ignore_errors=True)
        time.sleep(_PAUSE_S)
    raise StorageUnavailable("Maps were published all the time.", "Try again.")


def _stamps(maps_dir: Path) -> dict[str, tuple[int, int, int]]:
    """What tells each file from one that replaces it, by path."""
    found = {}
    for pattern in _OF_MAPS:
        for path in sorted(maps_dir.glob(pattern)):
            if path.is_file() and not _is_hidden(path):
                status = path.stat()
                found[path.relative_to(maps_dir).as_posix()] = (status.st_ino, status.st_mtime_ns, status.st_size)
    return found


def _is_hidden(path: Path) -> bool:
    return path.name.startswith(".")


def _link(path: Path, link: Path) -> Path:
    """A second name of a file; where the file system has none, a copy."""
    link.parent.mkdir(parents=True, exist_ok=True)
    try:
        os.link(path, link)
    except FileNotFoundError:
        raise
    except OSError:
        shutil.copyfile(path, link)
    return link


class _Hashed(io.RawIOBase):
    """A file that is read while its hash is taken."""

    def __init__(self, source: IO[bytes]) -> None:
        self._source = source
        self.sha256 = hashlib.sha256()

    def readable(self) -> bool:
        return True

    def read(self, size: int = -1) -> bytes:
        piece = self._source.read(size)
        self.sha256.update(piece)
        return piece


def _add(tar: tarfile.TarFile, path: str, source: Path) -> BackedUp:
    with source.open("rb") as stream:
        status, hashed = os.fstat(stream.fileno()), _Hashed(stream)
        entry = tarfile.TarInfo(path)
        entry.size, entry.mtime, entry.mode = status.st_size, int(status.st_mtime), 0o600
        tar.addfile(entry, cast("IO[bytes]", hashed))
    return BackedUp(status.st_size, hashed.sha256.hexdigest())


def _add_manifest(tar: tarfile.TarFile, manifest: Manifest) -> None:
    text = json.dumps({"format": _FORMAT, "format_version": _FORMAT_VERSION, **asdict(manifest)}).encode()
    entry = tarfile.TarInfo(_MANIFEST)
    entry.size, entry.mtime, entry.mode = len(text), int(manifest.created), 0o600
    tar.addfile(entry, io.BytesIO(text))


# -- reading ---------------------------------------------------------------------------------------------------------


def _unpacked(file: Path, staged: dict[str, Path]) -> Manifest:
    """A backup's files in folders apart, once they are found to be whole.

    Raises:
        InvalidInput: they are not.
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
    try:
        read = json.loads(text)
        if read["format"] != _FORMAT or read["format_version"] > _FORMAT_VERSION:
            raise _invalid(file, "it is of a later version")
        files = {str(path): BackedUp(**entry) for path, entry in read["files"].items()}
        return Manifest(float(read["created"]), str(read["rholoc"]), files)
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise _invalid(file, "its manifest cannot be read") from error


def _checked(file: Path, name: str) -> str:
    """The path of an entry, if a backup may have it: nothing is written elsewhere.

    Raises:
        InvalidInput: it may not.
    """
    path = PurePosixPath(name)
    within = path.parts[0] in (_MAPS, _DATA) if path.parts else False
    if not within or len(path.parts) < 2 or ".." in path.parts or path.as_posix() != name or "\\" in name:
        raise _invalid(file, f"it has an entry that no backup has, {name[:100]!r}")
    return name


def _at(staged: dict[str, Path], path: str) -> Path:
    root, _, rest = path.partition("/")
    return staged[root] / rest


def _unpack(content: IO[bytes], target: Path) -> BackedUp:
    target.parent.mkdir(parents=True, exist_ok=True)
    hashed = _Hashed(content)
    size = 0
    with target.open("xb") as out:
        while piece := hashed.read(_PIECE_BYTES):
            size += out.write(piece)
        out.flush()
        os.fsync(out.fileno())
    return BackedUp(size, hashed.sha256.hexdigest())


def _publish(files: dict[Path, Path]) -> None:
    """Bring files to where they belong; all or none.

    Raises:
        Conflict: something came there meanwhile.
    """
    done: list[Path] = []
    try:
        for source, target in files.items():
            target.parent.mkdir(mode=0o700 if target.parent.name == _KEYS else 0o777, parents=True, exist_ok=True)
            _move(source, target)
            done.append(target)
        for folder in {target.parent for target in done}:
            sync_folder(folder)
    except BaseException as error:
        for target in done:
            target.unlink(missing_ok=True)
        if isinstance(error, FileExistsError):
            raise _is_there([str(error.filename2 or error.filename)]) from error
        raise


def _move(source: Path, target: Path) -> None:
    """Give a file its place, unless there is one already.

    Raises:
        FileExistsError: there is.
    """
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
    return InvalidInput(f"{file} cannot be restored: {why}. Nothing was restored.", "Take another copy of the backup.")
