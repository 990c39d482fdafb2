"""Recordings and maps → what is uploaded, with progress."""

from __future__ import annotations

import os
import tempfile
import zipfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import BinaryIO

UploadProgress = Callable[[int, int], None]  # bytes sent, bytes in all

_PACKED = frozenset({".jpg", ".jpeg", ".png", ".webp", ".mp4", ".mov", ".webm", ".mkv"})


class CountedFile:
    """A file that tells how much of it was read; httpx reads it once per attempt."""

    def __init__(self, file: BinaryIO, progress: UploadProgress | None) -> None:
        self._file = file
        self._progress = progress
        self._total = os.fstat(file.fileno()).st_size

    def read(self, size: int = -1) -> bytes:
        """The next bytes."""
        chunk = self._file.read(size)
        if self._progress is not None and chunk:
            self._progress(self._file.tell(), self._total)
        return chunk

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """As of files."""
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        """As of files."""
        return self._file.tell()

    def fileno(self) -> int:
        """As of files; httpx learns the length from it."""
        return self._file.fileno()


@contextmanager
def opened_recording(path: Path, progress: UploadProgress | None) -> Iterator[tuple[str, CountedFile]]:
    """A recording as one file: a video or a ZIP file as it is, a folder packed into a temporary ZIP file.

    Yields:
        The file's name and the file.

    Raises:
        OSError: the path cannot be read.
    """
    with ExitStack() as stack:
        if path.is_dir():
            file: BinaryIO = stack.enter_context(tempfile.TemporaryFile())
            _pack(path, file)
            name = f"{path.resolve().name}.zip"
        else:
            file = stack.enter_context(path.open("rb"))
            name = path.name
        yield name, CountedFile(file, progress)


def _pack(folder: Path, file: BinaryIO) -> None:
    with zipfile.ZipFile(file, "w") as archive:
        for path in sorted(folder.rglob("*")):
            relative = path.relative_to(folder)
            if path.is_file() and not any(part.startswith(".") for part in relative.parts):
                packed = path.suffix.lower() in _PACKED
                archive.write(path, relative, zipfile.ZIP_STORED if packed else zipfile.ZIP_DEFLATED)
    file.seek(0)
