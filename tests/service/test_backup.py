"""Backups: everything comes back, nothing is replaced, and what was cut off is refused whole."""

from __future__ import annotations

import io
import os
import tarfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rholoc.errors import Conflict, InvalidInput, StorageUnavailable
from rholoc.geometry import Camera
from rholoc.jobs import RecordingStore
from rholoc.maps import CameraLibrary, CameraProfile, MapLibrary, Site, SiteLibrary, SiteMap
from rholoc.service import backup as module
from rholoc.service.backup import back_up, restore
from rholoc.service.keys import KeyStore, Scope


@pytest.fixture
def folders(tmp_path: Path, picture_world) -> tuple[Path, Path]:
    """The folders of a server with a bit of everything."""
    maps, data = tmp_path / "maps", tmp_path / "data"
    library = MapLibrary(maps)
    for version in (1, 2, 3):
        library.put("hall", replace(picture_world.map_, info=replace(picture_world.map_.info, version=version)))
    library.put("room", picture_world.map_)
    SiteLibrary(maps).put("campus", Site(maps=(SiteMap("hall"),)))
    CameraLibrary(maps).put("phone", CameraProfile(Camera(640, 480, 500.0, 500.0, 320.0, 240.0)))
    (data / "index").mkdir(parents=True)
    (data / "index" / "views.sqlite").write_bytes(b"made again")
    (maps / ".0123.upload").write_bytes(b"half a map")
    with RecordingStore(data).begin() as pending:
        pending.write("walk.mp4", b"a film")
        pending.commit()
    (data / "recordings" / ".pending-1").mkdir()
    (data / "recordings" / ".pending-1" / "x").write_bytes(b"half a film")
    return maps, data


def contents(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_everything_comes_back(tmp_path: Path, folders) -> None:
    maps, data = folders
    secret = KeyStore(data).create("robot", Scope.MAP)
    before = contents(maps)
    made = back_up(tmp_path / "all.backup", maps, data, recordings=True)
    assert contents(maps) == before
    there = tmp_path / "there"
    assert restore(tmp_path / "all.backup", there / "maps", there / "data") == made
    assert contents(there / "maps") == {name: one for name, one in before.items() if not name.startswith(".0")}
    again = MapLibrary(there / "maps")
    assert again.names() == ["hall", "room"]
    assert {number: info.version for number, info in again.versions("hall").items()} == {1: 2, 2: 1}
    assert SiteLibrary(there / "maps").get("campus").maps == (SiteMap("hall"),)
    assert CameraLibrary(there / "maps").names() == ["phone"]
    found = KeyStore(there / "data").find(secret)
    assert found is not None
    assert found.scope is Scope.MAP
    assert secret.encode() not in (tmp_path / "all.backup").read_bytes()
    assert [entry.id for entry in RecordingStore(there / "data").list()] == [
        entry.id for entry in RecordingStore(data).list()
    ]
    assert not list((there / "data" / "recordings").glob(".pending*"))


def test_recordings_are_left_out_unless_asked_for(tmp_path: Path, folders) -> None:
    made = back_up(tmp_path / "all.backup", *folders)
    assert made.count("data/recordings/*/*") == 0
    assert made.count("maps/*.rho") == 2


def test_an_empty_server_is_backed_up_as_well(tmp_path: Path) -> None:
    (tmp_path / "maps").mkdir()
    back_up(tmp_path / "all.backup", tmp_path / "maps", tmp_path / "data")
    assert restore(tmp_path / "all.backup", tmp_path / "m", tmp_path / "d").files == {}


def test_nothing_is_replaced(tmp_path: Path, folders, picture_world) -> None:
    maps, data = folders
    file = tmp_path / "all.backup"
    back_up(file, maps, data)
    before, content = contents(maps), file.read_bytes()
    with pytest.raises(Conflict, match="exists already"):
        back_up(file, maps, data)
    with pytest.raises(Conflict, match=r"files exist already: .*Nothing was restored"):
        restore(file, maps, data)
    there = tmp_path / "there"
    MapLibrary(there).put("room", picture_world.map_)
    held = contents(there)
    with pytest.raises(Conflict, match=r"maps/room\.rho"):
        restore(file, there, tmp_path / "d")
    assert contents(maps) == before
    assert contents(there) == held
    assert contents(tmp_path / "d") == {}
    assert file.read_bytes() == content


def test_what_was_cut_off_anywhere_is_refused_whole(tmp_path: Path, folders) -> None:
    file, there = tmp_path / "all.backup", tmp_path / "there"
    back_up(file, *folders, recordings=True)
    whole = file.read_bytes()
    with tarfile.open(file) as tar:
        ends = [entry.offset for entry in tar] + [entry.offset_data + 1 for entry in tar]
    for length in sorted({0, 1, 511, 512, *ends, len(whole) // 2}):
        file.write_bytes(whole[:length])
        with pytest.raises(InvalidInput, match="Nothing was restored"):
            restore(file, there / "maps", there / "data")
        assert contents(there) == {}


def test_what_was_changed_anywhere_is_refused(tmp_path: Path, folders) -> None:
    file, there = tmp_path / "all.backup", tmp_path / "there"
    back_up(file, *folders, recordings=True)
    whole = file.read_bytes()
    with tarfile.open(file) as tar:
        spots = [entry.offset_data + entry.size // 2 for entry in tar if entry.size]
    for spot in spots:
        file.write_bytes(whole[:spot] + bytes([whole[spot] ^ 1]) + whole[spot + 1 :])
        with pytest.raises(InvalidInput):
            restore(file, there / "maps", there / "data")
        assert contents(there) == {}


@pytest.mark.parametrize(
    "name", ["../evil", "maps/../../evil", "/etc/evil", "maps", "data/", "other/file", "maps//x.rho", "maps\\..\\evil"]
)
def test_nothing_is_written_elsewhere(tmp_path: Path, name: str) -> None:
    file = tmp_path / "evil.backup"
    with tarfile.open(file, "w") as tar:
        entry = tarfile.TarInfo(name)
        entry.size = 4
        tar.addfile(entry, io.BytesIO(b"evil"))
    with pytest.raises(InvalidInput):
        restore(file, tmp_path / "in" / "maps", tmp_path / "in" / "data")
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == [file]


@pytest.mark.parametrize("content", [b"", b"no archive" * 100, os.urandom(4096)])
def test_another_file_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "x").write_bytes(content)
    with pytest.raises(InvalidInput):
        restore(tmp_path / "x", tmp_path / "maps", tmp_path / "data")
    with pytest.raises(InvalidInput, match="There is no file"):
        restore(tmp_path / "y", tmp_path / "maps", tmp_path / "data")


def while_linking(monkeypatch: pytest.MonkeyPatch, act: Callable[[int], None]) -> None:
    link, calls = module._link, iter(range(10**6))

    def acting(path: Path, into: Path) -> Path:
        act(next(calls))
        return link(path, into)

    monkeypatch.setattr(module, "_link", acting)
    monkeypatch.setattr(module, "_PAUSE_S", 0.0)


def test_maps_are_those_of_one_moment(tmp_path: Path, folders, picture_world, monkeypatch) -> None:
    maps, data = folders
    library = MapLibrary(maps)

    def publish_once(call: int) -> None:
        if call == 1:
            library.put("hall", replace(picture_world.map_, info=replace(picture_world.map_.info, version=4)))

    while_linking(monkeypatch, publish_once)
    back_up(tmp_path / "all.backup", maps, data)
    restore(tmp_path / "all.backup", tmp_path / "there", tmp_path / "d")
    again = MapLibrary(tmp_path / "there")
    versions = [again.get("hall").info.version, *(info.version for info in again.versions("hall").values())]
    assert versions == [4, 3, 2, 1]


def test_a_library_that_never_rests_is_said_so(tmp_path: Path, folders, monkeypatch) -> None:
    maps, data = folders
    rng = np.random.default_rng(0)

    while_linking(monkeypatch, lambda _: (maps / "cameras" / "phone.json").write_bytes(rng.bytes(rng.integers(1, 99))))
    with pytest.raises(StorageUnavailable):
        back_up(tmp_path / "all.backup", maps, data)
    assert not (tmp_path / "all.backup").exists()
    assert not list(maps.glob(".*.backup"))
