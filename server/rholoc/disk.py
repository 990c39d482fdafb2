"""The disk: making renames durable, and reporting a full one as what it is."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

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
