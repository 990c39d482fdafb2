"""Backups of what servers share: the same file as a single server's, and back into either."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from fake_pipeline import tiny_map

from rholoc.errors import Conflict, InvalidInput, StorageUnavailable
from rholoc.geometry import Camera
from rholoc.jobs import RecordingStore, SharedRecordingStore
from rholoc.jobs.recording_notes import WAYPOINTS_FILE
from rholoc.maps import CameraLibrary, CameraProfile, MapLibrary, Site, SiteLibrary, SiteMap
from rholoc.service.backup import restore
from rholoc.service.keys import KeyLimits, KeyStore, Scope
from rholoc.service.shared_backup import back_up_shared, restore_shared
from rholoc.storage import CAMERAS, KEYS, SITES, SharedStorage

PROFILE = CameraProfile(Camera(640, 480, 500.0, 500.0, 320.0, 240.0))


def version(number: int) -> Any:
    return replace(tiny_map(), info=replace(tiny_map().info, version=number))


@pytest.fixture
def shared(open_storage: Any, tmp_path: Path) -> SharedStorage:
    """A storage with a bit of everything, and of what is not backed up."""
    shared = open_storage()
    for number in (1, 2, 3):
        shared.library.put("hall", version(number))
    shared.library.put("gone", tiny_map())
    shared.library.delete("gone")
    SiteLibrary(tmp_path, shared.documents(SITES)).put("campus", Site(maps=(SiteMap("hall"),)))
    CameraLibrary(tmp_path, shared.documents(CAMERAS)).put("phone", PROFILE)
    store = SharedRecordingStore(tmp_path / "first", shared)
    entry = store.create([("walk.mp4", [b"a film"]), ("a/b.csv", [b"6"])])
    (store.folder(entry.id) / WAYPOINTS_FILE).write_text("name,x,y,z\n")
    store.share_notes(entry.id, [WAYPOINTS_FILE])
    return shared


@pytest.fixture
def other_storage(tmp_path: Path) -> Iterator[SharedStorage]:
    """An empty storage with a database of its own."""
    other = SharedStorage(f"file://{tmp_path}/other/storage", tmp_path / "other" / "data")
    other.open()
    yield other
    other.close()


def test_everything_comes_back_into_another_storage(shared: Any, other_storage: Any, tmp_path: Path) -> None:
    secret = KeyStore(tmp_path, shared.documents(KEYS)).create("robot", Scope.MAP, limits=KeyLimits(maps=3))
    file = tmp_path / "all.backup"
    made = back_up_shared(file, shared, tmp_path / "work", recordings=True)
    assert restore_shared(file, other_storage, tmp_path / "work") == made
    assert secret.encode() not in file.read_bytes()
    assert not list((tmp_path / "work").iterdir())
    assert other_storage.library.names() == ["hall"]
    assert {number: info.version for number, info in other_storage.library.versions("hall").items()} == {1: 2, 2: 1}
    assert other_storage.snapshot()[1] == shared.snapshot()[1]
    found = KeyStore(tmp_path, other_storage.documents(KEYS)).find(secret)
    assert found is not None
    assert found.limits == KeyLimits(maps=3)
    here, there = (SharedRecordingStore(tmp_path / str(n), one) for n, one in enumerate((shared, other_storage)))
    (entry,) = there.list()
    assert [entry] == here.list()
    assert (there.path(entry.id) / "a" / "b.csv").read_bytes() == b"6"
    assert (there.folder(entry.id) / WAYPOINTS_FILE).read_text() == "name,x,y,z\n"
    assert restore_shared(file, other_storage, tmp_path / "work") == made, "it may be repeated"


def test_a_single_server_can_restore_it(shared: Any, tmp_path: Path) -> None:
    back_up_shared(tmp_path / "all.backup", shared, tmp_path / "work", recordings=True)
    maps, data = tmp_path / "maps", tmp_path / "single"
    restore(tmp_path / "all.backup", maps, data)
    assert {number: info.version for number, info in MapLibrary(maps).versions("hall").items()} == {1: 2, 2: 1}
    assert CameraLibrary(maps).get("phone") == PROFILE
    assert SiteLibrary(maps).names() == ["campus"]
    store = RecordingStore(data)
    (entry,) = store.list()
    assert (store.folder(entry.id) / "walk.mp4").read_bytes() == b"a film"
    assert (store.folder(entry.id) / WAYPOINTS_FILE).is_file()


def test_nothing_that_is_different_is_replaced(shared: Any, other_storage: Any, tmp_path: Path) -> None:
    file = tmp_path / "all.backup"
    back_up_shared(file, shared, tmp_path / "work")
    with pytest.raises(Conflict, match="exists already"):
        back_up_shared(file, shared, tmp_path / "work")
    other_storage.library.put("hall", version(9))
    before = other_storage.snapshot()
    with pytest.raises(Conflict, match=r"maps/hall\.rho\. Nothing was restored"):
        restore_shared(file, other_storage, tmp_path / "work")
    assert other_storage.snapshot() == before
    cut = tmp_path / "cut.backup"
    cut.write_bytes(file.read_bytes()[:3000])
    with pytest.raises(InvalidInput, match="Nothing was restored"):
        restore_shared(cut, other_storage, tmp_path / "work")
    assert other_storage.snapshot() == before


def test_maps_are_those_of_one_moment(shared: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A map is replaced, and its file removed, while the backup is written: it begins again."""
    fetch, calls = shared.library._copies.fetch, iter(range(100))

    def replacing(blob: str, size_bytes: int, target: Path) -> None:
        if next(calls) == 0:
            for number in range(4, 11):
                shared.library.put("hall", version(number))
            named = {one.blob for one in shared.snapshot()[0]}
            for stored, _ in list(shared.library._copies.stored()):
                if stored not in named:
                    shared.library._copies.remove(stored)
        fetch(blob, size_bytes, target)

    monkeypatch.setattr(shared.library._copies, "fetch", replacing)
    back_up_shared(tmp_path / "all.backup", shared, tmp_path / "work")
    restore(tmp_path / "all.backup", tmp_path / "maps", tmp_path / "single")
    again = MapLibrary(tmp_path / "maps")
    versions = [again.get("hall").info.version, *(info.version for info in again.versions("hall").values())]
    assert versions == [10, 9, 8, 7, 6, 5]


def test_a_storage_that_lost_a_file_leaves_no_backup(shared: Any, tmp_path: Path) -> None:
    for stored, _ in list(shared.library._copies.stored()):
        shared.library._copies.remove(stored)
    with pytest.raises(StorageUnavailable, match="missing"):
        back_up_shared(tmp_path / "all.backup", shared, tmp_path / "work")
    assert not (tmp_path / "all.backup").exists()
