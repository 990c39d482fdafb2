"""Who changed what: noted once for each change, readable, bounded."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import httpx
import pytest
from sqlalchemy.exc import OperationalError

from rholoc.service.access import audit as module
from rholoc.service.access.audit import AuditLog, Change
from rholoc.service.access.keys import KeyStore, Scope
from rholoc.service.settings import KeyPolicy
from rholoc.storage.database import open_database

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


def test_without_keys_the_address_is_noted(serve, picture_world) -> None:
    with httpx.Client(base_url=serve().url, timeout=PATIENCE_S) as anyone:
        assert anyone.put("/v1/maps/hall", content=picture_world.rho()).status_code == 201
        (change,) = anyone.get("/v1/audit").json()["changes"]
    assert change["who"] == "127.0.0.1"


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


PATHS = ("/v1/maps/hall", "/v1/maps/hall/plan", "/v1/maps/hall_2", "/v1/maps/hallX2", "/v1/recordings", "/v1/maps/%")


@pytest.fixture
def logs(tmp_path: Path):
    """The logs of two processes that share a database."""
    engines = [open_database(tmp_path) for _ in range(2)]
    yield [AuditLog(engine) for engine in engines]
    for engine in engines:
        engine.dispose()


def test_each_process_shows_what_all_changed(logs) -> None:
    here, there = logs
    with ThreadPoolExecutor(8) as threads:
        list(threads.map(lambda n: logs[n % 2].note(replace(CHANGE, request_id=str(n))), range(40)))
    assert {one.request_id for one in here.changes(100)} == {str(n) for n in range(40)}
    assert here.changes(100) == there.changes(100)
    assert len(there.changes(3)) == 3


@pytest.mark.parametrize(
    ("name", "paths"), [("hall", PATHS[1::-1]), ("hall_2", PATHS[2:3]), ("%", PATHS[5:]), ("x", ())]
)
def test_the_changes_of_a_map_are_those_whose_path_names_it(logs, name: str, paths: tuple[str, ...]) -> None:
    for path in PATHS:
        logs[0].note(replace(CHANGE, path=path))
    assert tuple(one.path for one in logs[0].changes(9, name)) == paths


def test_the_oldest_are_forgotten(logs, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_ROWS", 20)
    monkeypatch.setattr(module, "_ROWS_AT_ONCE", 5)
    for number in range(50):
        logs[0].note(replace(CHANGE, time=float(number)))
    assert [one.time for one in logs[0].changes(100)] == [float(number) for number in range(49, 29, -1)]


def test_a_disk_that_is_full_does_not_stop_changes(locked, picture_world, monkeypatch) -> None:
    def full(self: AuditLog, change: Change) -> None:
        raise OperationalError("INSERT", {}, Exception("database or disk is full"))

    monkeypatch.setattr(AuditLog, "note", full)
    _, mapper, _ = locked
    assert mapper.put("/v1/maps/hall", content=picture_world.rho()).status_code == 201
