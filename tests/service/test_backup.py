"""Backups: everything comes back, into folders or a shared storage; nothing is replaced; what is damaged is refused."""

import io
import os
import tarfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from rholoc.errors import Conflict, InvalidInput, StorageUnavailable
from rholoc.geometry import Camera
from rholoc.library.cameras import CameraLibrary, CameraProfile
from rholoc.library.recording_notes import WAYPOINTS_FILE
from rholoc.library.sites import SiteLibrary
from rholoc.library.stores import CAMERAS, KEYS, SITES, Stores
from rholoc.maps import Map, Site, SiteMap
from rholoc.service.access.keys import KeyLimits, KeyStore, Scope
from rholoc.service.operate import backup as module
from rholoc.service.operate.backup import back_up, restore

SHARED = [False, True]


@pytest.fixture
def open_stores(tmp_path: Path) -> Iterator[Callable[..., Stores]]:
    """Opens the stores of a server by its name: in folders of its own, or shared with others."""
    opened: dict[str, Stores] = {}

    def open_one(name: str, shared: bool) -> Stores:
        if name not in opened:
            url = f"file://{tmp_path / name}/storage" if shared else None
            opened[name] = Stores(tmp_path / name / "maps", tmp_path / name / "data", None, url)
            opened[name].open()
        return opened[name]

    yield open_one
    for stores in opened.values():
        stores.close()


def version(picture_world, number: int) -> Map:
    return replace(picture_world.map_, info=replace(picture_world.map_.info, version=number))


@pytest.fixture(params=SHARED, ids=["alone", "shared"])
def stores(request, open_stores, picture_world) -> Stores:
    """A bit of everything, and of what is not backed up."""
    stores = open_stores("here", request.param)
    for number in (1, 2, 3):
        stores.library.put("hall", version(picture_world, number))
    stores.library.put("room", picture_world.map_)
    stores.library.put("gone", picture_world.map_)
    stores.library.delete("gone")
    SiteLibrary(stores.documents(SITES)).put("campus", Site(maps=(SiteMap("hall"),)))
    profile = CameraProfile(Camera(640, 480, 500.0, 500.0, 320.0, 240.0))
    CameraLibrary(stores.documents(CAMERAS)).put("phone", profile)
    KeyStore(stores.documents(KEYS)).create("robot", Scope.MAP, limits=KeyLimits(maps=3))
    entry = stores.recordings.create([("walk.mp4", [b"a film"]), ("a/b.csv", [b"6"])])
    stores.recordings.note(entry.id, {WAYPOINTS_FILE: b"name,x,y,z"})
    (stores.data_dir / "index").mkdir()
    (stores.data_dir / "index" / "views.sqlite").write_bytes(b"made again")
    (stores.library.folder / ".0123.upload").write_bytes(b"half a map")
    (stores.data_dir / "recordings" / ".pending-1").mkdir()
    (stores.data_dir / "recordings" / ".pending-1" / "x").write_bytes(b"half a film")
    return stores


def contents(stores: Stores) -> object:
    """Everything of stores that a backup holds."""
    maps = {name: stores.library.path(name).read_bytes() for name in stores.library.names()}
    before = {name: stores.library.versions(name) for name in maps}
    documents = {
        (kind, name): stores.documents(kind).read(name)
        for kind in (CAMERAS, SITES, KEYS)
        for name in stores.documents(kind).names()
    }
    recordings = {}
    for entry in stores.recordings.list():
        stores.recordings.path(entry.id)
        folder = stores.recordings.root / entry.id
        recordings[entry] = stores.recordings.notes(entry.id), [(folder / name).read_bytes() for name in entry.files]
    return maps, before, documents, recordings


NOTHING: object = ({}, {}, {}, {})


@pytest.mark.parametrize("shared", SHARED, ids=["into folders", "into a storage"])
def test_everything_comes_back(tmp_path: Path, stores: Stores, open_stores, shared: bool) -> None:
    file, before = tmp_path / "all.backup", contents(stores)
    made = back_up(file, stores, recordings=True)
    assert file.stat().st_mode & 0o777 == 0o600
    there = open_stores("there", shared)
    restored, moved = restore(file, there)
    assert (restored, moved.left, moved.unreadable) == (made, (), ())
    assert contents(there) == before == contents(stores)
    assert {number: info.version for number, info in there.library.versions("hall").items()} == {1: 2, 2: 1}
    again, moved = restore(file, there)
    assert (again, moved.maps, len(moved.left)) == (made, 0, 6), "it may be repeated"
    assert contents(there) == before
    for one in (stores, there):
        assert not list(one.data_dir.glob(".*.backup"))


def test_no_key_is_in_it(tmp_path: Path, open_stores) -> None:
    stores = open_stores("here", False)
    secret = KeyStore(stores.data_dir).create("boss", Scope.ADMIN)
    back_up(tmp_path / "all.backup", stores)
    assert secret.encode() not in (tmp_path / "all.backup").read_bytes()
    there = open_stores("there", True)
    restore(tmp_path / "all.backup", there)
    found = KeyStore(there.documents(KEYS)).find(secret)
    assert found.scope is Scope.ADMIN


def test_recordings_are_left_out_unless_asked_for(tmp_path: Path, stores: Stores) -> None:
    made = back_up(tmp_path / "all.backup", stores)
    assert made.count("data/recordings/*/*") == 0
    assert made.count("maps/*.rho") == 2


@pytest.mark.parametrize("shared", SHARED)
def test_an_empty_server_is_backed_up_as_well(tmp_path: Path, open_stores, shared: bool) -> None:
    back_up(tmp_path / "all.backup", open_stores("here", shared))
    assert restore(tmp_path / "all.backup", open_stores("there", shared))[0].files == {}


def test_a_map_that_cannot_be_read_keeps_nothing_else_from_coming_back(tmp_path, open_stores, picture_world) -> None:
    here, there = open_stores("here", False), open_stores("there", True)
    for name in ("hall", "room"):
        here.library.put(name, picture_world.map_)
    here.library.path("room").write_bytes(b"no map")
    made = back_up(tmp_path / "all.backup", here)
    restored, moved = restore(tmp_path / "all.backup", there)
    assert (restored, moved.unreadable) == (made, ("room",))
    assert there.library.names() == ["hall"]


def test_nothing_that_is_different_is_replaced(tmp_path: Path, stores: Stores, open_stores, picture_world) -> None:
    file = tmp_path / "all.backup"
    back_up(file, stores)
    content = file.read_bytes()
    with pytest.raises(Conflict, match="exists already"):
        back_up(file, stores)
    there = open_stores("there", stores.are_shared)
    there.library.put("room", version(picture_world, 9))
    there.documents(CAMERAS).write("phone.json", b"{}")
    held = contents(there)
    with pytest.raises(Conflict, match=r"maps/room\.rho, maps/cameras/phone\.json\. Nothing was restored"):
        restore(file, there)
    assert contents(there) == held
    assert file.read_bytes() == content


def test_what_was_cut_off_or_changed_anywhere_is_refused_whole(tmp_path: Path, stores: Stores, open_stores) -> None:
    file, there = tmp_path / "all.backup", open_stores("there", False)
    back_up(file, stores, recordings=True)
    whole = file.read_bytes()
    with tarfile.open(file) as tar:
        entries = list(tar)
    ends = [entry.offset for entry in entries] + [entry.offset_data + 1 for entry in entries]
    spots = [entry.offset_data + entry.size // 2 for entry in entries if entry.size]
    damaged = [whole[:length] for length in sorted({0, 1, 511, 512, *ends, len(whole) // 2})]
    damaged += [whole[:spot] + bytes([whole[spot] ^ 1]) + whole[spot + 1 :] for spot in spots]
    for content in damaged:
        file.write_bytes(content)
        with pytest.raises(InvalidInput, match="Nothing was restored"):
            restore(file, there)
    assert contents(there) == NOTHING


@pytest.mark.parametrize(
    "name", ["../evil", "maps/../../evil", "/etc/evil", "maps", "data/", "other/file", "maps//x.rho", "maps\\..\\evil"]
)
def test_nothing_is_written_elsewhere(tmp_path: Path, open_stores, name: str) -> None:
    file = tmp_path / "evil.backup"
    with tarfile.open(file, "w") as tar:
        entry = tarfile.TarInfo(name)
        entry.size = 4
        tar.addfile(entry, io.BytesIO(b"evil"))
    with pytest.raises(InvalidInput):
        restore(file, open_stores("in", False))
    found = [path for path in tmp_path.rglob("*") if path.is_file() and "jobs.sqlite" not in path.name]
    assert found == [file]


@pytest.mark.parametrize("content", [b"", b"no archive" * 100, os.urandom(4096)])
def test_another_file_is_refused(tmp_path: Path, open_stores, content: bytes) -> None:
    there = open_stores("there", False)
    (tmp_path / "x").write_bytes(content)
    with pytest.raises(InvalidInput):
        restore(tmp_path / "x", there)
    with pytest.raises(InvalidInput, match="There is no file"):
        restore(tmp_path / "y", there)


def before_the_first_file(monkeypatch: pytest.MonkeyPatch, act: Callable[[], None]) -> None:
    """Act once, after a backup has begun."""
    add, calls = module._add, iter(range(10**6))

    def acting(*args: object) -> object:
        if next(calls) == 0:
            act()
        return add(*args)

    monkeypatch.setattr(module, "_add", acting)


def test_maps_of_a_folder_are_those_of_one_moment(tmp_path: Path, open_stores, picture_world, monkeypatch) -> None:
    here, there = open_stores("here", False), open_stores("there", False)
    for number in (1, 2, 3):
        here.library.put("hall", version(picture_world, number))
    before_the_first_file(monkeypatch, lambda: here.library.put("hall", version(picture_world, 4)))
    back_up(tmp_path / "all.backup", here)
    restore(tmp_path / "all.backup", there)
    assert versions(there) == [3, 2, 1]


def test_maps_of_a_storage_are_those_of_one_moment(tmp_path: Path, open_stores, picture_world, monkeypatch) -> None:
    """A map is replaced, and its file removed, while the backup is written: it begins again."""
    here, there = open_stores("here", True), open_stores("there", False)
    for number in (1, 2, 3):
        here.library.put("hall", version(picture_world, number))
    monkeypatch.setattr("rholoc.library.shared_maps._ORPHANED_AFTER_S", -10)

    def replace_all() -> None:
        for number in range(4, 11):
            here.library.put("hall", version(picture_world, number))
        here.library.sweep()

    before_the_first_file(monkeypatch, replace_all)
    back_up(tmp_path / "all.backup", here)
    restore(tmp_path / "all.backup", there)
    assert versions(there) == [10, 9, 8, 7, 6, 5]


def versions(stores: Stores) -> list[int]:
    """The version of the map hall, and those before it."""
    before = stores.library.versions("hall").values()
    return [stores.library.get("hall").info.version, *(info.version for info in before)]


def test_a_storage_that_lost_a_file_leaves_no_backup(tmp_path: Path, open_stores, picture_world) -> None:
    here = open_stores("here", True)
    here.library.put("hall", picture_world.map_)
    for stored, _ in list(here.copies.stored()):
        here.copies.remove(stored)
    with pytest.raises(StorageUnavailable, match="missing"):
        back_up(tmp_path / "all.backup", here)
    assert not (tmp_path / "all.backup").exists()
