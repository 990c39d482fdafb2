"""Which maps are in memory."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from rholoc.library import MapLibrary
from rholoc.library.map_cache import MapCache, memory_bytes
from rholoc.maps import Map, save_map

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
