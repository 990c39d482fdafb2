"""Who changed what: noted once for each change, readable, bounded."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import httpx
import pytest

from rholoc.service import audit as module
from rholoc.service.audit import Change, FolderAuditLog
from rholoc.service.guard import KeyPolicy
from rholoc.service.keys import KeyStore, Scope

PATIENCE_S = 60
CHANGE = Change(1.0, "alice", "PUT", "/v1/maps/hall", 200, "", "id")


@pytest.fixture
def locked(serve, picture_world):
    """A service that wants keys, the key of a mapper, and that of an administrator."""
    running = serve(keys=KeyPolicy.ALWAYS)
    store = KeyStore(running.settings.data_dir)
    return running, *(
        httpx.Client(
            base_url=running.url,
            headers={"Authorization": f"Bearer {store.create(name, scope)}"},
            timeout=PATIENCE_S,
        )
        for name, scope in (("mapper", Scope.MAP), ("boss", Scope.ADMIN))
    )


def test_changes_are_noted_with_who_made_them(locked, picture_world) -> None:
    _, mapper, boss = locked
    assert mapper.put("/v1/maps/hall", content=picture_world.rho()).status_code == 201
    assert mapper.patch("/v1/maps/hall", json={"name": "room"}).status_code == 200
    assert boss.delete("/v1/maps/room").status_code == 204
    changes = boss.get("/v1/audit").json()["changes"]
    assert [(one["who"], one["method"], one["path"], one["status"]) for one in changes] == [
        ("boss", "DELETE", "/v1/maps/room", 204),
        ("mapper", "PATCH", "/v1/maps/hall", 200),
        ("mapper", "PUT", "/v1/maps/hall", 201),
    ]
    assert all(one["request_id"] for one in changes)
    of_hall = boss.get("/v1/audit?map=hall").json()["changes"]
    assert [one["method"] for one in of_hall] == ["PATCH", "PUT"]
    assert len(boss.get("/v1/audit?limit=1").json()["changes"]) == 1


def test_a_recording_is_noted_with_its_job(locked) -> None:
    _, mapper, boss = locked
    sent = mapper.post("/v1/recordings", files={"file": ("walk.mp4", b"\0\0\0\x18ftypmp42")}, data={"map": "hall"})
    assert sent.status_code == 202, sent.text
    (change,) = boss.get("/v1/audit").json()["changes"]
    assert change["job"] == sent.json()["job"]["id"]


def test_what_was_refused_or_changes_nothing_is_not_noted(locked, picture_world) -> None:
    _, mapper, boss = locked
    assert mapper.put("/v1/maps/hall", content=b"no map").status_code == 422
    assert mapper.delete("/v1/maps/hall").status_code == 403
    assert httpx.put(f"{mapper.base_url}/v1/maps/hall", content=picture_world.rho()).status_code == 401
    mapper.put("/v1/maps/hall", content=picture_world.rho())
    png = {"content-type": "image/png"}
    assert mapper.post("/v1/maps/hall/localize?dof=6", content=picture_world.png(), headers=png).status_code == 200
    assert len(boss.get("/v1/audit").json()["changes"]) == 1
    assert mapper.get("/v1/audit").status_code == 403
    assert boss.get("/v1/audit?map=../x").json()["code"] == "invalid_name"


def test_the_oldest_are_forgotten(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_FILE_BYTES", 2000)
    log = FolderAuditLog(tmp_path)
    for number in range(500):
        log.note(replace(CHANGE, time=float(number)))
    kept = [change.time for change in log.changes(1000)]
    assert kept == sorted(kept, reverse=True)
    assert kept[0] == 499
    assert 30 < len(kept) < 100
    assert sum(path.stat().st_size for path in tmp_path.rglob("*")) < 6 * 5000
    assert len(list((tmp_path / "audit").glob("audit.jsonl*"))) == 5


def test_a_line_that_was_cut_off_is_passed_over(tmp_path: Path) -> None:
    log = FolderAuditLog(tmp_path)
    log.note(CHANGE)
    with (tmp_path / "audit" / "audit.jsonl").open("ab") as file:
        file.write(b'{"time": 2.0, "who"\n')
    log.note(replace(CHANGE, time=3.0))
    assert [change.time for change in log.changes(10)] == [3.0, 1.0]
    assert FolderAuditLog(tmp_path / "nowhere").changes(10) == []


def test_a_disk_that_is_full_does_not_stop_changes(locked, picture_world, monkeypatch) -> None:
    def full(self: FolderAuditLog, change: Change) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(FolderAuditLog, "note", full)
    _, mapper, _ = locked
    assert mapper.put("/v1/maps/hall", content=picture_world.rho()).status_code == 201
