"""The disk: atomic and durable files, and full disks reported as such."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from uuid import uuid4

from rholoc.errors import StorageFull

_FULL = frozenset({errno.ENOSPC, errno.EDQUOT})


def is_full(error: OSError) -> bool:
    """Whether the error says that there is no space left."""
    return error.errno in _FULL


def storage_full() -> StorageFull:
    """The error for a full disk."""
    return StorageFull("The disk is full; nothing stored was changed.", "Free some space and try again.")


@contextmanager
def reporting_full_disk() -> Iterator[None]:
    """Turn the operating system's "no space left" into :class:`rholoc.errors.StorageFull`."""
    try:
        yield
    except OSError as error:
        if is_full(error):
            raise storage_full() from error
        raise


def sync_folder(folder: Path) -> None:
    """Make the folder's entries durable; file systems that cannot sync a folder do so by themselves."""
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


def _write(path: Path, data: bytes | memoryview | Iterable[bytes], mode: int) -> None:
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
    try:
        for piece in [data] if isinstance(data, bytes | memoryview) else data:
            rest = memoryview(piece).cast("B")
            while len(rest):
                rest = rest[os.write(descriptor, rest) :]
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
