"""Last known state of database, storage and disks, for probes and metrics."""

import asyncio
import os
import shutil
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Generic, TypeVar

from rholoc.errors import StorageUnavailable
from rholoc.jobs import JobQueue
from rholoc.library.stores import Stores
from rholoc.service.settings import Settings
from rholoc.storage import ObjectStorage

OK = "ok"
_MIN_FREE_BYTES = 2**26
_PROBED = "probe"  # an empty folder of the storage


T = TypeVar("T")

_WAIT_S = 0.25


class LastKnown(Generic[T]):
    """The last value of a slow function, called in a background thread, once at a time.

    Args:
        read: the function. An exception that it raises becomes ``error``, and ``value`` stays.
        initial: the value until ``read`` has returned once.
    """

    def __init__(self, read: Callable[[], T], initial: T) -> None:
        self._read = read
        self._executor = ThreadPoolExecutor(1, thread_name_prefix="rholoc-storage-known")
        self._begun_s: float | None = None
        self._under_way: asyncio.Future[T] | None = None
        self._known_s: float | None = None
        self.value = initial
        self.error: Exception | None = None

    @property
    def unanswered_s(self) -> float:
        """Duration of the present call so far [s]; 0 without one."""
        return 0.0 if self._under_way is None or self._begun_s is None else time.monotonic() - self._begun_s

    @property
    def age_s(self) -> float | None:
        """The age of the value in seconds; None if it is the initial one."""
        return None if self._known_s is None else time.monotonic() - self._known_s

    async def refresh(self) -> None:
        """Call the function again, once for concurrent callers, and wait at most 0.25 s for it.

        Its value replaces the last one, also if it comes later.
        """
        if self._under_way is None:
            self._begun_s = time.monotonic()
            self._under_way = asyncio.wrap_future(self._executor.submit(self._read))
            self._under_way.add_done_callback(self._take)
        if self._under_way is not None:
            await asyncio.wait({self._under_way}, timeout=_WAIT_S)

    def close(self) -> None:
        """Start no more calls; does not wait for the present one."""
        self._executor.shutdown(wait=False, cancel_futures=True)

    def _take(self, answered: asyncio.Future[T]) -> None:
        """Take the value or error of the call that has ended."""
        self._under_way = None
        if answered.cancelled():
            return
        error = answered.exception()
        if isinstance(error, Exception):
            self.error = error
        else:
            self.value, self.error, self._known_s = answered.result(), None, time.monotonic()


class Readings:
    """Last known state of a server's database, storage and disks. Use it from the event loop's thread only.

    Args:
        settings: with the folders.
        jobs: the queue.
        stores: with the maps.
    """

    def __init__(self, settings: Settings, jobs: JobQueue, stores: Stores) -> None:
        def storage() -> str:
            return _storage(stores.objects) if stores.are_shared else _folder(settings.maps_dir)

        def worker() -> str:
            if jobs.has_worker():
                return OK
            return jobs.worker_trouble() or "no worker is running; jobs wait for one"

        self.maps = LastKnown(storage, "not known yet")
        self.data = LastKnown(lambda: _folder(settings.data_dir), "not known yet")
        self.jobs: LastKnown[Mapping[str, float]] = LastKnown(
            lambda: {str(state): n for state, n in jobs.counts().items()}, {}
        )
        self.waiting: LastKnown[Mapping[str, float]] = LastKnown(
            lambda: {str(obstacle or "none"): n for obstacle, n in jobs.waiting().items()}, {}
        )
        self.worker = LastKnown(worker, "not known yet")
        self._all = (self.maps, self.data, self.jobs, self.waiting, self.worker)

    async def refresh(self) -> None:
        """Refresh all values; waits at most 0.25 s."""
        await asyncio.gather(*(one.refresh() for one in self._all))

    def job_ages(self) -> Mapping[str, float]:
        """Age of the last known job counts [s], as "now"; empty before the first."""
        age_s = self.jobs.age_s
        return {} if age_s is None else {"now": age_s}

    def close(self) -> None:
        """Start no more calls."""
        for one in self._all:
            one.close()


def text_of(known: LastKnown[str], what: str) -> str:
    """A reading in words: why it is out of date (:func:`unanswered`), else its value; ``what`` names the thing read."""
    return unanswered(known, what) or known.value


def unanswered(known: LastKnown[Any], what: str) -> str:
    """Why a reading of ``what`` is out of date (failed, silent for 1 s, none yet), with its age; empty if not."""
    if known.error is None and known.unanswered_s < 1 and known.age_s is not None:
        return ""
    cause = f" ({type(known.error).__name__})" if known.error is not None else ""
    age = "" if known.age_s is None else f"; last known {known.age_s:.0f} s ago"
    return f"{what} does not answer{cause}{age}"


def _folder(folder: Path) -> str:
    """OK, or what is wrong with a folder."""
    if not folder.is_dir():
        return "the folder is missing"
    if not os.access(folder, os.R_OK | os.W_OK | os.X_OK) or os.statvfs(folder).f_flag & os.ST_RDONLY:
        return "the folder cannot be read and written"
    return OK if shutil.disk_usage(folder).free >= _MIN_FREE_BYTES else "the disk is full"


def _storage(objects: ObjectStorage) -> str:
    """OK, or that the storage does not answer."""
    try:
        next(iter(objects.list(_PROBED)), None)
    except StorageUnavailable:
        return "the storage does not answer"
    return OK
