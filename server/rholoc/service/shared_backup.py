"""Everything that servers share and cannot make again, in one file, and back.

The file is the one of :mod:`rholoc.service.backup`: what one service wrote a single server can restore, and the other
way around.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import asdict
from pathlib import Path
from uuid import uuid4

from rholoc.disk import reporting_full_disk
from rholoc.errors import Conflict, UnknownRecording
from rholoc.jobs import SharedRecordingStore, move_in
from rholoc.jobs.recording_notes import NOTE_FILES
from rholoc.jobs.recording_store import ENTRY_FILE
from rholoc.maps import FolderDocuments, MapLibrary
from rholoc.maps.cameras import FOLDER as CAMERA_FOLDER
from rholoc.maps.rho_file import load_info
from rholoc.maps.sites import SITES_FOLDER
from rholoc.service.backup import Manifest, unpack_backup, write_backup
from rholoc.service.keys import FOLDER as KEY_FOLDER
from rholoc.storage import CAMERAS, KEYS, SITES, MissingObject, SharedStorage

_FOLDERS = {CAMERAS: f"maps/{CAMERA_FOLDER}", SITES: f"maps/{SITES_FOLDER}", KEYS: f"data/{KEY_FOLDER}"}
_ATTEMPTS = 5


def back_up_shared(file: Path, shared: SharedStorage, data_dir: Path, recordings: bool = False) -> Manifest:
    """Write what :func:`rholoc.service.backup.back_up` does, of servers that share a storage; they may run meanwhile.

    Args:
        file: the backup.
        shared: the storage, open.
        data_dir: where files are while they are written.
        recordings: whether recordings are written, too.

    Raises:
        Conflict, InvalidInput, StorageFull: as there.
        StorageUnavailable: the storage does not give a file.
    """
    for attempt in range(_ATTEMPTS):
        try:
            return write_backup(file, _fetched(shared, data_dir, recordings))
        except MissingObject:  # it was replaced or deleted, and removed, since the catalogue was read
            if attempt == _ATTEMPTS - 1:
                raise
    raise AssertionError("unreachable")


def restore_shared(file: Path, shared: SharedStorage, data_dir: Path) -> Manifest:
    """Bring everything in a backup into a storage; nothing that is there is replaced.

    What is there as it is in the backup is left, so that one that broke off can be restored again.

    Args:
        file: the backup.
        shared: the storage, open.
        data_dir: where files are until they are in the storage.

    Raises:
        InvalidInput: the file is none, was cut off or changed, or cannot be read. Nothing was restored.
        Conflict: something of it is there and is different; says what. Nothing was restored.
        StorageUnavailable, StorageFull: what came before is there; try again.
    """
    with _empty_folder(data_dir) as folder:
        maps_dir, data = folder / "maps", folder / "data"
        manifest = unpack_backup(file, maps_dir, data)
        other = [*_other_maps(MapLibrary(maps_dir), shared), *_other_documents(folder, shared)]
        if other:
            raise Conflict(
                f"{len(other)} of the backup's files exist already and are different: {', '.join(other[:3])}. "
                "Nothing was restored.",
                "Restore into an empty storage and database.",
            )
        move_in(maps_dir, data, shared)
    return manifest


def _fetched(
    shared: SharedStorage, data_dir: Path, recordings: bool
) -> AbstractContextManager[Iterable[tuple[str, Path]]]:
    @contextmanager
    def fetched() -> Iterator[Iterable[tuple[str, Path]]]:
        with _empty_folder(data_dir) as folder:
            yield _files(shared, folder, recordings)

    return fetched()


def _files(shared: SharedStorage, folder: Path, recordings: bool) -> Iterator[tuple[str, Path]]:
    """Paths in the backup and files, each of which is gone when the next one is asked for."""
    maps, documents = shared.snapshot()
    file, library = folder / "file", MapLibrary(folder)
    for one in maps:
        shared.library.fetch(one, file)
        path = library.previous_path(one.name, one.number) if one.number else library.path(one.name)
        yield f"maps/{path.relative_to(folder).as_posix()}", file
    for name, content in documents.items():
        kind, _, rest = name.partition("/")
        if kind in _FOLDERS:
            file.write_bytes(content)
            yield f"{_FOLDERS[kind]}/{rest}", file
    if recordings:
        yield from _recordings(SharedRecordingStore(folder, shared))


def _recordings(store: SharedRecordingStore) -> Iterator[tuple[str, Path]]:
    for entry in store.list():
        try:
            path, notes = f"data/recordings/{entry.id}", store.folder(entry.id)
            store.path(entry.id)
        except UnknownRecording:  # it was deleted meanwhile
            continue
        (notes / ENTRY_FILE).write_text(json.dumps(asdict(entry)), encoding="utf-8")
        for name in (ENTRY_FILE, *NOTE_FILES, *entry.files):
            if (notes / name).is_file():
                yield f"{path}/{name}", notes / name
        store.release(entry.id)


def _other_maps(folder: MapLibrary, shared: SharedStorage) -> Iterator[str]:
    """The maps of a folder of which the storage has others."""
    present = set(shared.library.names())
    for name in folder.names():
        if name in present and load_info(shared.library.path(name)) != load_info(folder.path(name)):
            yield f"maps/{folder.path(name).name}"


def _other_documents(folder: Path, shared: SharedStorage) -> Iterator[str]:
    """The small files of folders of which the storage has others."""
    for kind, path in _FOLDERS.items():
        files, stored = FolderDocuments(folder / path), shared.documents(kind)
        for name in set(files.names()) & set(stored.names()):
            if files.read(name) != stored.read(name):
                yield f"{path}/{name}"


@contextmanager
def _empty_folder(data_dir: Path) -> Iterator[Path]:
    """A folder beside the data, removed in the end."""
    folder = data_dir / f".{uuid4().hex}.backup"
    with reporting_full_disk():
        folder.mkdir(parents=True)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
