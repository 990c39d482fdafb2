"""Which of a library's maps may show a picture? An index of all their views that follows changes of the library.

Each kind of features has an index of its own. The model that turns pictures into vectors is trained on the first maps,
and trained again while the library is small and grows; all views are then converted again.
"""

import random
import sqlite3
import time
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import islice, zip_longest
from pathlib import Path
from typing import Protocol

import numpy as np

from rholoc.errors import InvalidDescriptors, InvalidInput, InvalidMap, StorageFull, StorageUnavailable, UnknownMap
from rholoc.features import Extractor, FeatureSet, get_extractor
from rholoc.features.picture_vectors import PictureVectors
from rholoc.geometry import ByteArray, FloatArray
from rholoc.localization.index.view_index import LikelyMap, ViewIndex, view_descriptors
from rholoc.localization.index.view_store import Model, StoredViews, ViewStore
from rholoc.maps import Map, load_map

VECTORS_FILE = Path("index") / "views.sqlite"
"""Where a server keeps the vectors, in its folder of data."""

_LEARNED_FROM = 64  # maps at most
_RELEARNED_AT = 2  # times as many maps as were learned from, while they are fewer
_TRAINING_PICTURES = 1000
_MIN_PICTURES = 16  # of each
_AT_ONCE = 200  # maps that enter an index together when it is read
_LOOK_AT_ALL_S = 30.0  # a file written in place does not change its folder's stamp
_TICK_NS = 2 * 10**9
_SEED = 1


class _FileState(Protocol):
    @property
    def signature(self) -> tuple[int, int, int]: ...


class MapFiles(Protocol):
    """Maps by name, as far as they are read here. :class:`rholoc.library.maps.MapLibrary` is one."""

    def names(self) -> list[str]:
        """The names of all maps, sorted."""
        ...

    def stat(self, name: str) -> _FileState:
        """State of a map's file; its signature changes whenever the file is replaced. Raises UnknownMap."""
        ...

    def path(self, name: str) -> Path:
        """A map's file on this machine. Raises UnknownMap, StorageUnavailable, StorageFull."""
        ...

    def stamp(self) -> int | None:
        """Value that changes whenever a map is published, renamed or deleted; None if unknown."""
        ...


class MapFinder:
    """Find the maps of a library that may show a picture. Thread-safe, except that one thread alone calls
    :meth:`refresh`.

    Args:
        library: the maps.
        file: where to keep view vectors; None keeps them in memory.
        min_maps: a library with fewer maps is not indexed; its files are only fetched.
    """

    def __init__(self, library: MapFiles, file: Path | None = None, min_maps: int = 1) -> None:
        self._library = library
        self._min_maps = min_maps
        self._store = ViewStore(file)
        self._indexes: dict[str, ViewIndex] = {}
        self._models: dict[str, Model] = {}
        self._files: dict[str, str] = {}  # of the maps whose views are known, and of files that are no maps
        self._fetched: dict[str, str] = {}  # of the maps whose files are on this machine, while there is no index
        self._present: dict[str, str] = {}
        self._is_read = False
        self._scanned_stamp: int | None = None
        self._scanned_s = 0.0
        self.trouble = ""
        """Why the last refresh could not read or store vectors; empty where it could."""

    @property
    def present(self) -> Collection[str]:
        """Names of the maps in the library at the last :meth:`refresh`."""
        return self._present.keys()

    @property
    def unknown(self) -> list[str]:
        """Sorted names of the maps in the library whose present file is not indexed yet."""
        files = self._files
        return sorted(name for name, file in self._present.items() if files.get(name) != file)

    def counts(self) -> dict[str, int]:
        """Number of maps in the library (``present``) and in the index (``indexed``)."""
        return {"present": len(self._present), "indexed": len(self._present) - len(self.unknown)}

    def likeliest(
        self, features_by: Callable[[Extractor], FeatureSet], most: int, among: Collection[str] | None = None
    ) -> list[LikelyMap]:
        """Rank maps by similarity to a picture. Returns at most ``most``, best first, alternating between kinds of
        features.

        Args:
            features_by: returns the picture's features for an extractor; raises InvalidDescriptors if it has none of
                that kind, which leaves out the maps of that kind.
            most: maximum number of maps.
            among: names of the maps to consider; default: all.
        """
        found = []
        for features, index in sorted(self._indexes.items()):
            try:
                descriptors = features_by(get_extractor(features)).descriptors
            except InvalidDescriptors:
                continue
            found.append(index.likeliest(descriptors, most, among))
        in_turn = (one for ones in zip_longest(*found) for one in ones if one is not None)
        return list(islice(in_turn, most))

    def refresh(self, is_stopped: Callable[[], bool] = lambda: False) -> None:
        """Index what has changed in the library, unless its stamp is unchanged since a scan less than 30 s ago.

        Returns early once ``is_stopped`` is true. Errors of the file or the storage are not raised, but stored in
        :attr:`trouble`.
        """
        stamp, now_s = self._library.stamp(), time.monotonic()
        if stamp == self._scanned_stamp and now_s < self._scanned_s + _LOOK_AT_ALL_S:
            return
        self.trouble = ""
        with self._noting_trouble():
            self._read()
        present = self._scan()
        gone = [name for name in self._files if name not in present]
        self._present = present
        self._forget(gone)
        is_indexed = len(present) >= self._min_maps
        known = self._files if is_indexed else self._fetched
        changed = [name for name, file in present.items() if known.get(name) != file]
        random.Random(_SEED).shuffle(changed)
        try:
            if is_indexed:
                self._relearn(changed, is_stopped)
            for name in changed:
                if is_stopped():
                    return
                if is_indexed:
                    self._take(name, present[name], changed)
                else:
                    self._fetch(name, present[name])
        except (StorageUnavailable, StorageFull) as error:  # the next time, then
            self.trouble = error.message
            return
        # A folder that changed within its clock's last tick may change again and look the same.
        settled = stamp is not None and time.time_ns() - stamp > _TICK_NS
        self._scanned_stamp, self._scanned_s = stamp if settled else None, now_s

    def close(self) -> None:
        """Close the file."""
        self._store.close()

    # -- what is stored ------------------------------------------------------------------------------------------------

    def _read(self) -> None:
        """Replace everything held by the file's content: at the first call, and once another process has stored a new
        model. Raises sqlite3.Error or OSError if the file cannot be used.
        """
        known = {name: model.id for name, model in self._models.items()}
        if self._is_read and self._store.model_ids() in (known, {}):
            return
        models = self._store.models()
        indexes = {features: ViewIndex(model.pictures) for features, model in models.items()}
        files: dict[str, str] = {}
        stored = (one for one in self._store.views() if one.features in models and one.model == models[one.features].id)
        while some := list(islice(stored, _AT_ONCE)):
            by_kind: dict[str, dict[str, FloatArray]] = defaultdict(dict)
            for one in some:
                by_kind[one.features][one.map] = one.vectors
                files[one.map] = one.file
            for features, vectors in by_kind.items():
                indexes[features].put(vectors)
        self._models, self._indexes, self._files, self._is_read = models, indexes, files, True

    def _forget(self, names: Sequence[str]) -> None:
        """Remove the views of maps, from memory and from the file; they are no longer known."""
        if not names:
            return
        for index in self._indexes.values():
            index.drop(names)
        for name in names:
            self._files.pop(name, None)
        with self._noting_trouble():
            self._store.drop(names)

    @contextmanager
    def _noting_trouble(self) -> Iterator[None]:
        """Suppress errors of the file within the block and note them in :attr:`trouble`: the file only saves time at
        the next start.
        """
        try:
            yield
        except (sqlite3.Error, OSError) as error:
            self.trouble = str(error)

    # -- what has changed ----------------------------------------------------------------------------------------------

    def _scan(self) -> dict[str, str]:
        """Names of the library's maps → identifier of each file's version (modification time and size)."""
        found = {}
        for name in self._library.names():
            try:
                _, modified, size_bytes = self._library.stat(name).signature
            except UnknownMap:  # deleted meanwhile
                continue
            found[name] = f"{modified}-{size_bytes}"
        return found

    def _fetch(self, name: str, file: str) -> None:
        """Fetch the version ``file`` of a map to this machine. Raises StorageUnavailable, StorageFull."""
        with suppress(UnknownMap):
            self._library.path(name)
            self._fetched[name] = file

    def _take(self, name: str, file: str, others: Sequence[str]) -> None:
        """Index the version ``file`` of a map, from the views that another process has stored or from the map itself.
        Where its kind of features has no model yet, one is trained on it and on the maps ``others``. A map that
        cannot be read, or has no views to train on, is noted as known, without views.
        """
        with self._noting_trouble():
            for stored in self._store.views(name):
                model = self._models.get(stored.features)
                if stored.file == file and model is not None and stored.model == model.id:
                    self._hold(stored)
                    return
        map_ = self._loaded(name)
        if map_ is None:
            self._forget([name])
            self._files[name] = file
            return
        features = map_.info.features
        model = self._models.get(features)
        if model is None:
            model = self._learned(features, [name, *(other for other in others if other != name)])
            if model is None:
                self._forget([name])
                self._files[name] = file
                return
            self._models[features], self._indexes[features] = model, ViewIndex(model.pictures)
            with self._noting_trouble():
                self._store.put_model(model)
        views = StoredViews(name, file, features, model.id, model.pictures.vectors(view_descriptors(map_)))
        with self._noting_trouble():
            self._store.put(views)
        self._hold(views)

    def _hold(self, views: StoredViews) -> None:
        """Put a map's views into the index of their kind of features, out of any other, and note its file as known."""
        for features, index in self._indexes.items():
            if features != views.features:
                index.drop([views.map])
        self._indexes[views.features].put({views.map: views.vectors})
        self._files[views.map] = views.file

    def _loaded(self, name: str) -> Map | None:
        """Load a map; None if it cannot be read or its extractor is unknown. Raises StorageUnavailable, StorageFull."""
        try:
            map_ = load_map(self._library.path(name))
            get_extractor(map_.info.features)
        except (InvalidMap, InvalidInput, UnknownMap):
            return None
        return map_

    # -- what is learned -----------------------------------------------------------------------------------------------

    def _learned(self, features: str, names: Sequence[str]) -> Model | None:
        """Train a model on at most 64 of the maps ``names`` with these features, about 1000 pictures in all. Returns
        None if none has any.
        """
        share = max(_MIN_PICTURES, _TRAINING_PICTURES // min(_LEARNED_FROM, len(names)))
        pictures: list[ByteArray] = []
        maps = 0
        for name in names[: 2 * _LEARNED_FROM]:
            map_ = self._loaded(name)
            if map_ is not None and map_.info.features == features and maps < _LEARNED_FROM:
                seen = [view for view in view_descriptors(map_) if len(view)]
                pictures += (
                    [seen[row] for row in np.unique(np.linspace(0, len(seen) - 1, share).astype(int))] if seen else []
                )
                maps += 1
        if not pictures:
            return None
        return Model.new(features, maps, PictureVectors.learned(pictures, get_extractor(features).metric))

    def _relearn(self, changed: Sequence[str], is_stopped: Callable[[], bool]) -> None:
        """Train models again that were trained on fewer than 64 maps where there are now twice as many, and convert
        their views.

        Args:
            changed: names of maps that are not indexed yet.
            is_stopped: whether to stop early; the model at hand is then left as it was.
        """
        for features, before in list(self._models.items()):
            names = [*sorted(self._indexes[features].names - set(changed)), *changed]
            random.Random(_SEED).shuffle(names)
            if before.maps >= _LEARNED_FROM or len(names) < _RELEARNED_AT * before.maps:
                continue
            model = self._learned(features, names)
            if model is None or model.maps <= before.maps:
                continue
            again: list[StoredViews] = []
            for name in sorted(self._indexes[features].names):
                if is_stopped():
                    return
                map_ = self._loaded(name)
                if map_ is not None and map_.info.features == features:
                    vectors = model.pictures.vectors(view_descriptors(map_))
                    again.append(StoredViews(name, self._files[name], features, model.id, vectors))
            index = ViewIndex(model.pictures)
            index.put({views.map: views.vectors for views in again})
            with self._noting_trouble():
                self._store.put_model(model, again)
            self._models[features], self._indexes[features] = model, index
