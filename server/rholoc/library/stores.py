"""The stores of a service: its own folders, or a storage and database shared by several servers."""

import math
from pathlib import Path

from rholoc.disk import reporting_full_disk
from rholoc.lazy import lazy
from rholoc.library.folder_documents import Documents, FolderDocuments
from rholoc.library.maps import MapLibrary
from rholoc.library.recordings import RecordingStore
from rholoc.library.shared_documents import StoredDocuments
from rholoc.library.shared_maps import ActOnPublishing, StoredMaps
from rholoc.storage import ObjectStorage
from rholoc.storage.database import check_database, database_engine, reporting_full_database
from rholoc.storage.object_cache import ObjectCache
from rholoc.storage.replica import Replica

ASKERS, CAMERAS, KEYS, SITES = "askers", "cameras", "keys", "sites"  # kinds of small files
_MAPS, _COPIES = "maps", "copies"
_CATALOGUE = "catalogue.json"  # as it was last seen


def documents_folder(kind: str, maps_dir: Path, data_dir: Path) -> Path:
    """Folder of one server's small files of one kind: of :data:`CAMERAS` and :data:`SITES` that subfolder of
    ``maps_dir``, of :data:`KEYS` that of ``data_dir``, of :data:`ASKERS` ``data_dir`` itself.
    """
    folders = {
        CAMERAS: maps_dir / CAMERAS,
        SITES: maps_dir / SITES,
        KEYS: data_dir / KEYS,
        ASKERS: data_dir,
    }
    return folders[kind]


def folder_documents(kind: str, maps_dir: Path, data_dir: Path) -> FolderDocuments:
    """A single server's small files of one kind. Keys are readable by the owner only."""
    return FolderDocuments(documents_folder(kind, maps_dir, data_dir), mode=0o700 if kind == KEYS else 0o777)


class Stores:
    """The stores of one process. Disk, storage and database are first accessed when a store is first used.

    Recordings, uploads, queries and jobs are objects and database rows. Maps and small files are files that people may
    edit (``maps_dir/NAME.rho``), or objects and rows if other machines share them.

    Args:
        maps_dir, data_dir: the service's folders.
        database_url: ``postgresql://…``, or None for the SQLite file in ``data_dir``.
        storage_url: URL of the storage shared with other machines, as :class:`ObjectStorage` takes it, or None for the
            folders.
        copies_bytes: disk space for copies of shared maps.
        cache_bytes: memory for cached maps.

    Raises:
        InvalidInput: a URL is not valid.
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
        self.engine = database_engine(data_dir, database_url)
        self._replica: Replica | None = None
        self.copies: ObjectCache | None = None
        if storage_url is None:
            self.library = MapLibrary(self.maps_dir, cache_bytes)
        else:
            self.objects = ObjectStorage(storage_url)
            self.copies = ObjectCache(self.objects, _MAPS, self.data_dir / _COPIES, copies_bytes)
            self._replica = Replica(self.engine, self.copies.follow, self.copies.has_followed)
            self.library = MapLibrary(StoredMaps(self._replica, self.copies), cache_bytes)

    @property
    def are_shared(self) -> bool:
        """Whether maps and small files are in storage and database that other machines may share."""
        return self._replica is not None

    @lazy
    def objects(self) -> ObjectStorage:
        """The storage of recordings, uploads and queries; that of maps too if it is shared."""
        return ObjectStorage(self.data_dir)

    @lazy
    def recordings(self) -> RecordingStore:
        """The store of recordings, opened on first use. Raises StorageFull."""
        return RecordingStore(self.data_dir, self.objects, self.engine)

    def documents(self, kind: str) -> Documents:
        """The small files of one kind."""
        if self._replica is not None:
            return StoredDocuments(self._replica, kind)
        return folder_documents(kind, self.maps_dir, self.data_dir)

    def library_acting(self, act: ActOnPublishing) -> MapLibrary:
        """The library of maps, with ``act`` called in each transaction that publishes one to shared storage.

        If ``act`` raises, nothing is published. Folders have no such transaction, and ``act`` is not called.
        """
        if self._replica is None or self.copies is None:
            return self.library
        return MapLibrary(StoredMaps(self._replica, self.copies, act))

    def open(self, follow: bool = False) -> None:
        """Connect to the database once, create its tables if they are missing, and read the catalogue.

        Args:
            follow: whether to :meth:`follow` as well.

        Raises:
            StorageFull: the disk is full.
            StorageUnavailable: the database does not answer.
            InvalidInput: PostgreSQL refuses the connection.
            Conflict: the file is not an SQLite database.
        """
        check_database(self.engine)
        if self.copies is not None:
            with reporting_full_disk():
                self.copies.folder.mkdir(parents=True, exist_ok=True)
        with reporting_full_database():
            self.refresh()
        if follow:
            self.follow()

    def recall(self) -> None:
        """Use the catalogue's last saved state until :meth:`open` succeeds; does nothing without shared storage."""
        if self._replica is not None and self.copies is not None:
            self._replica.recall(self.copies.folder / _CATALOGUE)

    def follow(self) -> None:
        """Refresh continually in a thread, until :meth:`close`; does nothing without shared storage."""
        if self._replica is not None:
            self._replica.follow()

    def refresh(self) -> None:
        """Load other machines' changes. Raises SQLAlchemyError if the database does not answer."""
        if self._replica is not None:
            self._replica.refresh()

    def close(self) -> None:
        """Stop following, and close the connections."""
        if self._replica is not None:
            self._replica.close()
        self.engine.dispose()
