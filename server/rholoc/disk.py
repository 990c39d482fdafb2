"""The disk: atomic and durable files, folders that are locked or temporary, and full disks reported as such."""

import errno
import fcntl
import os
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path, PurePath
from uuid import uuid4

from rholoc.errors import InvalidInput, StorageFull

_FULL = frozenset({errno.ENOSPC, errno.EDQUOT})
_SYSTEM_FILES = frozenset({"__MACOSX", ".DS_Store", "Thumbs.db"})
_APPLE_DOUBLE = "._"  # how the names of macOS's files of attributes start


def is_system_file(path: PurePath) -> bool:
    """Whether an operating system adds a file or folder of this path to those of people."""
    return path.name.startswith(_APPLE_DOUBLE) or not _SYSTEM_FILES.isdisjoint(path.parts)


def is_full(error: OSError) -> bool:
    """Whether the error says that there is no space left, on the disk or in the quota."""
    return error.errno in _FULL


def storage_full() -> StorageFull:
    """The error for a full disk."""
    return StorageFull("The disk is full; nothing stored was changed.", "Free some space and try again.")


@contextmanager
def reporting_full_disk() -> Iterator[None]:
    """Within the block, turn the system's "no space left" into :class:`rholoc.errors.StorageFull`."""
    try:
        yield
    except OSError as error:
        if is_full(error):
            raise storage_full() from error
        raise


def sync_folder(folder: Path) -> None:
    """Make the folder's entries durable, unless its file system cannot sync a folder. Raises OSError."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):
            raise
    finally:
        os.close(descriptor)


def write_file(path: Path, data: bytes | memoryview | Iterable[bytes], mode: int = 0o666) -> None:
    """Write ``data``, in one piece or several, to ``path`` so that readers see old or new content, never a part.

    It is written beside ``path``, synced to disk, and renamed; a file that is open or mapped keeps its content.

    Raises:
        OSError: the old content stays.
    """
    temporary = path.with_name(f".{uuid4().hex}.tmp")
    try:
        _write(temporary, data, mode)
        temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    sync_folder(path.parent)


def replace_file(path: Path, data: bytes | memoryview | Iterable[bytes], called: str = "", mode: int = 0o666) -> None:
    """:func:`write_file`, with errors that refer to the file as ``called``, by default its name.

    Raises:
        StorageFull: the disk is full; the old content stays.
        InvalidInput: the folder does not exist or cannot be written to.
    """
    try:
        write_file(path, data, mode)
    except OSError as error:
        name = called or path.name
        if is_full(error):
            message = f"No space left to write {name}; what was there is unchanged."
            raise StorageFull(message, "Free some space and try again.") from error
        raise InvalidInput(f"{name} cannot be written: {error.strerror}.", "Check the folder.") from error


def make_folder(folder: Path, mode: int = 0o777) -> None:
    """Create a folder, and those above it, unless it exists.

    Raises:
        StorageFull: the disk is full.
        InvalidInput: it cannot be created.
    """
    try:
        with reporting_full_disk():
            folder.mkdir(mode=mode, parents=True, exist_ok=True)
    except OSError as error:
        message = f"The folder {folder.name} cannot be created: {error.strerror}."
        raise InvalidInput(message, "Check the folder above it.") from error


def link_file(path: Path, other: Path) -> None:
    """Give a file the second name ``other``. A file system without hard links gets a copy.

    Raises:
        FileNotFoundError: there is no file ``path``.
        StorageFull: the disk is full.
    """
    try:
        os.link(path, other)
    except FileNotFoundError:
        raise
    except OSError:
        with reporting_full_disk():
            shutil.copyfile(path, other)


@contextmanager
def locked_folder(folder: Path) -> Iterator[None]:
    """Exclude, within the block, all threads and processes that lock the same folder; waits for them.

    Nobody is excluded if its file system has no locks. A thread must not lock a folder twice.
    """
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX)  # until the descriptor is closed
        except OSError as error:
            if error.errno not in (errno.ENOLCK, errno.ENOTSUP, errno.ENOSYS):
                raise
        yield
    finally:
        os.close(descriptor)


@contextmanager
def temporary_folder(parent: Path, prefix: str = ".") -> Iterator[Path]:
    """New folder in ``parent``, named ``prefix`` and 32 hex digits. It is removed at the end unless it was renamed.

    Raises:
        StorageFull: the disk is full.
    """
    folder = parent / f"{prefix}{uuid4().hex}"
    with reporting_full_disk():
        folder.mkdir(parents=True)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _write(path: Path, data: bytes | memoryview | Iterable[bytes], mode: int) -> None:
    """Write a new file of ``mode``, in one piece or several, and sync it. Raises OSError, also if it exists."""
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
    try:
        for piece in [data] if isinstance(data, bytes | memoryview) else data:
            rest = memoryview(piece).cast("B")
            while len(rest):
                rest = rest[os.write(descriptor, rest) :]
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
