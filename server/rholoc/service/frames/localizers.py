"""The localizers of the served maps: one for each loaded map, replaced between two requests."""

import threading
from typing import Protocol

from rholoc.library.maps import MapLibrary
from rholoc.localization import AnyLocalizer, localizer_of
from rholoc.maps import Map, check_usable


class MapNotHereError(Exception):
    """A map has to be fetched first, by :meth:`MapLibrary.path`; compute threads do not wait for the storage."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.name = name


class LocalizerSource(Protocol):
    """Source of localizers for one request."""

    def get(self, name: str) -> AnyLocalizer:
        """The localizer of the current map of a name. Raises InvalidName, UnknownMap, InvalidMap, MapNotHereError."""
        ...


class Localizers:
    """Keeps one localizer per map name. Safe to call from several threads.

    A localizer is dropped when its map is evicted from memory. A request keeps its localizer, and so its map, even if
    the map is replaced meanwhile. Poses are withheld if the probability of their place is below ``min_recognized``.
    """

    def __init__(self, library: MapLibrary, min_recognized: float) -> None:
        self._library = library
        self._min_recognized = min_recognized
        self._ready: dict[str, AnyLocalizer] = {}
        self._building: dict[str, threading.Lock] = {}

    def get(self, name: str) -> AnyLocalizer:
        """The localizer of the current map; built if the map is new or was replaced.

        Raises:
            MapNotHereError: the map's file is not on this machine, or there is no such map.
            InvalidName: the name is not valid, though there is such a file. UnknownMap: the map was deleted just now.
            InvalidMap: its file is not a map, or nothing can be localized in it.
        """
        if not self._library.is_here(name):
            raise MapNotHereError(name)
        map_ = self._library.get(name)
        self._forget_unloaded()
        with self._building.setdefault(name, threading.Lock()):
            ready = self._ready.get(name)
            if ready is None or ready.map is not map_:
                ready = self._ready[name] = self._build(map_)
        return ready

    def forget_missing(self) -> None:
        """Drop the localizers of maps that are no longer in the library."""
        names = set(self._library.names())
        for name in [name for name in self._ready if name not in names]:
            self._ready.pop(name, None)

    def _forget_unloaded(self) -> None:
        """Drop the localizers of maps that the library no longer keeps in memory."""
        for name, ready in list(self._ready.items()):
            if not self._library.keeps(name, ready.map):
                self._ready.pop(name, None)

    def _build(self, map_: Map) -> AnyLocalizer:
        """New localizer of a map. Raises InvalidMap if nothing can be localized in it."""
        check_usable(map_)
        return localizer_of(map_, self._min_recognized)
