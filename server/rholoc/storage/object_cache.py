"""Cache of stored objects on the server's disk, with least-recently-used eviction.

Copies are evicted before the disk is full, to leave room for files that cannot be evicted.
"""

import os
import shutil
import threading
import time
import uuid
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from rholoc.disk import reporting_full_disk
from rholoc.errors import StorageFull, StorageUnavailable
from rholoc.storage.objects import ObjectStorage
from rholoc.storage.replica import MapRow

_SUFFIX = ".rho"
_BROKEN_OFF_AFTER_S = 3600.0
_FREE_SHARE, _MAX_FREE_BYTES = 0.1, 2**30  # of the disk to leave free for other files


class ObjectCache:
    """Copies of objects, fetched on first use. Safe to share between threads and processes.

    Args:
        objects: the storage.
        prefix: of the objects' keys.
        folder: of the copies.
        most_bytes: maximum size of all copies.
    """

    def __init__(self, objects: ObjectStorage, prefix: str, folder: Path, most_bytes: float) -> None:
        self._objects = objects
        self._prefix = prefix
        self.folder = folder
        self._most_bytes = most_bytes
        self._fetching: dict[str, threading.Lock] = {}
        self._lock = threading.Lock()

    def store(self, file: Path) -> str:
        """Store a file's content as a new object; returns the object's name. The file becomes the copy.

        Raises:
            StorageUnavailable, StorageFull: nothing was stored; the file stays where it is.
        """
        blob = uuid.uuid4().hex
        self._objects.put(self._key(blob), file)
        file.replace(self._path(blob))
        self.make_room(blob)
        return blob

    def path(self, blob: str, size_bytes: int) -> Path:
        """Path of an object's copy, fetched if it is missing.

        Raises:
            MissingObject: there is no such object. StorageUnavailable, StorageFull: it cannot be fetched, or its size
                differs.
        """
        path = self._path(blob)
        with suppress(FileNotFoundError):
            os.utime(path)
            return path
        with self._lock:
            fetching = self._fetching.setdefault(blob, threading.Lock())
        try:
            with fetching:
                if not path.is_file():
                    self._fetch(blob, size_bytes, path)
        finally:
            with self._lock:
                self._fetching.pop(blob, None)
        return path

    def fetch(self, blob: str, size_bytes: int, target: Path) -> None:
        """Copy an object to ``target``, outside the cache. Raises MissingObject, StorageUnavailable, StorageFull; then
        there is no file.
        """
        size = self._objects.fetch(self._key(blob), target)
        if size != size_bytes:
            target.unlink()
            raise StorageUnavailable(f"The storage gave {size} bytes of a map of {size_bytes}.", "Try again later.")

    def read(self, blob: str, start: int, length: int) -> bytes:
        """``length`` bytes of an object from ``start``, of its copy or from the storage, without caching. Raises as
        :meth:`ObjectStorage.read`.
        """
        with suppress(FileNotFoundError), self._path(blob).open("rb") as file:
            file.seek(start)
            return file.read(length)
        return self._objects.read(self._key(blob), start, length)

    def follow(self, before: MapRow, after: MapRow) -> None:
        """Fetch a map's new file if the old one is cached, so that the next request need not wait for it.

        Raises:
            StorageUnavailable, StorageFull: it cannot be fetched.
        """
        if not self.has_followed(before, after):
            self.path(after.blob, after.size_bytes)

    def has_followed(self, before: MapRow, after: MapRow) -> bool:
        """Whether :meth:`follow` would fetch nothing: the new file is cached, or the old one is not."""
        return self.has(after.blob) or not self.has(before.blob)

    def has(self, blob: str) -> bool:
        """Whether an object is cached."""
        return self._path(blob).is_file()

    def stored(self) -> Iterator[tuple[str, float]]:
        """Names of all objects in the storage, and the times at which they were stored [s since the epoch].

        Raises:
            StorageUnavailable: the storage does not answer.
        """
        for one in self._objects.list(self._prefix):
            if one.key.endswith(_SUFFIX):
                yield one.key.rpartition("/")[2].removesuffix(_SUFFIX), one.modified

    def remove(self, blob: str) -> None:
        """Remove an object and its copy.

        Raises:
            StorageUnavailable: the storage does not answer.
        """
        self._objects.delete(self._key(blob))
        self._path(blob).unlink(missing_ok=True)

    def _fetch(self, blob: str, size_bytes: int, path: Path) -> None:
        """Fetch an object to ``path``, evicting other copies if the disk is full."""
        with reporting_full_disk():
            self.folder.mkdir(parents=True, exist_ok=True)
        arrived = path.with_name(f".{uuid.uuid4().hex}.arrived")
        try:
            try:
                self.fetch(blob, size_bytes, arrived)
            except StorageFull:  # maybe of copies
                self.make_room(blob, size_bytes)
                self.fetch(blob, size_bytes, arrived)
            arrived.replace(path)
        finally:
            arrived.unlink(missing_ok=True)
        self.make_room(blob)

    def sweep(self) -> None:
        """Remove partial files, older than an hour, of interrupted fetches and uploads."""
        old = time.time() - _BROKEN_OFF_AFTER_S
        for path in [*self.folder.glob(".*.part"), *self.folder.glob(".*.arrived"), *self.folder.glob(".*.upload")]:
            with suppress(FileNotFoundError):
                if path.stat().st_mtime < old:
                    path.unlink()

    def make_room(self, kept: str = "", size_bytes: int = 0) -> None:
        """Evict the least recently used copies above their maximum size, or while a tenth of the disk (1 GiB at most)
        is not free.

        Nothing is raised if too little could be freed.

        Args:
            kept: name of an object not to evict.
            size_bytes: minimum number of bytes to free.
        """
        found = self._found()
        disk = shutil.disk_usage(self.folder)
        lacking = min(_FREE_SHARE * disk.total, _MAX_FREE_BYTES) - disk.free
        surplus = max(sum(size for _, size, _ in found) - self._most_bytes, lacking, size_bytes)
        for _, size, path in sorted(found):
            if surplus <= 0:
                return
            if path.stem != kept:
                path.unlink(missing_ok=True)
                surplus -= size

    def _found(self) -> list[tuple[float, int, Path]]:
        """Time of last use, size and path of each copy."""
        found = []
        for path in self.folder.glob(f"*{_SUFFIX}"):
            with suppress(FileNotFoundError):
                status = path.stat()
                found.append((status.st_mtime, status.st_size, path))
        return found

    def _key(self, blob: str) -> str:
        """Key in the storage of the object of that name."""
        return f"{self._prefix}/{blob}{_SUFFIX}"

    def _path(self, blob: str) -> Path:
        """Path of the object's copy, whether there is one or not."""
        return self.folder / f"{blob}{_SUFFIX}"
