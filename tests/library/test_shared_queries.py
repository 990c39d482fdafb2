"""Queries that several servers keep together, and a worker elsewhere that learns from them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from kept_queries import LATELY_S, keep_queries
from rholoc.jobs import JobKind, JobOptions, JobQueue
from rholoc.jobs.table import JobTable
from rholoc.library import QueryStore
from rholoc.library.stores import ASKERS
from rholoc.service.frames.kept.learning import Learner
from rholoc.service.settings import Settings
from rholoc.storage import ObjectStorage
from rholoc.worker import WorkerSetup
from rholoc.worker.worker import Worker
from waiting import until

ALICE = "a" * 12


def test_an_asker_has_one_pseudonym_at_all_servers(open_storage: Any) -> None:
    storages = [open_storage() for _ in range(2)]
    learners = [Learner(QueryStore(one.objects), Settings(), one.documents(ASKERS)) for one in storages]
    first = learners[0].pseudonym("robot-7")
    storages[1].refresh()
    assert learners[1].pseudonym("robot-7") == first == learners[0].pseudonym("robot-7")
    assert learners[1].pseudonym("robot-8") != first
    assert "robot" not in first


@pytest.mark.slow
def test_a_worker_elsewhere_publishes_what_the_map_learned(
    open_storage: Any, tmp_path: Path, storage_url: str, point_room: Any
) -> None:
    """The steps of its job, without the queue."""
    shared = open_storage()
    shared.library.put("west", point_room.map_of(point_room.walk(80)[:45], "west"))
    before = shared.library.get("west")
    keep_queries(tmp_path / "asked", before, point_room, LATELY_S)
    store = QueryStore(shared.objects)
    for query in QueryStore(ObjectStorage(tmp_path / "asked")).load(before.info.id):
        store.add(before.info.id, replace(query, asker=ALICE))
    queue = JobQueue(shared.recordings)
    queue.submit("", "west", JobOptions(kind=JobKind.LEARN))
    worker = Worker(WorkerSetup(tmp_path / "data", tmp_path / "elsewhere", storage_url=storage_url))
    worker.start()
    try:
        until(lambda: queue.last_learning("west") is not None)
    finally:
        worker.stop()
    latest = queue.last_learning("west")
    queue.close()
    assert latest is not None
    assert latest.error_code is None, latest.error_message
    shared.refresh()
    after = shared.library.get("west").info
    assert (after.id, after.version) == (before.info.id, before.info.version + 1)
    assert after.report.learned[-1].queries is not None
    assert shared.library.versions("west")[1].version == before.info.version
    assert not list((tmp_path / "data" / "work").glob("*")), "copies of queries are removed with the job's other files"
    assert JobTable(shared.engine).learning("west") is None
