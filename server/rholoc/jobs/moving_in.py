"""What a single server has kept in its folders, brought into a storage that several share."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from rholoc.jobs.recording_notes import NOTE_FILES
from rholoc.jobs.recording_store import RecordingStore
from rholoc.jobs.shared_recordings import SharedRecordingStore
from rholoc.maps import FolderDocuments, MapLibrary
from rholoc.maps.cameras import FOLDER as CAMERA_FOLDER
from rholoc.maps.sites import SITES_FOLDER
from rholoc.storage import CAMERAS, KEYS, SITES, SharedStorage


@dataclass(frozen=True)
class MovedIn:
    """How much was brought in.

    Attributes:
        maps, cameras, sites, keys, recordings: how many.
        left: what was left where it is, for the storage has something of that name.
    """

    maps: int
    cameras: int
    sites: int
    keys: int
    recordings: int
    left: tuple[str, ...]


@dataclass(frozen=True)
class _Thing:
    """Something to bring in.

    Attributes:
        kind: what it is, in the plural.
        name: what it is called.
        present: whether the storage has one of that name.
        bring: brings in the one of that name.
    """

    kind: str
    name: str
    present: bool
    bring: Callable[[str], None]


def move_in(
    maps_dir: Path,
    data_dir: Path,
    shared: SharedStorage,
    advance: Callable[[float], None] = lambda fraction: None,
) -> MovedIn:
    """Copy maps with the versions before them, cameras, sites, keys and recordings; the folders stay as they are.

    What the storage has already is left, so that a copy that broke off can be made again.

    Args:
        maps_dir, data_dir: the folders.
        shared: the storage, open.
        advance: called with the share 0..1 that was done.

    Raises:
        StorageUnavailable, StorageFull, InvalidMap: what came before is there.
    """
    recordings = SharedRecordingStore(data_dir / "moving-in", shared)
    things = [
        *_maps(MapLibrary(maps_dir), shared.library),
        *_documents("cameras", FolderDocuments(maps_dir / CAMERA_FOLDER), shared, CAMERAS),
        *_documents("sites", FolderDocuments(maps_dir / SITES_FOLDER), shared, SITES),
        *_documents("keys", FolderDocuments(data_dir / KEYS), shared, KEYS),
        *_recordings(RecordingStore(data_dir), recordings),
    ]
    counts = {"maps": 0, "cameras": 0, "sites": 0, "keys": 0, "recordings": 0}
    for number, thing in enumerate(things, start=1):
        if not thing.present:
            thing.bring(thing.name)
            counts[thing.kind] += 1
        advance(number / len(things))
    shutil.rmtree(data_dir / "moving-in", ignore_errors=True)
    return MovedIn(**counts, left=tuple(f"{thing.kind}: {thing.name}" for thing in things if thing.present))


def _maps(folder: MapLibrary, library: MapLibrary) -> Sequence[_Thing]:
    present = set(library.names())

    def bring(name: str) -> None:
        for number in sorted(folder.versions(name), reverse=True):
            library.put_file(name, folder.previous_path(name, number))
        library.put_file(name, folder.path(name))

    return [_Thing("maps", name, name in present, bring) for name in folder.names()]


def _documents(kind: str, folder: FolderDocuments, shared: SharedStorage, into: str) -> Sequence[_Thing]:
    files = shared.documents(into)
    present = set(files.names())

    def bring(name: str) -> None:
        files.write(name, folder.read(name))

    return [_Thing(kind, name, name in present, bring) for name in sorted(folder.names())]


def _recordings(folder: RecordingStore, store: SharedRecordingStore) -> Sequence[_Thing]:
    present = {entry.id for entry in store.list()}

    def bring(recording_id: str) -> None:
        source = folder.folder(recording_id)
        store.take_in(source, folder.get(recording_id))
        for name in NOTE_FILES:
            if (source / name).is_file():
                shutil.copyfile(source / name, store.folder(recording_id) / name)
                store.share_notes(recording_id, [name])

    return [_Thing("recordings", one.id, one.id in present, bring) for one in folder.list()]
