"""Small files by name, in a folder."""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import Generic, TypeVar

from rholoc.disk import locked_folder, make_folder, replace_file
from rholoc.errors import InvalidInput, NotFound
from rholoc.maps.name_rules import check_name, is_name, some_of

_SUFFIX = ".json"
_TICK_NS = 2 * 10**9  # a folder may change again within a tick of its clock without a new time of change

Accepts = Callable[[bytes | None], bool]


class Documents(ABC):
    """Small files by name, each replaced atomically. Safe to share between threads and processes."""

    @abstractmethod
    def names(self) -> list[str]:
        """The names of all files, in no order."""

    @abstractmethod
    def read(self, name: str) -> bytes:
        """Content of a file. Raises FileNotFoundError, and OSError where it cannot be read."""

    @abstractmethod
    def stamp(self) -> object:
        """Value that changes when any file changes; None if it is too early to tell, or files cannot be seen."""

    @abstractmethod
    def _set(self, name: str, content: bytes | None, called: str, accepts: Accepts | None = None) -> bool:
        """Store a file, or remove it if ``content`` is None. False if refused, or missing already. ``accepts``,
        if given, must return True for the present content, which is None if the file is missing.
        """

    def write(self, name: str, content: bytes, called: str = "") -> None:
        """Store a file, replacing any of that name. Errors refer to it as ``called``, by default its name.

        Raises:
            StorageFull, InvalidInput, SQLAlchemyError: nothing was replaced.
        """
        self._set(name, content, called)

    def exchange(self, name: str, before: bytes | None, content: bytes, called: str = "") -> bool:
        """Store a file if its present content is ``before`` (None: missing). Returns whether it did (compare and swap).

        Raises:
            StorageFull, InvalidInput, SQLAlchemyError: nothing was replaced.
        """
        return self._set(name, content, called, lambda present: present == before)

    def delete(self, name: str) -> None:
        """Remove a file. Raises FileNotFoundError if there is none; StorageFull, InvalidInput, SQLAlchemyError."""
        if not self._set(name, None, ""):
            raise FileNotFoundError(name)


class FolderDocuments(Documents):
    """The files of a folder, which is made when the first is written, with the permissions ``mode``."""

    def __init__(self, folder: Path, mode: int = 0o777) -> None:
        self._folder = folder
        self._mode = mode

    def names(self) -> list[str]:
        """Names of the regular files in the folder, hidden ones left out, in no order; empty without the folder."""
        if not self._folder.is_dir():
            return []
        return [path.name for path in self._folder.iterdir() if path.is_file() and not path.name.startswith(".")]

    def read(self, name: str) -> bytes:
        """Content of a file. Raises FileNotFoundError, and OSError where it cannot be read."""
        return (self._folder / name).read_bytes()

    def stamp(self) -> object:
        """Time of the folder's change [ns], blind to writes into files; None within 2 s of it or without the folder."""
        try:
            changed_ns = self._folder.stat().st_mtime_ns
        except OSError:
            return None
        return changed_ns if time.time_ns() - changed_ns > _TICK_NS else None

    def _set(self, name: str, content: bytes | None, called: str, accepts: Accepts | None = None) -> bool:
        """Store a file, or remove it (``content`` None), in the locked folder. False if refused, or already missing."""
        path = self._folder / name
        if content is None and not path.exists():
            return False
        make_folder(self._folder, self._mode)
        with locked_folder(self._folder):
            if accepts is not None and not accepts(path.read_bytes() if path.exists() else None):
                return False
            if content is None:
                path.unlink()
            else:
                replace_file(path, content, called)
        return True


Document = TypeVar("Document")


class NamedDocuments(ABC, Generic[Document]):
    """Documents of one kind by name, as the files ``NAME.json``. Safe to share between threads and processes.

    Args:
        files: of the documents; or the folder in which each kind has its own, such as ``cameras``.
    """

    _folder: str
    _kind: str  # in messages
    _unknown: type[NotFound]
    _none_yet = "There are none yet."

    def __init__(self, files: Path | Documents) -> None:
        self._files = FolderDocuments(files / self._folder) if isinstance(files, Path) else files

    def names(self) -> list[str]:
        """The names of all documents, sorted; files with invalid names are left out."""
        names = [file.removesuffix(_SUFFIX) for file in self._files.names() if file.endswith(_SUFFIX)]
        return sorted(name for name in names if is_name(name))

    def get(self, name: str) -> Document:
        """The document of that name.

        Raises:
            InvalidName: it is not a valid name.
            NotFound: there is none; the error of its kind, such as UnknownCamera.
            InvalidInput: its file is damaged; the error of its kind, such as InvalidCamera.
        """
        try:
            return self._parsed(name, self._files.read(self._file_name(name)))
        except FileNotFoundError as error:
            raise self._missing(name) from error
        except OSError as error:
            raise self._unreadable(name) from error

    def delete(self, name: str) -> None:
        """Delete a document. Raises InvalidName, NotFound; StorageFull, InvalidInput, SQLAlchemyError."""
        try:
            self._files.delete(self._file_name(name))
        except FileNotFoundError as error:
            raise self._missing(name) from error

    @abstractmethod
    def _parsed(self, name: str, content: bytes) -> Document:
        """The document in a file's content. Raises InvalidInput, which calls it ``name``, if it holds none."""

    @abstractmethod
    def _unreadable(self, name: str) -> InvalidInput:
        """The error for a file that cannot be read."""

    def _file_name(self, name: str) -> str:
        """Name of a document's file. Raises InvalidName."""
        return check_name(name, self._kind) + _SUFFIX

    def _missing(self, name: str) -> NotFound:
        """Error for a document that is not there; its hint lists some that are."""
        names = self.names()
        return self._unknown(
            f"There is no {self._kind} {name}.", f"There are: {some_of(names)}." if names else self._none_yet
        )
