"""Where a service keeps what it holds: in folders of its own, or in what several servers share."""

from __future__ import annotations

import math
from pathlib import Path

from rholoc.jobs.recording_store import RecordingStore
from rholoc.lazy import lazy
from rholoc.maps import Documents, FolderDocuments, MapLibrary
from rholoc.maps.cameras import FOLDER as CAMERAS_FOLDER
from rholoc.maps.sites import SITES_FOLDER
from rholoc.storage import ASKERS, CAMERAS, KEYS, SITES, ObjectStorage, SharedStorage
from rholoc.storage.database import check_database, database_engine


class Stores:
    """The stores of one process. Nothing is asked of disk, storage or database before a store is first used.

    Args:
        maps_dir, data_dir: the service's folders.
        database_url: ``postgresql://…``, or None for the SQLite file in ``data_dir``.
        storage_url: URL of the storage shared with other machines, or None for the folders.
        copies_bytes: what copies of shared maps may take on this disk.
        cache_bytes: what maps may take in memory.

    Raises:
        InvalidInput: an URL is not valid.
    """

    def __init__(
        self,
        maps_dir: Path,
        data_dir: Path,
        database_url: str | None = None,
        storage_url: str | None = None,
        copies_bytes: float = math.inf,
        cache_bytes: float = math.inf,
    ) -> None:
        self.maps_dir, self.data_dir = Path(maps_dir), Path(data_dir)
        self.shared: SharedStorage | None = None
        if storage_url is not None:
            self.shared = SharedStorage(storage_url, data_dir, database_url, copies_bytes, cache_bytes)
        self.engine = database_engine(data_dir, database_url) if self.shared is None else self.shared.engine
        self.library = MapLibrary(self.maps_dir, cache_bytes) if self.shared is None else self.shared.library

    @lazy
    def objects(self) -> ObjectStorage:
        """The storage of everything but maps and small files."""
        return ObjectStorage(self.data_dir) if self.shared is None else self.shared.objects

    @lazy
    def recordings(self) -> RecordingStore:
        """The recordings."""
        return RecordingStore(self.data_dir, self.objects, self.engine)

    def documents(self, kind: str) -> Documents:
        """The small files of one kind."""
        if self.shared is not None:
            return self.shared.documents(kind)
        if kind == KEYS:
            return FolderDocuments(self.data_dir / KEYS, mode=0o700)
        folders = {CAMERAS: self.maps_dir / CAMERAS_FOLDER, SITES: self.maps_dir / SITES_FOLDER, ASKERS: self.data_dir}
        return FolderDocuments(folders[kind])

    def open(self) -> None:
        """Connect to the database once, and read the catalogue if it is shared.

        Raises: as :meth:`SharedStorage.open`.
        """
        if self.shared is None:
            check_database(self.engine)
        else:
            self.shared.open()

    def close(self) -> None:
        """Close the connections."""
        if self.shared is None:
            self.engine.dispose()
        else:
            self.shared.close()
