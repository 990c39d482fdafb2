"""Answered queries that maps may learn from: a folder for each map, a file for each query.

What is kept is bounded, and spread over places, times and askers. Files say in their names where and when they were
asked and by whom, so that a folder's listing is all that has to be read to decide what stays.
"""

from __future__ import annotations

import hashlib
import json
import re
import shutil
import time
import uuid
from collections import Counter
from collections.abc import Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from rholoc.disk import reporting_full_disk
from rholoc.errors import RholocError
from rholoc.features import FeatureSet
from rholoc.geometry import Camera, FloatArray
from rholoc.mapping import AnsweredQuery
from rholoc.maps.files import replace_file

QUERIES_FOLDER = "queries"
_SUFFIX = ".query"
_MAP_ID = re.compile(r"[0-9A-Za-z]{1,64}")
_NAME = re.compile(r"(\d{13})-([0-9a-f]{8})-([0-9a-f]{12})-[0-9a-f]{8}\.query")
_CELL_M, _CELL_RAD = 0.5, np.deg2rad(45.0)
_DAY_S = 24 * 3600.0


@dataclass(frozen=True)
class KeptLimits:
    """What is kept at most for each map.

    Attributes:
        queries: how many.
        size_bytes: their files together.
        in_a_place: how many within half a metre and an eighth of a turn.
        apart_s: how long an asker's queries from one place are apart.
        expire_s: after which time a query is forgotten.
    """

    queries: int = 1000
    size_bytes: int = 128 * 2**20
    in_a_place: int = 8
    apart_s: float = 60.0
    expire_s: float = 30 * _DAY_S


@dataclass(frozen=True)
class KeptQueries:
    """What is kept for one map.

    Attributes:
        queries: how many.
        size_bytes: their files together.
        askers: how many asked them.
        oldest, newest: seconds since the epoch; None where there are none.
    """

    queries: int
    size_bytes: int
    askers: int
    oldest: float | None
    newest: float | None


@dataclass(frozen=True)
class QueryEntry:
    """A kept query, by its file's name.

    Attributes:
        folder: of its map.
        name: of its file.
        time_s: when it was asked, seconds since the epoch.
        place: half a metre and an eighth of a turn.
        asker: who asked.
    """

    folder: str
    name: str
    time_s: float
    place: str
    asker: str

    @classmethod
    def named(cls, folder: str, name: str) -> QueryEntry | None:
        """By a file's name; None where it is no query's."""
        match = _NAME.fullmatch(name)
        return None if match is None else cls(folder, name, int(match[1]) / 1000, match[2], match[3])


class QueryStore:
    """The kept queries of all maps, in a data folder that several processes may share."""

    def __init__(self, data_dir: Path, limits: KeptLimits | None = None) -> None:
        self._root = Path(data_dir) / QUERIES_FOLDER
        self._limits = limits or KeptLimits()

    def wants(self, map_id: str, T_map_camera: FloatArray, asker: str, time_s: float) -> bool:
        """Whether a query would be kept: an asker who stays where it is is heard once a while."""
        place = place_of(T_map_camera)
        return not any(
            one.place == place and one.asker == asker and abs(time_s - one.time_s) < self._limits.apart_s
            for one in self._entries(map_id)
        )

    def add(self, map_id: str, query: AnsweredQuery) -> None:
        """Keep a query, and drop others where there would be too many.

        Raises:
            StorageFull: the disk is full.
        """
        place = place_of(query.T_map_camera)
        name = f"{round(1000 * query.time_s):013d}-{place}-{query.asker}-{uuid.uuid4().hex[:8]}{_SUFFIX}"
        self._write(folder_name(map_id), name, _to_bytes(query))
        self._make_room(map_id, place)

    def kept(self, map_id: str) -> KeptQueries:
        """How much is kept for a map."""
        entries, sizes = self._entries(map_id), self._sizes(folder_name(map_id))
        times = [one.time_s for one in entries]
        return KeptQueries(
            queries=len(entries),
            size_bytes=sum(sizes.get(one.name, 0) for one in entries),
            askers=len({one.asker for one in entries}),
            oldest=min(times, default=None),
            newest=max(times, default=None),
        )

    def newer_than(self, map_id: str, time_s: float) -> int:
        """How many of a map's queries were asked after a time, seconds since the epoch."""
        return sum(one.time_s > time_s for one in self._entries(map_id))

    def load(self, map_id: str) -> list[AnsweredQuery]:
        """All that are kept for a map, the oldest first. What cannot be read is removed."""
        found = []
        for one in self._entries(map_id):
            try:
                found.append(_from_file(self._path(one), one))
            except FileNotFoundError:
                continue
            except (SafetensorError, OSError, ValueError, TypeError, KeyError, RholocError):
                self._remove(one)
        return found

    def delete(self, map_id: str, asker: str | None = None) -> int:
        """Forget the queries of a map, or those of one asker; returns how many."""
        entries = [one for one in self._entries(map_id) if asker is None or one.asker == asker]
        for one in entries:
            self._remove(one)
        if asker is None:
            shutil.rmtree(self._root / folder_name(map_id), ignore_errors=True)
        return len(entries)

    def sweep(self, map_ids: Collection[str] | None = None) -> None:
        """Forget what has expired; and, where ``map_ids`` names all maps that there are, what is of others."""
        if not self._root.is_dir():
            return
        known = None if map_ids is None else {folder_name(map_id) for map_id in map_ids}
        for folder in self._root.iterdir():
            if known is not None and folder.name not in known:
                shutil.rmtree(folder, ignore_errors=True)
                continue
            oldest_s = time.time() - self._limits.expire_s
            for one in self._entries(folder.name):
                if one.time_s < oldest_s:
                    self._remove(one)

    def _path(self, entry: QueryEntry) -> Path:
        return self._root / entry.folder / entry.name

    def _names(self, folder: str) -> list[str]:
        """The names of the files in a map's folder."""
        try:
            return [path.name for path in (self._root / folder).iterdir()]
        except FileNotFoundError:
            return []

    def _sizes(self, folder: str) -> dict[str, int]:
        """Bytes of the files in a map's folder."""
        sizes = {}
        for name in self._names(folder):
            with suppress(FileNotFoundError):
                sizes[name] = (self._root / folder / name).stat().st_size
        return sizes

    def _write(self, folder: str, name: str, content: bytes) -> None:
        with reporting_full_disk():
            (self._root / folder).mkdir(mode=0o700, parents=True, exist_ok=True)
        replace_file(self._root / folder / name, content, called="a query")

    def _remove(self, entry: QueryEntry) -> None:
        self._path(entry).unlink(missing_ok=True)

    def _entries(self, map_id: str) -> list[QueryEntry]:
        """The oldest first."""
        folder = folder_name(map_id)
        found = (QueryEntry.named(folder, name) for name in sorted(self._names(folder)))
        return [one for one in found if one is not None]

    def _make_room(self, map_id: str, place: str) -> None:
        left = self._entries(map_id)
        here = [one for one in left if one.place == place]
        if len(here) > self._limits.in_a_place:
            self._drop(_gives_way(here), left)
        sizes = self._sizes(folder_name(map_id))
        while len(left) > 1 and (
            len(left) > self._limits.queries or sum(sizes.get(one.name, 0) for one in left) > self._limits.size_bytes
        ):
            self._drop(_gives_way(left), left)

    def _drop(self, entry: QueryEntry, entries: list[QueryEntry]) -> None:
        entries.remove(entry)
        self._remove(entry)


def folder_name(map_id: str) -> str:
    """The id; or what stands for one that is no file's name, as a map that was uploaded may have it."""
    return map_id if _MAP_ID.fullmatch(map_id) else hashlib.blake2b(map_id.encode(), digest_size=16).hexdigest()


def _gives_way(entries: Sequence[QueryEntry]) -> QueryEntry:
    """Whose are most, from where theirs are most, the oldest: nobody can drive out what others asked."""
    asker, _ = Counter(one.asker for one in entries).most_common(1)[0]
    own = [one for one in entries if one.asker == asker]
    place, _ = Counter(one.place for one in own).most_common(1)[0]
    return min((one for one in own if one.place == place), key=lambda one: one.time_s)


def place_of(T_map_camera: FloatArray) -> str:
    """Half a metre and an eighth of a turn, as 8 hex digits."""
    x, y, z = np.floor(T_map_camera[:3, 3] / _CELL_M)
    turn = np.floor(np.arctan2(T_map_camera[1, 2], T_map_camera[0, 2]) / _CELL_RAD)
    cell = f"{x:.0f},{y:.0f},{z:.0f},{turn:.0f}"
    return hashlib.blake2b(cell.encode(), digest_size=4).hexdigest()


def _to_bytes(query: AnsweredQuery) -> bytes:
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


def _from_file(path: Path, entry: QueryEntry) -> AnsweredQuery:
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
