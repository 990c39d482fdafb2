"""Object storage: S3, Google Cloud Storage, Azure, or a folder. Stored objects never change."""

import contextlib
import errno
import os
import shutil
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from urllib.parse import unquote, urlsplit
from uuid import uuid4

import obstore
from obstore.exceptions import BaseError, NotFoundError, PermissionDeniedError, UnauthenticatedError
from obstore.store import from_url

from rholoc import telemetry
from rholoc.disk import is_full, reporting_full_disk, storage_full, sync_folder, write_file
from rholoc.errors import InvalidInput, MissingObject, StorageUnavailable

_SCHEMES = ("file", "s3", "gs", "az", "memory")
_PIECE_BYTES = 8 * 2**20
_TIMEOUT_S = 60.0  # of one request for an object, or a piece of one
_CONNECT_TIMEOUT_S = 5.0
_RETRY_FOR_S = 10.0
_MAX_BACKOFF_S = 1.0  # pause between two tries
_MAX_RETRIES = 1000  # the time is the limit
_ATTEMPTS = 100  # to write to a folder whose last object is being deleted


@dataclass(frozen=True)
class StoredObject:
    """An object as the storage lists it.

    Attributes:
        key: its name.
        size_bytes: its size.
        modified: when it was stored, seconds since the epoch.
    """

    key: str
    size_bytes: int
    modified: float


class ObjectStorage:
    """Objects by key. Each object has a new key, so that none is ever replaced.

    In a folder, the key is the object's relative path, and :meth:`put` is durable.

    Args:
        place: a folder, or the URL ``file:///folder``, ``s3://bucket/prefix``, ``gs://bucket/prefix`` or
            ``az://container/prefix``. Credentials, region and endpoint come from the environment, as each provider's
            own tools take them (``AWS_ACCESS_KEY_ID``, ``AWS_ENDPOINT_URL`` …); ``AWS_ALLOW_HTTP=true`` allows one
            without HTTPS.

    Raises:
        InvalidInput: not such a URL, or the folder cannot be made.
    """

    def __init__(self, place: str | Path) -> None:
        url = place.resolve().as_uri() if isinstance(place, Path) else place
        self._mode = 0o700 if isinstance(place, Path) else 0o777  # of folders: other machines may have other users
        parts = urlsplit(url)
        if parts.scheme not in _SCHEMES or (parts.scheme == "file" and (parts.netloc or parts.path in ("", "/"))):
            raise InvalidInput(  # without the text: it may hold a secret
                "RHOLOC_STORAGE_URL is not the URL of a storage.",
                "Give s3://bucket/prefix, gs://bucket/prefix, az://container/prefix, file:///folder, or nothing.",
            )
        self._folder = Path(unquote(parts.path)).resolve() if parts.scheme == "file" else None
        try:
            if parts.scheme == "file":
                self._store = from_url(url, mkdir=True)
            elif parts.scheme == "memory":
                self._store = from_url(url)
            else:
                self._store = from_url(
                    url,
                    client_options={
                        "timeout": timedelta(seconds=_TIMEOUT_S),
                        "connect_timeout": timedelta(seconds=_CONNECT_TIMEOUT_S),
                        "allow_http": _allows_http(),
                    },
                    retry_config={
                        "max_retries": _MAX_RETRIES,
                        "retry_timeout": timedelta(seconds=_RETRY_FOR_S),
                        "backoff": {"max_backoff": timedelta(seconds=_MAX_BACKOFF_S)},
                    },
                )
        except (BaseError, ValueError) as error:
            raise InvalidInput(f"RHOLOC_STORAGE_URL cannot be used: {_first_line(error)}.", "Check it.") from error

    def put(self, key: str, content: bytes | Path) -> None:
        """Store an object atomically, replacing any of that key: bytes, or the content of a file.

        Raises:
            StorageUnavailable: the storage does not answer or refuses.
            StorageFull: the folder's disk is full.
        """
        with _traced("put", key), _reporting("write to"):
            if self._folder is None:
                obstore.put(self._store, key, content, chunk_size=_PIECE_BYTES)
            else:
                _put_file(self._folder / key, content, self._mode)

    def put_folder(self, prefix: str, folder: Path, names: Iterable[str]) -> None:
        """Store files of a folder under the keys ``prefix/NAME``, and remove the folder.

        A folder in the same file system is renamed as a whole; its files must be synced to disk before. Otherwise the
        files are copied.

        Raises:
            StorageUnavailable, StorageFull: not all files are stored; the folder is not removed.
        """
        if self._folder is None or not self._take_folder(self._folder / prefix, folder):
            for name in names:
                self.put(f"{prefix}/{name}", folder / name)
            shutil.rmtree(folder, ignore_errors=True)

    def _take_folder(self, target: Path, folder: Path) -> bool:
        """Rename a folder into the storage. Returns False if it is in another file system, or there is one already.
        Raises StorageUnavailable, StorageFull.
        """
        with _reporting("write to"):
            target.parent.mkdir(parents=True, exist_ok=True)
            for inner in [folder, *(path for path in folder.rglob("*") if path.is_dir())]:
                sync_folder(inner)
            try:
                folder.rename(target)
            except OSError as error:
                if error.errno in (errno.EXDEV, errno.ENOTEMPTY, errno.EEXIST):
                    return False
                raise
            sync_folder(target.parent)
        return True

    def is_at(self, folder: Path) -> bool:
        """Whether the objects are files in this very folder."""
        return self._folder == folder.resolve()

    def fetch(self, key: str, target: Path) -> int:
        """Copy an object to a file; returns its size [bytes]. A failed copy leaves no file.

        Raises:
            MissingObject: no object has that key.
            StorageUnavailable: the storage does not answer or refuses.
            StorageFull: the disk is full.
        """
        arrived = target.with_name(f".{uuid4().hex}.part")
        size = 0
        try:
            with _traced("get", key), _reporting("read from"), reporting_full_disk(), arrived.open("wb") as file:
                found = obstore.get(self._store, key)
                for piece in found.stream(min_chunk_size=_PIECE_BYTES):
                    size += file.write(memoryview(piece))
                if size != found.meta["size"]:
                    raise StorageUnavailable(f"The storage broke off after {size} bytes of {key}.", "Try again later.")
            arrived.replace(target)
        finally:
            arrived.unlink(missing_ok=True)
        return size

    def read(self, key: str, start: int, length: int) -> bytes:
        """``length`` bytes of an object from ``start``, fewer at its end.

        Raises:
            MissingObject: no object has that key.
            StorageUnavailable: the storage does not answer or refuses.
        """
        with _traced("get", key), _reporting("read from"):
            return bytes(obstore.get_range(self._store, key, start=start, length=length))

    def delete(self, key: str) -> None:
        """Remove an object. A missing object is not an error.

        Raises:
            StorageUnavailable: the storage does not answer.
        """
        with _traced("delete", key), _reporting("delete from"), contextlib.suppress(NotFoundError, FileNotFoundError):
            obstore.delete(self._store, key)
            if self._folder is not None:
                with contextlib.suppress(OSError):  # not empty
                    (self._folder / key).parent.rmdir()

    def list(self, prefix: str) -> Iterator[StoredObject]:
        """Iterate over the objects below the folder ``prefix``.

        Raises:
            StorageUnavailable: the storage does not answer.
        """
        with _traced("list", prefix), _reporting("list"):
            for page in obstore.list(self._store, prefix):
                for meta in page:
                    yield StoredObject(meta["path"], meta["size"], meta["last_modified"].timestamp())


def _put_file(path: Path, content: bytes | Path, mode: int) -> None:
    """Write a file durably, in folders made with ``mode``. ``content``: bytes, or a file to copy."""
    for attempt in range(_ATTEMPTS):
        try:
            path.parent.mkdir(mode, parents=True, exist_ok=True)
            write_file(path, content if isinstance(content, bytes) else _pieces(content))
            return
        except (FileNotFoundError, FileExistsError):  # the last object beside it is deleted, and the folder with it
            if attempt == _ATTEMPTS - 1:
                raise


def _pieces(path: Path) -> Iterator[bytes]:
    """Iterate over a file's content in pieces of 8 MiB."""
    with path.open("rb") as file:
        while piece := file.read(_PIECE_BYTES):
            yield piece


def _traced(operation: str, key: str) -> AbstractContextManager[telemetry.Marks]:
    """Span of an operation on an object, if the present operation is traced."""
    return telemetry.span(f"storage {operation}", {"rholoc.storage.key": key}, of_others=True)


@contextmanager
def _reporting(doing: str) -> Iterator[None]:
    """Convert exceptions of the storage's library or disk to MissingObject, StorageFull or StorageUnavailable."""
    try:
        yield
    except (NotFoundError, FileNotFoundError) as error:
        raise MissingObject(
            "An object is missing in the storage.", "Check the storage, or restore a backup."
        ) from error
    except (PermissionDeniedError, UnauthenticatedError, PermissionError) as error:
        hint = "Check the credentials in the server's environment."
        raise StorageUnavailable(f"The server may not {doing} the storage.", hint) from error
    except BaseError as error:
        if "No space left" in str(error):
            raise storage_full() from error
        raise StorageUnavailable(f"The server cannot {doing} the storage.", "Try again later.") from error
    except OSError as error:
        if is_full(error):
            raise storage_full() from error
        raise StorageUnavailable(f"The server cannot {doing} the storage.", "Try again later.") from error


def _allows_http() -> bool:
    """Whether the environment allows unencrypted connections to the storage."""
    names = ("AWS_ALLOW_HTTP", "AZURE_ALLOW_HTTP", "GOOGLE_ALLOW_HTTP")
    return any(os.environ.get(name, "").lower() in ("1", "true") for name in names)


def _first_line(error: Exception) -> str:
    """First line of an error's text without its full stop; the error's class if it has no text."""
    return str(error).strip().splitlines()[0].rstrip(".") if str(error).strip() else type(error).__name__
