"""Atomic replacement of files."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from uuid import uuid4

from rholoc.disk import is_full, sync_folder
from rholoc.errors import InvalidInput, StorageFull


def replace_file(path: Path, data: bytes | memoryview | Iterable[bytes], called: str = "") -> None:
    """Write ``data``, in one piece or several, to ``path`` so that readers see old or new content, never a part.

    It is written beside ``path``, synced to disk, and renamed; a file that is open or mapped keeps its content. Errors
    refer to the file as ``called``, by default its name.

    Raises:
        StorageFull: the disk is full; the old content stays.
        InvalidInput: the folder does not exist or cannot be written to.
    """
    temporary = path.with_name(f".{uuid4().hex}.tmp")
    try:
        try:
            _write(temporary, data)
            temporary.replace(path)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
        sync_folder(path.parent)
    except OSError as error:
        if is_full(error):
            raise StorageFull(
                f"No space left to write {called or path.name}; what was there is unchanged.",
                "Free some space and try again.",
            ) from error
        raise InvalidInput(f"{called or path} cannot be written: {error.strerror}.", "Check the folder.") from error


def _write(path: Path, data: bytes | memoryview | Iterable[bytes]) -> None:
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
    try:
        for piece in [data] if isinstance(data, bytes | memoryview) else data:
            rest = memoryview(piece).cast("B")
            while len(rest):
                rest = rest[os.write(descriptor, rest) :]
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
