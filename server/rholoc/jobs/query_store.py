"""Answered queries that maps may learn from, on disk: a folder for each map, a file for each query.

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

_FOLDER = "queries"
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
class _Entry:
    path: Path
    time_s: float
    place: str
    asker: str

    @property
    def size_bytes(self) -> int:
        try:
            return self.path.stat().st_size
        except FileNotFoundError:
            return 0


class QueryStore:
    """The kept queries of all maps, in a data folder that several processes may share."""

    def __init__(self, data_dir: Path, limits: KeptLimits | None = None) -> None:
        self._root = Path(data_dir) / _FOLDER
        self._limits = limits or KeptLimits()

    def wants(self, map_id: str, T_map_camera: FloatArray, asker: str, time_s: float) -> bool:
        """Whether a query would be kept: an asker who stays where it is is heard once a while."""
        place = _place_of(T_map_camera)
        return not any(
            one.place == place and one.asker == asker and abs(time_s - one.time_s) < self._limits.apart_s
            for one in self._entries(map_id)
        )

    def add(self, map_id: str, query: AnsweredQuery) -> None:
        """Keep a query, and drop others where there would be too many.

        Raises:
            StorageFull: the disk is full.
        """
        folder = self._folder(map_id)
        with reporting_full_disk():
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        name = f"{round(1000 * query.time_s):013d}-{_place_of(query.T_map_camera)}-{query.asker}"
        replace_file(folder / f"{name}-{uuid.uuid4().hex[:8]}{_SUFFIX}", _to_bytes(query), called="a query")
        self._make_room(map_id, _place_of(query.T_map_camera))

    def kept(self, map_id: str) -> KeptQueries:
        """How much is kept for a map."""
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
        """How many of a map's queries were asked after a time, seconds since the epoch."""
        return sum(one.time_s > time_s for one in self._entries(map_id))

    def load(self, map_id: str) -> list[AnsweredQuery]:
        """All that are kept for a map, the oldest first. What cannot be read is removed."""
        found = []
        for one in self._entries(map_id):
            try:
                found.append(_from_file(one))
            except FileNotFoundError:
                continue
            except (SafetensorError, OSError, ValueError, TypeError, KeyError, RholocError):
                one.path.unlink(missing_ok=True)
        return found

    def delete(self, map_id: str, asker: str | None = None) -> int:
        """Forget the queries of a map, or those of one asker; returns how many."""
        entries = [one for one in self._entries(map_id) if asker is None or one.asker == asker]
        for one in entries:
            one.path.unlink(missing_ok=True)
        if asker is None:
            shutil.rmtree(self._folder(map_id), ignore_errors=True)
        return len(entries)

    def sweep(self, map_ids: Collection[str] | None = None) -> None:
        """Forget what has expired; and, where ``map_ids`` names all maps that there are, what is of others."""
        if not self._root.is_dir():
            return
        known = None if map_ids is None else {_folder_name(map_id) for map_id in map_ids}
        for folder in self._root.iterdir():
            if known is not None and folder.name not in known:
                shutil.rmtree(folder, ignore_errors=True)
                continue
            oldest_s = time.time() - self._limits.expire_s
            for one in self._entries(folder.name):
                if one.time_s < oldest_s:
                    one.path.unlink(missing_ok=True)

    def _folder(self, map_id: str) -> Path:
        return self._root / _folder_name(map_id)

    def _entries(self, map_id: str) -> list[_Entry]:
        """The oldest first."""
        folder = self._folder(map_id)
        try:
            names = sorted(path.name for path in folder.iterdir())
        except FileNotFoundError:
            return []
        found = ((name, _NAME.fullmatch(name)) for name in names)
        return [_Entry(folder / name, int(match[1]) / 1000, match[2], match[3]) for name, match in found if match]

    def _make_room(self, map_id: str, place: str) -> None:
        left = self._entries(map_id)
        here = [one for one in left if one.place == place]
        if len(here) > self._limits.in_a_place:
            _drop(_gives_way(here), left)
        sizes = {one: one.size_bytes for one in left}
        while len(left) > 1 and (
            len(left) > self._limits.queries or sum(sizes[one] for one in left) > self._limits.size_bytes
        ):
            _drop(_gives_way(left), left)


def _folder_name(map_id: str) -> str:
    """The id; or what stands for one that is no file's name, as a map that was uploaded may have it."""
    return map_id if _MAP_ID.fullmatch(map_id) else hashlib.blake2b(map_id.encode(), digest_size=16).hexdigest()


def _drop(entry: _Entry, entries: list[_Entry]) -> None:
    entries.remove(entry)
    entry.path.unlink(missing_ok=True)


def _gives_way(entries: Sequence[_Entry]) -> _Entry:
    """Whose are most, from where theirs are most, the oldest: nobody can drive out what others asked."""
    asker, _ = Counter(one.asker for one in entries).most_common(1)[0]
    own = [one for one in entries if one.asker == asker]
    place, _ = Counter(one.place for one in own).most_common(1)[0]
    return min((one for one in own if one.place == place), key=lambda one: one.time_s)


def _place_of(T_map_camera: FloatArray) -> str:
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


def _from_file(entry: _Entry) -> AnsweredQuery:
    with safe_open(entry.path, framework="numpy") as file:
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
