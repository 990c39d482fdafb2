"""Small files by name: in a folder here, or wherever else a service keeps what all its servers share."""

from __future__ import annotations

import fcntl
import os
import time
from pathlib import Path
from typing import Protocol

from rholoc.errors import InvalidInput
from rholoc.maps.files import replace_file

_TICK_NS = 2 * 10**9  # a folder that changed within its clock's last tick may change again and look the same


class Documents(Protocol):
    """Small files by name, each replaced whole or not at all. Safe to share between threads and processes."""

    def names(self) -> list[str]:
        """The names of all, in no order."""
        ...

    def read(self, name: str) -> bytes:
        """What a file holds. Raises FileNotFoundError, and OSError where it cannot be read."""
        ...

    def stamp(self) -> object:
        """What differs once any of them has changed; None where it is too early to tell."""
        ...

    def write(self, name: str, content: bytes, called: str = "") -> None:
        """Store a file, in place of the one that was there; errors speak of it as ``called``.

        Raises:
            StorageFull, InvalidInput: nothing was replaced.
        """
        ...

    def exchange(self, name: str, before: bytes | None, content: bytes, called: str = "") -> bool:
        """Store a file if it still holds ``before``, or is still missing where that is None; whether it was stored.

        Of several that exchange the same at one moment, in whichever process, one stores its file.

        Raises:
            StorageFull, InvalidInput: nothing was replaced.
        """
        ...

    def delete(self, name: str) -> None:
        """Remove a file. Raises FileNotFoundError."""
        ...


class FolderDocuments:
    """The files of a folder, which is made when the first is written, with the permissions ``mode``."""

    def __init__(self, folder: Path, mode: int = 0o777) -> None:
        self._folder = folder
        self._mode = mode

    def names(self) -> list[str]:
        """The names of all files that are not hidden."""
        if not self._folder.is_dir():
            return []
        return [path.name for path in self._folder.iterdir() if path.is_file() and not path.name.startswith(".")]

    def read(self, name: str) -> bytes:
        """What a file holds. Raises FileNotFoundError, and OSError where it cannot be read."""
        return (self._folder / name).read_bytes()

    def stamp(self) -> object:
        """The folder's time of change: it does not show what is written into a file in place."""
        try:
            changed_ns = self._folder.stat().st_mtime_ns
        except OSError:
            return None
        return changed_ns if time.time_ns() - changed_ns > _TICK_NS else None

    def write(self, name: str, content: bytes, called: str = "") -> None:
        """Store a file. Raises StorageFull, InvalidInput: nothing was replaced."""
        self._make_folder()
        replace_file(self._folder / name, content, called)

    def exchange(self, name: str, before: bytes | None, content: bytes, called: str = "") -> bool:
        """Store a file that holds ``before``. Raises StorageFull, InvalidInput: nothing was replaced."""
        self._make_folder()
        descriptor = os.open(self._folder, os.O_RDONLY)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX)  # until the descriptor is closed
            path = self._folder / name
            if (path.read_bytes() if path.exists() else None) != before:
                return False
            replace_file(path, content, called)
        finally:
            os.close(descriptor)
        return True

    def _make_folder(self) -> None:
        try:
            self._folder.mkdir(mode=self._mode, parents=True, exist_ok=True)
        except OSError as error:
            raise InvalidInput(
                f"The folder {self._folder.name} cannot be created: {error.strerror}.", "Check the folder."
            ) from error

    def delete(self, name: str) -> None:
        """Remove a file. Raises FileNotFoundError."""
        (self._folder / name).unlink()
