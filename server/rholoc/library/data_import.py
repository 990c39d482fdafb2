"""Copy a single server's folders into other stores."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from rholoc.errors import InvalidMap
from rholoc.library.folder_documents import Documents, FolderDocuments
from rholoc.library.maps import MapLibrary
from rholoc.library.recordings import ENTRY_FILE, RecordingStore
from rholoc.library.stores import CAMERAS, KEYS, SITES, Stores, folder_documents


@dataclass(frozen=True)
class ImportedData:
    """Result of a copy.

    Attributes:
        maps, cameras, sites, keys, recordings: numbers copied.
        left: names not copied, because the stores have something of that name.
        unreadable: maps whose current version was not copied, because its file is damaged; their previous versions are
            copied.
    """

    maps: int
    cameras: int
    sites: int
    keys: int
    recordings: int
    left: tuple[str, ...]
    unreadable: tuple[str, ...]


@dataclass(frozen=True)
class _Thing:
    """Something to copy.

    Attributes:
        kind: its kind, in the plural.
        name: of the thing.
        present: whether the stores have one of that name.
        bring: copies the one of that name.
    """

    kind: str
    name: str
    present: bool
    bring: Callable[[str], None]


def import_data(
    maps_dir: Path, data_dir: Path, stores: Stores, advance: Callable[[float], None] = lambda fraction: None
) -> ImportedData:
    """Copy maps with their previous versions, cameras, sites, keys and recordings; the folders stay unchanged.

    Names that the stores have already are skipped, so that an interrupted copy can be repeated.

    Args:
        maps_dir, data_dir: the single server's folders.
        stores: open stores to copy to.
        advance: called with the fraction done, 0..1.

    Raises:
        StorageUnavailable, StorageFull: the copy is incomplete.
    """
    things = [
        *_maps(MapLibrary(maps_dir), stores.library),
        *(
            thing
            for kind in (CAMERAS, SITES, KEYS)
            for thing in _documents(kind, folder_documents(kind, maps_dir, data_dir), stores.documents(kind))
        ),
        *_recordings(data_dir, stores),
    ]
    counts = {"maps": 0, "cameras": 0, "sites": 0, "keys": 0, "recordings": 0}
    unreadable = []
    for number, thing in enumerate(things, start=1):
        if not thing.present:
            try:
                thing.bring(thing.name)
                counts[thing.kind] += 1
            except InvalidMap:
                unreadable.append(thing.name)
        advance(number / len(things))
    left = tuple(f"{thing.kind}: {thing.name}" for thing in things if thing.present)
    return ImportedData(**counts, left=left, unreadable=tuple(unreadable))


def _maps(source: MapLibrary, target: MapLibrary) -> Sequence[_Thing]:
    """All maps of ``source``, each to copy to ``target`` with its readable previous versions."""
    present = set(target.names())

    def bring(name: str) -> None:
        for number in sorted(source.versions(name), reverse=True):
            with suppress(InvalidMap):
                target.put_file(name, source.version_path(name, number))
        target.put_file(name, source.path(name))

    return [_Thing("maps", name, name in present, bring) for name in source.names()]


def _documents(kind: str, source: FolderDocuments, target: Documents) -> Sequence[_Thing]:
    """All files of ``source``, each to copy to ``target``; ``kind`` is their kind in the plural."""
    present = set(target.names())

    def bring(name: str) -> None:
        target.write(name, source.read(name))

    return [_Thing(kind, name, name in present, bring) for name in sorted(source.names())]


def _recordings(data_dir: Path, stores: Stores) -> Sequence[_Thing]:
    """All recordings below ``data_dir``, each to copy to ``stores`` with its notes."""
    if not (data_dir / "recordings").is_dir():
        return []
    source, store = RecordingStore(data_dir), stores.recordings
    source.recover()
    keys = [one.key.split("/") for one in store.objects.list("recordings")]  # the database may be the source's own
    present = {recording_id for _, recording_id, *name in keys if name == [ENTRY_FILE]}

    def bring(recording_id: str) -> None:
        store.take_in(source.root / recording_id, source.get(recording_id))
        store.note(recording_id, source.notes(recording_id))

    return [_Thing("recordings", one.id, one.id in present, bring) for one in source.list()]
