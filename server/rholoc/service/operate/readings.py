"""What probes and metrics say of the database, the storage and the disks, as last known."""

from __future__ import annotations

import asyncio
import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rholoc.errors import StorageUnavailable
from rholoc.jobs import JobQueue, Stores
from rholoc.service.settings import Settings
from rholoc.service.threads.last_known import LastKnown
from rholoc.storage import ObjectStorage

OK = "ok"
_MIN_FREE_BYTES = 2**26
_PROBED = "probe"  # a folder of the storage in which nothing lies


class Readings:
    """The last known state of what a server depends on. Use it from the event loop's thread only.

    Args:
        settings: name the folders.
        jobs: the queue.
        stores: where the maps are.
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
        """Ask for everything, waiting a quarter of a second at most."""
        await asyncio.gather(*(one.refresh() for one in self._all))

    def job_ages(self) -> Mapping[str, float]:
        """Age of the last known numbers of jobs in seconds; empty while they were never known."""
        age_s = self.jobs.age_s
        return {} if age_s is None else {"now": age_s}

    def close(self) -> None:
        """Ask no more."""
        for one in self._all:
            one.close()


def text_of(known: LastKnown[str], what: str) -> str:
    """A reading in words: what was read, or that it is not answered."""
    return unanswered(known, what) or known.value


def unanswered(known: LastKnown[Any], what: str) -> str:
    """Why a reading is out of date, with its age; empty if it is not."""
    if known.error is None and known.unanswered_s < 1 and known.age_s is not None:
        return ""
    cause = f" ({type(known.error).__name__})" if known.error is not None else ""
    age = "" if known.age_s is None else f"; last known {known.age_s:.0f} s ago"
    return f"{what} does not answer{cause}{age}"


def _folder(folder: Path) -> str:
    if not folder.is_dir():
        return "the folder is missing"
    if not os.access(folder, os.R_OK | os.W_OK | os.X_OK) or os.statvfs(folder).f_flag & os.ST_RDONLY:
        return "the folder cannot be read and written"
    return OK if shutil.disk_usage(folder).free >= _MIN_FREE_BYTES else "the disk is full"


def _storage(objects: ObjectStorage) -> str:
    try:
        next(iter(objects.list(_PROBED)), None)
    except StorageUnavailable:
        return "the storage does not answer"
    return OK
