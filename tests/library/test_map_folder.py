"""A folder as a catalogue of maps: a change is made whole or not at all, wherever a process is killed in it."""

import itertools
import os
import shutil
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest

from rholoc.library.map_cache import MapCache, memory_bytes
from rholoc.library.map_folder import MapFolder
from rholoc.library.maps import MapLibrary
from rholoc.maps import Map, save_map

CHANGES: dict[str, Callable[[MapLibrary, Map], None]] = {
    "put": lambda library, map_: library.put("room", numbered(map_, 9)),
    "restore the last": lambda library, _: library.restore("room"),
    "restore an old one": lambda library, _: library.restore("room", 5),
    "rename": lambda library, _: library.rename("room", "hall"),
    "delete": lambda library, _: library.delete("room"),
}
STEPS = ("mkdir", "touch", "link", "rename", "replace", "unlink", "rmdir", "fsync")


class Killed(BaseException):
    """The process ends here."""


def numbered(map_: Map, number: int) -> Map:
    return replace(map_, info=replace(map_.info, id=f"{number:032x}"))


def contents(folder: Path) -> dict[str, list[str]]:
    """What a process that starts now finds: of each map, the ids of its versions, the present one first."""
    library = MapLibrary(folder)
    library.sweep()
    return {
        name: [library.get(name).info.id, *(info.id for info in library.versions(name).values())]
        for name in library.names()
    }


def killed_at(step: int, patch: pytest.MonkeyPatch) -> None:
    """Raise :class:`Killed` whenever something is asked of the disk, from the ``step``-th time on."""
    count = itertools.count()

    def counted(really: Any) -> Any:
        def act(*args: Any, **kwargs: Any) -> Any:
            if next(count) >= step:
                raise Killed
            return really(*args, **kwargs)

        return act

    for name in STEPS:
        if hasattr(os, name):
            patch.setattr(os, name, counted(getattr(os, name)))
    patch.setattr(shutil, "rmtree", counted(shutil.rmtree))


@pytest.mark.parametrize("change", CHANGES)
def test_a_change_is_made_whole_or_not_at_all(change: str, tmp_path: Path, room_map: Map) -> None:
    library = MapLibrary(tmp_path / "before")
    for number in range(7):
        library.put("room", numbered(room_map, number))
    library.put("other", room_map)
    before = contents(tmp_path / "before")
    shutil.copytree(tmp_path / "before", tmp_path / "after")
    CHANGES[change](MapLibrary(tmp_path / "after"), room_map)
    after = contents(tmp_path / "after")
    assert before != after
    found = []
    for step in itertools.count():
        folder = tmp_path / f"killed-{step}"
        shutil.copytree(tmp_path / "before", folder)
        with pytest.MonkeyPatch.context() as patch:
            killed_at(step, patch)
            try:
                CHANGES[change](MapLibrary(folder), room_map)
                ended = True
            except Killed:
                ended = False
        found.append(contents(folder))
        if ended:
            break
        MapLibrary(folder).put("room", numbered(room_map, 10))  # and it goes on
        assert contents(folder)["room"][0] == f"{10:032x}"
    assert found[0] == before
    assert found[-1] == after
    assert all(one in (before, after) for one in found)
    assert len(found) > 10


def test_a_change_that_cannot_be_made_is_not_made_later(tmp_path: Path, room_map: Map) -> None:
    library = MapLibrary(tmp_path)
    for number in range(3):
        library.put("room", numbered(room_map, number))
    before = contents(tmp_path)
    for call in ("unlink", "replace"):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(Path, call, Mock(side_effect=OSError(30, "Read-only file system")))
            with pytest.raises(OSError, match="Read-only"):
                library.delete("room") if call == "unlink" else library.restore("room", 2)
        assert contents(tmp_path) == before
    library.put("hall", room_map)
    assert contents(tmp_path)["room"] == before["room"]


def test_versions_that_somebody_removed_leave_no_gap(tmp_path: Path, room_map: Map) -> None:
    library = MapLibrary(tmp_path)
    for number in range(4):
        library.put("room", numbered(room_map, number))
    (tmp_path / ".previous" / "room.rho").unlink()
    assert [info.id for info in library.versions("room").values()] == [f"{1:032x}", f"{0:032x}"]
    library.restore("room", 2)
    assert contents(tmp_path)["room"] == [f"{number:032x}" for number in (0, 3, 1)]


def test_nobody_changes_the_folder_while_another_does(tmp_path: Path, room_map: Map) -> None:
    MapLibrary(tmp_path).put("room", room_map)
    other = threading.Thread(target=MapLibrary(tmp_path).delete, args=("room",))
    with MapFolder(tmp_path).changing():
        other.start()
        other.join(0.2)
        assert other.is_alive()
        assert MapLibrary(tmp_path).names() == ["room"]
    other.join()
    assert MapLibrary(tmp_path).names() == []


SIGNATURE = (1, 2, 3)


def test_the_map_that_was_asked_longest_ago_leaves(room_map: Map) -> None:
    maps = {name: replace(room_map) for name in "abc"}
    cache = MapCache(2 * memory_bytes(room_map))
    cache.put("a", SIGNATURE, maps["a"])
    cache.put("b", SIGNATURE, maps["b"])
    assert cache.get("a", SIGNATURE) is maps["a"]
    cache.put("c", SIGNATURE, maps["c"])
    assert [cache.holds(name, maps[name]) for name in "abc"] == [True, False, True]
    assert cache.get("b", SIGNATURE) is None


def test_a_map_larger_than_the_room_stays_until_another_comes(room_map: Map) -> None:
    cache, other = MapCache(0), replace(room_map)
    cache.put("a", SIGNATURE, room_map)
    assert cache.get("a", SIGNATURE) is room_map
    cache.put("b", SIGNATURE, other)
    assert cache.get("a", SIGNATURE) is None
    assert cache.get("b", SIGNATURE) is other


def test_a_map_whose_file_was_replaced_is_not_given(room_map: Map) -> None:
    cache = MapCache(1e9)
    cache.put("a", SIGNATURE, room_map)
    assert cache.get("a", (1, 2, 4)) is None
    cache.drop("a")
    assert cache.get("a", SIGNATURE) is None


def test_memory_counts_every_array(room_map: Map) -> None:
    without = replace(room_map, descriptors=replace(room_map.descriptors, values=room_map.descriptors.values[:0]))
    assert memory_bytes(room_map) - memory_bytes(without) == 2 * room_map.descriptors.values.nbytes


def test_a_library_keeps_what_it_has_room_for(tmp_path: Path, room_map: Map) -> None:
    for name in "abc":
        save_map(room_map, tmp_path / f"{name}.rho")
    library = MapLibrary(tmp_path, cache_bytes=2 * memory_bytes(room_map))
    first = library.get("a")
    assert library.get("a") is first
    assert library.readable() == ["a", "b", "c"]
    assert not library.keeps("a", first)
    again = library.get("a")
    assert again is not first
    assert library.keeps("a", again)
    assert library.readable() == ["a", "b", "c"]
    assert library.keeps("a", again)  # nothing was read anew to know that all are readable
