"""The library of maps: names, replacing, and what bad input leaves alone."""

import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rholoc.errors import Conflict, InvalidMap, InvalidName, StorageFull, UnknownMap
from rholoc.library.map_folder import place_of
from rholoc.library.maps import MapLibrary
from rholoc.maps import Cloud, Map, check_map_name, map_to_bytes, save_map


@pytest.fixture
def library(tmp_path: Path) -> MapLibrary:
    return MapLibrary(tmp_path / "maps")


def with_version(map_: Map, version: int) -> Map:
    return replace(map_, info=replace(map_.info, version=version))


NO_NAMES = ["", ".", "..", "../up", "a/b", "a\\b", "/etc/passwd", ".hidden", "-x", "a b", "ä", "a\n", "a\0"]


@pytest.mark.parametrize("name", [*NO_NAMES, "x" * 65, "x" * 300])
def test_what_is_not_a_name_is_refused_everywhere(library: MapLibrary, room_map: Map, name: str) -> None:
    for use in (
        check_map_name,
        library.path,
        library.get,
        library.stat,
        library.delete,
        lambda n: library.put(n, room_map),
        lambda n: library.put_file(n, b""),
        lambda n: library.rename(n, "x"),
    ):
        with pytest.raises(InvalidName) as caught:
            use(name)
        assert len(str(caught.value)) < 300


@given(st.from_regex(r"[A-Za-z0-9_][A-Za-z0-9._-]{0,63}", fullmatch=True))
def test_names_stay_inside_the_folder(name: str) -> None:
    assert Path(place_of(name)).parent == Path()
    assert Path(place_of(name, 2)).parent == Path(place_of("room", 1)).parent


def test_maps_are_kept_by_name(library: MapLibrary, room_map: Map) -> None:
    assert library.names() == []
    library.put("kitchen", room_map)
    library.put("hall.v2", room_map)
    (library.folder / "notes.txt").write_text("not a map")
    (library.folder / ".hidden.rho").write_text("not a map")
    assert library.names() == ["hall.v2", "kitchen"]
    assert library.get("kitchen").info == room_map.info
    assert library.stat("kitchen").size_bytes == library.path("kitchen").stat().st_size


def test_an_unknown_map_names_those_there_are(library: MapLibrary, room_map: Map) -> None:
    library.put("kitchen", room_map)
    for use in (library.get, library.stat, library.delete, lambda n: library.rename(n, "x")):
        with pytest.raises(UnknownMap) as caught:
            use("hall")
        assert "kitchen" in caught.value.hint


def test_a_map_is_read_once(library: MapLibrary, room_map: Map) -> None:
    library.put("kitchen", room_map)
    assert library.get("kitchen") is library.get("kitchen")


def test_a_replaced_map_is_read_again_and_the_old_one_lives_on(library: MapLibrary, room_map: Map) -> None:
    library.put("kitchen", room_map)
    old = library.get("kitchen")
    save_map(with_version(room_map, 2), library.path("kitchen"))  # as another process would
    assert library.get("kitchen").info.version == 2
    assert old.info.version == 1
    assert len(old.landmarks) == len(room_map)


def test_an_upload_is_checked_before_it_replaces(library: MapLibrary, room_map: Map, tmp_path: Path) -> None:
    library.put("kitchen", room_map)
    whole = map_to_bytes(with_version(room_map, 2))
    for broken in (b"", b"not a map", whole[:-1], whole[: len(whole) // 2], whole[:-1] + bytes([whole[-1] ^ 1])):
        with pytest.raises(InvalidMap) as caught:
            library.put_file("kitchen", broken)
        assert ".upload" not in caught.value.message
    with pytest.raises(InvalidMap):
        library.put_file("kitchen", tmp_path / "missing.rho")
    assert library.get("kitchen").info.version == 1
    assert [path.name for path in library.folder.iterdir()] == ["kitchen.rho"]

    assert library.put_file("kitchen", whole).info.version == 2
    assert library.get("kitchen").info.version == 2
    (tmp_path / "given.rho").write_bytes(map_to_bytes(with_version(room_map, 3)))
    library.put_file("kitchen", tmp_path / "given.rho")
    assert library.get("kitchen").info.version == 3
    assert (tmp_path / "given.rho").exists()


def test_a_full_disk_replaces_nothing(library: MapLibrary, room_map: Map, monkeypatch: pytest.MonkeyPatch) -> None:
    library.put("kitchen", room_map)

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("rholoc.disk.os.fsync", full)
    with pytest.raises(StorageFull):
        library.put("kitchen", with_version(room_map, 2))
    with pytest.raises(StorageFull, match=r"kitchen\.rho"):
        library.put_file("kitchen", map_to_bytes(with_version(room_map, 2)))
    monkeypatch.undo()
    assert library.get("kitchen").info.version == 1
    assert [path.name for path in library.folder.iterdir()] == ["kitchen.rho"]


def test_a_file_that_became_broken_is_reported_and_heals(library: MapLibrary, room_map: Map) -> None:
    library.put("kitchen", room_map)
    library.get("kitchen")
    library.path("kitchen").write_bytes(b"broken")
    with pytest.raises(InvalidMap):
        library.get("kitchen")
    library.put("kitchen", room_map)
    assert library.get("kitchen").info == room_map.info


def test_delete_and_rename(library: MapLibrary, room_map: Map) -> None:
    library.put("a", room_map)
    library.put("b", with_version(room_map, 2))
    held = library.get("a")
    with pytest.raises(Conflict):
        library.rename("a", "b")
    assert library.get("b").info.version == 2
    library.rename("a", "c")
    assert library.names() == ["b", "c"]
    with pytest.raises(UnknownMap):
        library.get("a")
    library.delete("c")
    assert library.names() == ["b"]
    assert held.info.version == 1


def test_readers_never_see_a_part_while_a_writer_replaces(library: MapLibrary, room_map: Map) -> None:
    library.put("kitchen", room_map)
    versions: set[int] = set()
    failures: list[Exception] = []
    done = threading.Event()

    def read() -> None:
        while not done.is_set():
            try:
                versions.add(library.get("kitchen").info.version)
            except Exception as error:
                failures.append(error)

    readers = [threading.Thread(target=read) for _ in range(3)]
    for reader in readers:
        reader.start()
    for version in range(2, 40):
        library.put("kitchen", with_version(room_map, version))
    done.set()
    for reader in readers:
        reader.join()
    assert failures == []
    assert len(versions) > 1
    assert library.get("kitchen").info.version == 39


def test_a_map_that_is_replaced_is_kept_and_restored(tmp_path, picture_world):
    library = MapLibrary(tmp_path)
    assert library.previous("room") is None
    first, second = picture_world.rho(id="1" * 32), picture_world.rho(id="2" * 32)
    library.put_file("room", first)
    with pytest.raises(Conflict, match="not replaced another"):
        library.restore("room")
    library.put_file("room", second)
    assert library.names() == ["room"]
    assert library.previous("room").id == "1" * 32
    library.restore("room")
    assert library.path("room").read_bytes() == first
    assert library.previous("room").id == "2" * 32
    library.restore("room")
    assert library.path("room").read_bytes() == second


def test_a_map_that_is_furnished_keeps_its_versions(tmp_path, picture_world):
    library = MapLibrary(tmp_path / "maps")
    published, furnished, later = (tmp_path / f"{name}.rho" for name in ("published", "furnished", "later"))
    dots = np.zeros((1, 3), np.float32), np.zeros((1, 3), np.uint8), np.zeros(1, np.int32)
    published.write_bytes(picture_world.rho())
    furnished.write_bytes(map_to_bytes(replace(picture_world.map_, cloud=Cloud(*dots))))
    later.write_bytes(picture_world.rho(version=4))
    library.furnish("room", published, furnished)  # it was deleted meanwhile
    assert library.names() == []
    library.put_file("room", published)
    library.furnish("room", published, furnished)
    assert library.path("room").read_bytes() == furnished.read_bytes()
    assert library.previous("room") is None
    library.put_file("room", later)
    library.furnish("room", published, furnished)  # it has changed meanwhile
    assert library.path("room").read_bytes() == later.read_bytes()


def test_the_last_five_versions_are_kept_and_any_is_restored(tmp_path, picture_world):
    library = MapLibrary(tmp_path)
    files = [picture_world.rho(version=number) for number in range(8)]
    for file in files:
        library.put_file("room", file)

    def versions():
        return [info.version for info in library.versions("room").values()]

    assert versions() == [6, 5, 4, 3, 2]
    library.restore("room", 3)
    assert library.path("room").read_bytes() == files[4]
    assert versions() == [7, 6, 5, 3, 2]
    library.put_file("room", files[0])
    assert versions() == [4, 7, 6, 5, 3]
    with pytest.raises(Conflict, match="no version 6"):
        library.restore("room", 6)
    library.put_file("room.rho.2", files[1])
    library.rename("room", "hall")
    assert versions() == []
    assert sorted(library.versions("hall")) == [1, 2, 3, 4, 5]
    library.delete("hall")
    assert list((tmp_path / ".previous").iterdir()) == []
    assert library.names() == ["room.rho.2"]


def test_the_map_before_goes_where_the_map_goes(tmp_path, picture_world):
    library = MapLibrary(tmp_path)
    for number in ("1", "2"):
        library.put_file("room", picture_world.rho(id=number * 32))
    library.rename("room", "hall")
    assert library.previous("room") is None
    assert library.previous("hall").id == "1" * 32
    library.delete("hall")
    library.put_file("hall", picture_world.rho())
    assert library.previous("hall") is None


def test_a_damaged_map_before_changes_nothing(tmp_path, picture_world):
    library = MapLibrary(tmp_path)
    for number in ("1", "2"):
        library.put_file("room", picture_world.rho(id=number * 32))
    (kept,) = (tmp_path / ".previous").iterdir()
    kept.write_bytes(b"damaged")
    assert library.previous("room") is None
    with pytest.raises(InvalidMap, match="The map before room"):
        library.restore("room")
    assert library.get("room").info.id == "2" * 32
