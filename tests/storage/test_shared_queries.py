"""Queries that several servers keep together, and a worker elsewhere that learns from them."""

from __future__ import annotations

import os
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kept_queries import LATELY_S, a_query, keep_queries
from rholoc.jobs import JobKind, JobOptions, JobQueue, KeptLimits, QueryStore, SharedQueryStore
from rholoc.jobs.table import JobTable
from rholoc.jobs.worker import Worker
from rholoc.service.learning import Learner
from rholoc.service.settings import Settings
from rholoc.storage import ASKERS
from waiting import until

MAP, OTHER = "0123456789abcdef", "f" * 16
ALICE, BOB = "a" * 12, "b" * 12
NOW = 1e9


@pytest.fixture
def stores(open_storage: Any) -> tuple[SharedQueryStore, SharedQueryStore]:
    """Of two servers."""
    return SharedQueryStore(open_storage().objects), SharedQueryStore(open_storage().objects)


def test_what_one_server_keeps_all_know(stores: Any) -> None:
    here, there = stores
    kept = [a_query(time_s=NOW + 0.125), a_query(x=3.0, time_s=NOW + 1, asker=BOB)]
    here.add(MAP, kept[0])
    there.add(MAP, kept[1])
    for store in stores:
        assert (store.kept(MAP).queries, store.kept(MAP).askers, store.kept(OTHER).queries) == (2, 2, 0)
        assert store.newer_than(MAP, NOW + 0.5) == 1
        read = store.load(MAP)
        assert [one.time_s for one in read] == [one.time_s for one in kept]
        np.testing.assert_array_equal(read[0].features.descriptors, kept[0].features.descriptors)
        np.testing.assert_array_equal(read[1].T_map_camera, kept[1].T_map_camera)
    assert there.kept(MAP).size_bytes > 2 * kept[0].features.descriptors.nbytes
    assert there.delete(MAP, ALICE) == 1
    assert [one.asker for one in here.load(MAP)] == [BOB]
    assert here.delete(MAP) == 1
    assert there.kept(MAP).queries == 0


def test_who_stays_in_one_place_is_heard_once_a_while_by_all_servers(stores: Any, monkeypatch: Any) -> None:
    here, there = stores
    T = a_query().T_map_camera
    assert here.wants(MAP, T, ALICE, NOW)
    here.add(MAP, a_query(time_s=NOW))
    assert not there.wants(MAP, T, ALICE, NOW + 30)
    assert there.wants(MAP, T, BOB, NOW + 30)
    assert there.wants(OTHER, T, ALICE, NOW + 30)
    with monkeypatch.context() as unreachable:  # who is known to stay there costs the storage nothing
        unreachable.setattr(here, "_objects", None)
        assert not here.wants(MAP, T, ALICE, NOW + 50)
    assert here.wants(MAP, T, ALICE, NOW + 61)


def test_what_is_kept_is_bounded_over_all_servers(open_storage: Any) -> None:
    stores = [SharedQueryStore(open_storage().objects, KeptLimits(queries=6)) for _ in range(2)]
    stores[0].add(MAP, a_query(asker=BOB))
    for place in range(10):
        stores[place % 2].add(MAP, a_query(x=place, time_s=NOW + place))
    kept = stores[0].load(MAP)
    assert len(kept) == 6
    assert sum(one.asker == BOB for one in kept) == 1
    assert max(one.time_s for one in kept) == NOW + 9


def test_what_has_expired_goes_and_what_is_of_no_map_a_day_later(
    open_storage: Any, storage_url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    store, now = SharedQueryStore(open_storage().objects, KeptLimits(expire_s=3600)), time.time()
    store.add(MAP, a_query(time_s=now - 7200))
    store.add(MAP, a_query(x=2, time_s=now))
    store.add(OTHER, a_query(time_s=now))
    store.sweep({MAP})
    assert [store.kept(one).queries for one in (MAP, OTHER)] == [1, 1], "another server may just have made the map"
    (of_no_map,) = (Path(storage_url.removeprefix("file://")) / "queries" / OTHER).iterdir()
    os.utime(of_no_map, (now - 90_000, now - 90_000))
    store.sweep()
    assert store.kept(OTHER).queries == 1
    store.sweep({MAP})
    assert [store.kept(one).queries for one in (MAP, OTHER)] == [1, 0]


def test_an_asker_has_one_pseudonym_at_all_servers(open_storage: Any) -> None:
    storages = [open_storage() for _ in range(2)]
    learners = [Learner(SharedQueryStore(one.objects), Settings(), one.documents(ASKERS)) for one in storages]
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
    store = SharedQueryStore(shared.objects)
    for query in QueryStore(tmp_path / "asked").load(before.info.id):
        store.add(before.info.id, replace(query, asker=ALICE))
    queue = JobQueue(tmp_path / "data")
    queue.submit("", "west", JobOptions(kind=JobKind.LEARN))
    worker = Worker(tmp_path / "data", tmp_path / "elsewhere", storage_url=storage_url)
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
