"""Answered queries that maps may learn from: an object for each query.

The number of queries is bounded, and spread over places, times and askers. An object's name contains the query's place,
time and asker, so that eviction needs only a list of a map's objects.
"""

import hashlib
import json
import re
import tempfile
import time
import uuid
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from rholoc.disk import reporting_full_disk
from rholoc.errors import MissingObject, RholocError, StorageFull, StorageUnavailable
from rholoc.features import FeatureSet
from rholoc.geometry import Camera, FloatArray
from rholoc.mapping.learn.answered_query import AnsweredQuery
from rholoc.storage.objects import ObjectStorage, StoredObject

QUERIES_FOLDER = "queries"
_SUFFIX = ".query"
_MAP_ID = re.compile(r"[0-9A-Za-z]{1,64}")
_NAME = re.compile(r"(\d{13})-([0-9a-f]{8})-([0-9a-f]{12})-[0-9a-f]{8}\.query")
_CELL_M, _CELL_RAD = 0.5, np.deg2rad(45.0)
_DAY_S = 24 * 3600.0
_ORPHANED_AFTER_S = _DAY_S  # another server may know of a map before this one does
_MAX_KNOWN = 10_000

_Origin = tuple[str, str, str]  # of a query: map, place, asker


@dataclass(frozen=True)
class KeptLimits:
    """Limits on the kept queries of each map.

    Attributes:
        queries: maximum number.
        size_bytes: maximum size of their files together.
        in_a_place: maximum number within half a metre and an eighth of a turn.
        apart_s: minimum interval between an asker's queries from one place.
        expire_s: age at which a query is deleted.
    """

    queries: int = 1000
    size_bytes: int = 128 * 2**20
    in_a_place: int = 8
    apart_s: float = 60.0
    expire_s: float = 30 * _DAY_S


@dataclass(frozen=True)
class KeptQueries:
    """Summary of a map's kept queries.

    Attributes:
        queries: their number.
        size_bytes: of their files together.
        askers: number of different askers.
        oldest, newest: seconds since the epoch; None without queries.
    """

    queries: int
    size_bytes: int
    askers: int
    oldest: float | None
    newest: float | None


@dataclass(frozen=True)
class _Entry:
    """A kept query, by its object.

    Attributes:
        key: the object's.
        size_bytes: the object's size.
        modified: when it was stored [s since the epoch].
        time_s: when it was asked [s since the epoch].
        place: cell of half a metre and an eighth of a turn, see :func:`place_of`.
        asker: id of the asker.
    """

    key: str
    size_bytes: int
    modified: float
    time_s: float
    place: str
    asker: str


class QueryStore:
    """The kept queries of all maps, which several processes may share.

    The storage is not listed for an asker that recently asked this process from the same place.

    Args:
        objects: the storage; queries are the objects ``queries/MAP/NAME.query``.
        limits: on each map's queries, shared by all processes.
    """

    def __init__(self, objects: ObjectStorage, limits: KeptLimits | None = None) -> None:
        self._objects = objects
        self._limits = limits or KeptLimits()
        self._last_s: dict[_Origin, float] = {}

    def wants(self, map_id: str, T_map_camera: FloatArray, asker: str, time_s: float) -> bool:
        """Whether a query at ``time_s`` [s since the epoch] would be kept: at most one for each asker and place in
        ``apart_s``.

        Raises:
            StorageUnavailable: the storage does not answer.
        """
        origin = map_id, place_of(T_map_camera), asker
        if self._is_recent(origin, time_s):
            return False
        for one in self._entries(map_id):
            if (map_id, one.place, one.asker) == origin:
                self._note(origin, one.time_s)
        return not self._is_recent(origin, time_s)

    def add(self, map_id: str, query: AnsweredQuery) -> None:
        """Keep a query, and evict others above the limits.

        Raises:
            StorageUnavailable, StorageFull: the query is not kept, or others are not evicted yet.
        """
        place = place_of(query.T_map_camera)
        name = f"{round(1000 * query.time_s):013d}-{place}-{query.asker}-{uuid.uuid4().hex[:8]}{_SUFFIX}"
        self._objects.put(f"{_folder(map_id)}/{name}", _to_bytes(query))
        self._note((map_id, place, query.asker), query.time_s)
        self._make_room(map_id, place)

    def kept(self, map_id: str) -> KeptQueries:
        """Summary of a map's queries. Raises StorageUnavailable."""
        entries = self._entries(map_id)
        times = [one.time_s for one in entries]
        return KeptQueries(
            queries=len(entries),
            size_bytes=sum(one.size_bytes for one in entries),
            askers=len({one.asker for one in entries}),
            oldest=min(times, default=None),
            newest=max(times, default=None),
        )

    def newer_than(self, map_id: str, time_s: float) -> int:
        """Number of a map's queries asked after ``time_s`` [s since the epoch]. Raises StorageUnavailable."""
        return sum(one.time_s > time_s for one in self._entries(map_id))

    def load(self, map_id: str) -> list[AnsweredQuery]:
        """All kept queries of a map, the oldest first. Unreadable ones are deleted and left out.

        Raises:
            StorageUnavailable, StorageFull: they cannot be fetched.
        """
        found = []
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "query"
            for one in self._entries(map_id):
                try:
                    self._objects.fetch(one.key, file)
                    found.append(_from_file(file, one))
                except MissingObject:  # dropped meanwhile
                    continue
                except (StorageUnavailable, StorageFull):
                    raise
                except (SafetensorError, OSError, ValueError, TypeError, KeyError, RholocError):
                    self._objects.delete(one.key)
        return found

    def fetch(self, map_id: str, data_dir: Path) -> None:
        """Copy a map's queries into ``data_dir``, for a store on that folder. Skips existing copies.

        Raises:
            StorageUnavailable, StorageFull: queries cannot be fetched.
        """
        with reporting_full_disk():
            (data_dir / _folder(map_id)).mkdir(parents=True, exist_ok=True)
        for one in self._entries(map_id):
            if not (data_dir / one.key).is_file():
                with suppress(MissingObject):  # dropped meanwhile
                    self._objects.fetch(one.key, data_dir / one.key)

    def delete(self, map_id: str, asker: str | None = None) -> int:
        """Forget the queries of a map, or those of one asker. Returns how many. Raises StorageUnavailable."""
        entries = [one for one in self._entries(map_id) if asker is None or one.asker == asker]
        for one in entries:
            self._objects.delete(one.key)
        return len(entries)

    def sweep(self, map_ids: Collection[str] | None = None) -> None:
        """Delete expired queries and, a day after they were kept, those of maps not in ``map_ids``.

        Args:
            map_ids: of all maps; None if unknown.

        Raises:
            StorageUnavailable: the sweep is incomplete.
        """
        now_s = time.time()
        known = None if map_ids is None else {_folder(map_id) for map_id in map_ids}
        for one in _queries(list(self._objects.list(QUERIES_FOLDER))):
            of_no_map = known is not None and one.key.rpartition("/")[0] not in known
            orphaned = of_no_map and one.modified < now_s - _ORPHANED_AFTER_S
            if orphaned or one.time_s < now_s - self._limits.expire_s:
                self._objects.delete(one.key)

    def _is_recent(self, origin: _Origin, time_s: float) -> bool:
        """Whether the last known query of this origin is less than ``apart_s`` from ``time_s`` [s since the epoch]."""
        return abs(time_s - self._last_s.get(origin, float("-inf"))) < self._limits.apart_s

    def _note(self, origin: _Origin, time_s: float) -> None:
        """Remember the time [s since the epoch] of the last query of this origin."""
        if len(self._last_s) >= _MAX_KNOWN:
            self._last_s.clear()
        self._last_s[origin] = time_s

    def _entries(self, map_id: str) -> list[_Entry]:
        """Entries of a map's queries, the oldest first. Raises StorageUnavailable."""
        return sorted(_queries(self._objects.list(_folder(map_id))), key=lambda one: one.key)

    def _make_room(self, map_id: str, place: str) -> None:
        """Delete queries beyond the limits, first those of the place, then of the whole map."""
        left = self._entries(map_id)
        here = [one for one in left if one.place == place]
        if len(here) > self._limits.in_a_place:
            self._drop(_gives_way(here), left)
        while len(left) > 1 and (
            len(left) > self._limits.queries or sum(one.size_bytes for one in left) > self._limits.size_bytes
        ):
            self._drop(_gives_way(left), left)

    def _drop(self, entry: _Entry, entries: list[_Entry]) -> None:
        """Delete a query's object, and remove it from ``entries`` in place."""
        entries.remove(entry)
        self._objects.delete(entry.key)


def _queries(stored: Iterable[StoredObject]) -> Iterator[_Entry]:
    """Entries of the objects with valid query names."""
    for one in stored:
        match = _NAME.fullmatch(one.key.rpartition("/")[2])
        if match is not None:
            yield _Entry(one.key, one.size_bytes, one.modified, int(match[1]) / 1000, match[2], match[3])


def _folder(map_id: str) -> str:
    """Key prefix of a map's queries: its id, or a hash of an id that is not a valid file name."""
    name = map_id if _MAP_ID.fullmatch(map_id) else hashlib.blake2b(map_id.encode(), digest_size=16).hexdigest()
    return f"{QUERIES_FOLDER}/{name}"


def _gives_way(entries: Sequence[_Entry]) -> _Entry:
    """Oldest query from the most frequent place of the asker with the most queries, so that nobody evicts another's."""
    asker, _ = Counter(one.asker for one in entries).most_common(1)[0]
    own = [one for one in entries if one.asker == asker]
    place, _ = Counter(one.place for one in own).most_common(1)[0]
    return min((one for one in own if one.place == place), key=lambda one: one.time_s)


def place_of(T_map_camera: FloatArray) -> str:
    """Cell of half a metre and an eighth of a turn (of the heading seen from above) that contains a pose (4, 4), as 8
    hex digits.
    """
    x, y, z = np.floor(T_map_camera[:3, 3] / _CELL_M)
    turn = np.floor(np.arctan2(T_map_camera[1, 2], T_map_camera[0, 2]) / _CELL_RAD)
    cell = f"{x:.0f},{y:.0f},{z:.0f},{turn:.0f}"
    return hashlib.blake2b(cell.encode(), digest_size=4).hexdigest()


def _to_bytes(query: AnsweredQuery) -> bytes:
    """Content of a query's file (safetensors); its time and asker are in the file's name."""
    features = query.features
    arrays = {
        "pixels": features.pixels.astype(np.float32),
        "channels": features.channels,
        "descriptors": features.descriptors,
        "sizes": features.sizes.astype(np.float32),
        "angles": features.angles.astype(np.float32),
        "T_map_camera": query.T_map_camera.astype(np.float64),
        "covariance": query.covariance.astype(np.float64),
    }
    if features.colours is not None:
        arrays["colours"] = features.colours
    metadata = {"camera": json.dumps(query.camera.to_dict()), "confidence": repr(float(query.confidence))}
    return bytes(save({name: np.ascontiguousarray(array) for name, array in arrays.items()}, metadata))


def _from_file(path: Path, entry: _Entry) -> AnsweredQuery:
    """The query in a file, with the time and asker of ``entry``. Raises ValueError and others if it is broken."""
    with safe_open(path, framework="numpy") as file:
        metadata = file.metadata() or {}
        arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    T, covariance = arrays.pop("T_map_camera"), arrays.pop("covariance")
    if T.shape != (4, 4) or covariance.shape != (6, 6) or not (np.isfinite(T).all() and np.isfinite(covariance).all()):
        raise ValueError("not a pose")
    return AnsweredQuery(
        features=FeatureSet(**arrays),
        camera=Camera.from_dict(json.loads(metadata["camera"])),
        T_map_camera=T,
        covariance=covariance,
        confidence=float(metadata["confidence"]),
        time_s=entry.time_s,
        asker=entry.asker,
    )
