"""``rholoc backup`` and ``rholoc restore``."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from rholoc.library import MapLibrary, Stores
from rholoc.service.access.keys import KeyStore, Scope

Run = Callable[..., tuple[int, str, str]]


def test_there_and_back_in_two_commands(command: Run, tmp_path: Path, picture_world) -> None:
    MapLibrary(tmp_path / "maps").put("hall", picture_world.map_)
    secret = KeyStore(tmp_path / "data").create("robot", Scope.READ)
    here = ("--maps", tmp_path / "maps", "--data", tmp_path / "data")
    there = ("--maps", tmp_path / "m", "--data", tmp_path / "d")
    status, _, said = command("backup", tmp_path / "all.backup", *here)
    assert status == 0
    assert "Backed up: 1 maps, 0 versions, 0 sites, 0 cameras, 1 keys, 0 recordings" in said
    status, printed, _ = command("restore", tmp_path / "all.backup", *there, "--json")
    assert status == 0
    assert json.loads(printed)["maps"] == 1
    assert MapLibrary(tmp_path / "m").names() == ["hall"]
    assert KeyStore(tmp_path / "d").find(secret) is not None


def test_what_is_there_is_not_replaced(command: Run, tmp_path: Path, picture_world) -> None:
    MapLibrary(tmp_path / "maps").put("hall", picture_world.map_)
    here = ("--maps", tmp_path / "maps", "--data", tmp_path / "data")
    command("backup", tmp_path / "all.backup", *here)
    other = replace(picture_world.map_, info=replace(picture_world.map_.info, version=9))
    MapLibrary(tmp_path / "maps").put("hall", other)
    for again in ("backup", "restore"):
        status, _, said = command(again, tmp_path / "all.backup", *here)
        assert status == 1
        assert "exist" in said
        assert said.count("\n") == 1


def test_what_servers_share_is_backed_up_and_restored_as_well(
    command: Run, tmp_path: Path, picture_world, monkeypatch
) -> None:
    for name in ("here", "there"):
        monkeypatch.setenv("RHOLOC_STORAGE_URL", f"file://{tmp_path / name}/storage")
        shared = Stores(tmp_path / "none", tmp_path / name, storage_url=f"file://{tmp_path / name}/storage")
        shared.open()
        if name == "here":
            shared.library.put("hall", picture_world.map_)
            assert command("backup", tmp_path / "all.backup", "--data", tmp_path / name)[0] == 0
        else:
            status, said, _ = command("restore", tmp_path / "all.backup", "--data", tmp_path / name, "--json")
            assert (status, json.loads(said)["maps"]) == (0, 1)
            shared.refresh()
            assert shared.library.names() == ["hall"]
        shared.close()
