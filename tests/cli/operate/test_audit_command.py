"""``rholoc audit``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from rholoc.service.access.audit import AuditLog, Change
from rholoc.storage.database import open_database

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
