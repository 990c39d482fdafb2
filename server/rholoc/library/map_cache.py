"""In-memory cache of maps with least-recently-used eviction."""

import threading
from collections import OrderedDict
from dataclasses import dataclass

import numpy as np

from rholoc.maps.map import Map

Signature = tuple[int, int, int]

_WITH_ITS_INDEX = 2  # times a map's own size, because a localizer's index is about as large


@dataclass(frozen=True, eq=False)
class _Entry:
    signature: Signature
    map: Map
    size_bytes: int


class MapCache:
    """Maps by name; the least recently used are evicted when there is no room. Safe to share between threads.

    Args:
        most_bytes: memory for all maps, including data derived from them; the last used map stays, however large.
    """

    def __init__(self, most_bytes: float) -> None:
        self._most_bytes = most_bytes
        self._entries: OrderedDict[str, _Entry] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, name: str, signature: Signature) -> Map | None:
        """The map of that name, which becomes the last used; None unless it is cached with that signature."""
        with self._lock:
            entry = self._entries.get(name)
            if entry is None or entry.signature != signature:
                return None
            self._entries.move_to_end(name)
            return entry.map

    def put(self, name: str, signature: Signature, map_: Map) -> None:
        """Add a map as the last used one, which stays; evicts the least recently used ones to make room."""
        with self._lock:
            self._entries[name] = _Entry(signature, map_, memory_bytes(map_))
            self._entries.move_to_end(name)
            total = sum(entry.size_bytes for entry in self._entries.values())
            while total > self._most_bytes and len(self._entries) > 1:
                total -= self._entries.popitem(last=False)[1].size_bytes

    def drop(self, name: str) -> None:
        """Remove a map, if it is cached."""
        with self._lock:
            self._entries.pop(name, None)

    def has(self, name: str) -> bool:
        """Whether a map of that name is cached, whatever its signature."""
        return name in self._entries

    def holds(self, name: str, map_: Map) -> bool:
        """Whether ``map_`` is the cached object of that name."""
        entry = self._entries.get(name)
        return entry is not None and entry.map is map_


def memory_bytes(map_: Map) -> int:
    """Estimated memory of a map, including a localizer's index [bytes]."""
    tables = (map_.landmarks, map_.descriptors, map_.views, map_.observations)
    arrays = [getattr(table, name) for table in tables for name in table.columns()]
    arrays += map_.densities.arrays().values()
    return _WITH_ITS_INDEX * sum(array.nbytes for array in arrays if isinstance(array, np.ndarray))
