"""Answered queries that several servers keep together, for maps that they share: in object storage."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Collection
from pathlib import Path

from rholoc.disk import reporting_full_disk
from rholoc.geometry import FloatArray
from rholoc.jobs.query_store import QUERIES_FOLDER, KeptLimits, QueryEntry, QueryStore, folder_name, place_of
from rholoc.mapping import AnsweredQuery
from rholoc.storage import MissingObject, ObjectStorage

_ORPHANED_AFTER_S = 24 * 3600.0  # another server may have heard of a map before this one has
_MOST_HEARD = 10_000

_Heard = tuple[str, str, str]  # a map, a place, an asker


class SharedQueryStore(QueryStore):
    """What :class:`QueryStore` does, for all servers that share a storage.

    The storage is asked what it holds only for who was not heard of here, in the same place, within the last while: who
    stays in one place costs it nothing.

    Args:
        objects: the storage.
        limits: what is kept of each map, by all servers together.
    """

    def __init__(self, objects: ObjectStorage, limits: KeptLimits | None = None) -> None:
        super().__init__(Path(), limits)  # nothing stays on this disk
        self._objects = objects
        self._heard: dict[_Heard, float] = {}

    def wants(self, map_id: str, T_map_camera: FloatArray, asker: str, time_s: float) -> bool:
        """As :meth:`QueryStore.wants`.

        Raises:
            StorageUnavailable: the storage does not answer.
        """
        heard = map_id, place_of(T_map_camera), asker
        if abs(time_s - self._heard.get(heard, float("-inf"))) < self._limits.apart_s:
            return False
        if len(self._heard) >= _MOST_HEARD:
            self._heard.clear()
        self._heard[heard] = time_s
        return super().wants(map_id, T_map_camera, asker, time_s)

    def load(self, map_id: str) -> list[AnsweredQuery]:
        """As :meth:`QueryStore.load`; what cannot be read is left out.

        Raises:
            StorageUnavailable, StorageFull: they cannot be fetched.
        """
        with tempfile.TemporaryDirectory() as folder:
            self.fetch(map_id, Path(folder))
            return QueryStore(Path(folder)).load(map_id)

    def fetch(self, map_id: str, data_dir: Path) -> None:
        """Copy a map's queries into a data folder, where a :class:`QueryStore` finds them.

        Raises:
            StorageUnavailable, StorageFull: they cannot be fetched; what is there already is not fetched again.
        """
        target = data_dir / QUERIES_FOLDER / folder_name(map_id)
        with reporting_full_disk():
            target.mkdir(parents=True, exist_ok=True)
        for one in self._entries(map_id):
            if (target / one.name).is_file():
                continue
            try:
                self._objects.fetch(_key(one.folder, one.name), target / one.name)
            except MissingObject:  # dropped meanwhile
                continue

    def delete(self, map_id: str, asker: str | None = None) -> int:
        """As :meth:`QueryStore.delete`. Raises StorageUnavailable."""
        entries = [one for one in self._entries(map_id) if asker is None or one.asker == asker]
        for one in entries:
            self._remove(one)
        return len(entries)

    def sweep(self, map_ids: Collection[str] | None = None) -> None:
        """As :meth:`QueryStore.sweep`; what is of no map goes when it is a day old.

        Raises:
            StorageUnavailable: it is done the next time.
        """
        now_s = time.time()
        known = None if map_ids is None else {folder_name(map_id) for map_id in map_ids}
        for stored in list(self._objects.list(QUERIES_FOLDER)):
            folder, name = stored.key.split("/")[-2:]
            one = QueryEntry.named(folder, name)
            if one is None:
                continue
            of_no_map = known is not None and folder not in known and stored.modified < now_s - _ORPHANED_AFTER_S
            if of_no_map or one.time_s < now_s - self._limits.expire_s:
                self._remove(one)

    def _names(self, folder: str) -> list[str]:
        return list(self._sizes(folder))

    def _sizes(self, folder: str) -> dict[str, int]:
        stored = self._objects.list(f"{QUERIES_FOLDER}/{folder}")
        return {one.key.rpartition("/")[2]: one.size_bytes for one in stored}

    def _write(self, folder: str, name: str, content: bytes) -> None:
        self._objects.put(_key(folder, name), content)

    def _remove(self, entry: QueryEntry) -> None:
        self._objects.delete(_key(entry.folder, entry.name))


def _key(folder: str, name: str) -> str:
    return f"{QUERIES_FOLDER}/{folder}/{name}"
