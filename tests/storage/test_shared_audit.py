"""Who changed what, on servers that share a database."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import pytest

from rholoc.service import audit as module
from rholoc.service.audit import Change, FolderAuditLog, SharedAuditLog

CHANGE = Change(1.0, "alice", "PUT", "/v1/maps/hall", 200, "", "id")
PATHS = ("/v1/maps/hall", "/v1/maps/hall/plan", "/v1/maps/hall_2", "/v1/maps/hallX2", "/v1/recordings", "/v1/maps/%")


def test_each_server_shows_what_all_changed(open_storage: Any) -> None:
    here, there = (SharedAuditLog(open_storage().engine) for _ in range(2))
    with ThreadPoolExecutor(8) as threads:
        noting = (here.note, there.note)
        list(threads.map(lambda n: noting[n % 2](replace(CHANGE, request_id=str(n))), range(40)))
    assert {one.request_id for one in here.changes(100)} == {str(n) for n in range(40)}
    assert here.changes(100) == there.changes(100)
    assert len(there.changes(3)) == 3


@pytest.mark.parametrize("name", ["hall", "hall_2", "%", "room"])
def test_it_shows_what_one_server_alone_would(open_storage: Any, tmp_path: Any, name: str) -> None:
    shared, alone = SharedAuditLog(open_storage().engine), FolderAuditLog(tmp_path)
    for log in (shared, alone):
        for number, path in enumerate(PATHS):
            log.note(replace(CHANGE, time=float(number), path=path))
    assert shared.changes(9) == alone.changes(9)
    assert shared.changes(9, name) == alone.changes(9, name)


def test_the_oldest_are_forgotten(open_storage: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_ROWS", 20)
    monkeypatch.setattr(module, "_ROWS_AT_ONCE", 5)
    log = SharedAuditLog(open_storage().engine)
    for number in range(50):
        log.note(replace(CHANGE, time=float(number)))
    assert [one.time for one in log.changes(100)] == [float(number) for number in range(49, 29, -1)]
