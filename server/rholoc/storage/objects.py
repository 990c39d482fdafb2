"""Object storage: S3, Google Cloud Storage, Azure, or a folder, by URL. What is stored never changes."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from urllib.parse import urlsplit
from uuid import uuid4

import obstore
from obstore.exceptions import BaseError, NotFoundError, PermissionDeniedError, UnauthenticatedError
from obstore.store import from_url

from rholoc import telemetry
from rholoc.disk import is_full, reporting_full_disk, storage_full
from rholoc.errors import InvalidInput, StorageUnavailable

_SCHEMES = ("file", "s3", "gs", "az", "memory")
_PIECE_BYTES = 8 * 2**20
_TIMEOUT_S = 60.0  # of one request for an object, or a piece of one
_CONNECT_TIMEOUT_S = 5.0
_RETRY_FOR_S = 20.0
_RETRIES = 5


class MissingObject(StorageUnavailable):
    """The catalogue names an object that the storage does not have (any more)."""


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
    """Objects by key. Keys are made new for each object, so that nothing is ever replaced.

    Args:
        url: ``file:///folder``, ``s3://bucket/prefix``, ``gs://bucket/prefix`` or ``az://container/prefix``.
            Credentials, region and endpoint come from the environment, as each provider's own tools take them
            (``AWS_ACCESS_KEY_ID``, ``AWS_ENDPOINT_URL`` …); ``AWS_ALLOW_HTTP=true`` allows one without HTTPS.

    Raises:
        InvalidInput: it is not such a URL, or the folder cannot be made.
    """

    def __init__(self, url: str) -> None:
        self._folder: Path | None = None
        parts = urlsplit(url)
        if parts.scheme not in _SCHEMES or (parts.scheme == "file" and (parts.netloc or parts.path in ("", "/"))):
            raise InvalidInput(  # without the text: it may hold a secret
                "RHOLOC_STORAGE_URL is not the URL of a storage.",
                "Give s3://bucket/prefix, gs://bucket/prefix, az://container/prefix, file:///folder, or nothing.",
            )
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
                    retry_config={"max_retries": _RETRIES, "retry_timeout": timedelta(seconds=_RETRY_FOR_S)},
                )
        except (BaseError, ValueError) as error:
            raise InvalidInput(f"RHOLOC_STORAGE_URL cannot be used: {_first_line(error)}.", "Check it.") from error

    def put(self, key: str, content: bytes | Path) -> None:
        """Store an object, whole or not at all.

        Raises:
            StorageUnavailable: the storage does not take it.
            StorageFull: it is a folder on a disk that is full.
        """
        with _traced("put", key), _reporting("write to"):
            obstore.put(self._store, key, content, chunk_size=_PIECE_BYTES)

    def fetch(self, key: str, target: Path) -> int:
        """Copy an object into a file; returns its size in bytes. A copy that breaks off leaves no file.

        Raises:
            MissingObject: there is none of that key.
            StorageUnavailable: the storage does not give it.
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

    def delete(self, key: str) -> None:
        """Remove an object; one that is not there is none the worse for it.

        Raises:
            StorageUnavailable: the storage does not answer.
        """
        with _traced("delete", key), _reporting("delete from"), contextlib.suppress(NotFoundError, FileNotFoundError):
            obstore.delete(self._store, key)

    def list(self, prefix: str) -> Iterator[StoredObject]:
        """The objects whose keys begin with a folder's name.

        Raises:
            StorageUnavailable: the storage does not answer.
        """
        with _traced("list", prefix), _reporting("list"):
            for page in obstore.list(self._store, prefix):
                for meta in page:
                    yield StoredObject(meta["path"], meta["size"], meta["last_modified"].timestamp())


def _traced(operation: str, key: str) -> AbstractContextManager[telemetry.Marks]:
    return telemetry.span(f"storage {operation}", {"rholoc.storage.key": key}, of_others=True)


@contextmanager
def _reporting(doing: str) -> Iterator[None]:
    """Turn what the library raises into errors for people."""
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
    """Whether the environment allows a storage in the same network to be spoken to in clear text."""
    names = ("AWS_ALLOW_HTTP", "AZURE_ALLOW_HTTP", "GOOGLE_ALLOW_HTTP")
    return any(os.environ.get(name, "").lower() in ("1", "true") for name in names)


def _first_line(error: Exception) -> str:
    return str(error).strip().splitlines()[0].rstrip(".") if str(error).strip() else type(error).__name__
