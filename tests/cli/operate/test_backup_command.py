"""``rholoc backup`` and ``rholoc restore``."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from rholoc.cli import app
from rholoc.errors import Conflict, NotFound
from rholoc.library.maps import MapLibrary
from rholoc.library.stores import Stores
from rholoc.service.access.audit import AuditLog, Change
from rholoc.service.access.keys import KeyLimits, KeyStore, Scope
from rholoc.storage.database import open_database

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


CHANGE = Change(1.0, "alice", "PUT", "/v1/maps/hall", 200, "", "id")


def test_the_command_shows_them(command: Callable[..., tuple[int, str, str]], tmp_path: Path) -> None:
    assert "Nothing was changed" in command("audit", "--data", tmp_path)[2]
    engine = open_database(tmp_path)
    AuditLog(engine).note(replace(CHANGE, job="a" * 32))
    AuditLog(engine).note(replace(CHANGE, path="/v1/maps/room"))
    engine.dispose()
    status, shown, _ = command("audit", "--data", tmp_path, "--map", "hall")
    assert status == 0
    assert "alice: PUT /v1/maps/hall, job aaaa" in shown
    assert "room" not in shown
    assert '"who": "alice"' in command("audit", "--data", tmp_path, "--json")[1]


def run(folder: Path, *arguments: str) -> Result:
    return CliRunner().invoke(app, ["key", *arguments, "--data", str(folder)])


def test_a_key_is_printed_alone_and_works_until_it_is_revoked(tmp_path):
    secret = run(tmp_path, "create", "robot", "--scope", "map", "--expires", "1").stdout.strip()
    key = KeyStore(tmp_path).find(secret)
    assert (key.name, key.scope, key.expires - key.created) == ("robot", Scope.MAP, 24 * 3600)
    assert run(tmp_path, "revoke", "robot").exit_code == 0
    assert KeyStore(tmp_path).find(secret) is None


def test_keys_are_listed_without_their_secrets(tmp_path):
    secret = run(tmp_path, "create", "[bold]robot").stdout.strip()
    assert "[bold]robot: localize" in run(tmp_path, "list").stdout
    listed = run(tmp_path, "list", "--json").stdout
    (key,) = json.loads(listed)
    assert (key["name"], key["scope"], key["expires"]) == ("[bold]robot", "localize", None)
    assert secret not in listed


def test_limits_are_set_changed_and_lifted(tmp_path):
    run(tmp_path, "create", "robot", "--requests-per-s", "5", "--burst", "20", "--stored-bytes", "1000")
    (key,) = KeyStore(tmp_path).keys()
    assert key.limits == KeyLimits(5.0, 20, None, 1000, None)
    assert "5 requests a second, 20 at once, 1000 bytes" in run(tmp_path, "list").stdout
    assert run(tmp_path, "limit", "robot", "--maps", "3", "--jobs", "0").exit_code == 0
    (listed,) = json.loads(run(tmp_path, "list", "--json").stdout)
    assert (listed["limits"]["maps"], listed["limits"]["jobs"], listed["limits"]["burst"]) == (3, 0, None)
    run(tmp_path, "limit", "robot")
    assert KeyStore(tmp_path).named("robot").limits == KeyLimits()
    assert run(tmp_path, "limit", "robot", "--burst", "0").exit_code == 2


@pytest.mark.parametrize(
    ("arguments", "kind"), [(("create", "a"), Conflict), (("revoke", "b"), NotFound), (("limit", "b"), NotFound)]
)
def test_what_cannot_be_done_is_said(tmp_path, arguments, kind):
    run(tmp_path, "create", "a")
    assert isinstance(run(tmp_path, *arguments).exception, kind)


def test_a_scope_that_there_is_not_is_wrong_usage(tmp_path):
    assert run(tmp_path, "create", "a", "--scope", "all").exit_code == 2
