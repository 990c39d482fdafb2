"""Atomic replacement of files."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from rholoc.disk import is_full, write_file
from rholoc.errors import InvalidInput, StorageFull


def replace_file(path: Path, data: bytes | memoryview | Iterable[bytes], called: str = "", mode: int = 0o666) -> None:
    """:func:`rholoc.disk.write_file`, with errors that refer to the file as ``called``, by default its name.

    Raises:
        StorageFull: the disk is full; the old content stays.
        InvalidInput: the folder does not exist or cannot be written to.
    """
    try:
        write_file(path, data, mode)
    except OSError as error:
        if is_full(error):
            raise StorageFull(
                f"No space left to write {called or path.name}; what was there is unchanged.",
                "Free some space and try again.",
            ) from error
        raise InvalidInput(
            f"{called or path.name} cannot be written: {error.strerror}.", "Check the folder."
        ) from error
