"""Kept queries: bounded, spread over places and askers, read back as they were, and deleted when they have to be."""

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kept_queries import LATELY_S, keep_queries
from kept_queries import a_query as query
from rholoc.jobs import JobKind, JobOptions, JobQueue
from rholoc.jobs.table import JobTable
from rholoc.library.queries import KeptLimits, QueryStore
from rholoc.library.stores import ASKERS
from rholoc.service.frames.kept.learning import Learner
from rholoc.service.settings import Settings
from rholoc.storage import ObjectStorage
from rholoc.worker import WorkerSetup
from rholoc.worker.worker import Worker
from waiting import until

MAP = "0123456789abcdef"
ALICE, BOB = "a" * 12, "b" * 12


@pytest.fixture(params=["folder", "memory"])
def objects(request: pytest.FixtureRequest, tmp_path: Path) -> ObjectStorage:
    """A server's own folder, and a storage that is none."""
    return ObjectStorage(tmp_path if request.param == "folder" else "memory:///")


@pytest.fixture
def store(objects: ObjectStorage) -> QueryStore:
    return QueryStore(objects)


@pytest.fixture
def other(objects: ObjectStorage) -> QueryStore:
    """The store of another server."""
    return QueryStore(objects)


def test_a_query_is_read_back_as_it_was_kept(store: QueryStore, other: QueryStore) -> None:
    kept = query(time_s=1e9 + 0.125)
    store.add(MAP, kept)
    (read,) = other.load(MAP)
    assert other.kept(MAP).size_bytes > kept.features.descriptors.nbytes
    assert (read.camera, read.confidence, read.time_s, read.asker) == (kept.camera, 0.97, 1e9 + 0.125, ALICE)
    for name in ("T_map_camera", "covariance"):
        np.testing.assert_array_equal(getattr(read, name), getattr(kept, name))
    for name in ("pixels", "channels", "descriptors", "sizes", "angles", "colours"):
        np.testing.assert_array_equal(getattr(read.features, name), getattr(kept.features, name))


def test_who_stays_in_one_place_is_heard_once_a_while(
    store: QueryStore, other: QueryStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = query().T_map_camera
    assert other.wants(MAP, here, ALICE, 1e9)
    other.add(MAP, query())
    assert not store.wants(MAP, here, ALICE, 1e9 + 30)
    with monkeypatch.context() as unreachable:  # an asker that is known to stay there costs the storage nothing
        unreachable.setattr(other, "_objects", None)
        assert not other.wants(MAP, here, ALICE, 1e9 + 50)
    assert store.wants(MAP, here, ALICE, 1e9 + 91)
    assert store.wants("f" * 16, here, ALICE, 1e9 + 30)
    assert store.wants(MAP, here, BOB, 1e9 + 30)
    assert store.wants(MAP, query(x=3).T_map_camera, ALICE, 1e9 + 30)
    assert store.wants(MAP, query(heading_deg=90).T_map_camera, ALICE, 1e9 + 30)


def test_the_newest_of_a_place_stay(objects: ObjectStorage) -> None:
    store = QueryStore(objects, KeptLimits(in_a_place=3))
    for minute in range(6):
        store.add(MAP, query(time_s=1e9 + 60 * minute))
    assert [one.time_s for one in store.load(MAP)] == [1e9 + 180, 1e9 + 240, 1e9 + 300]


@pytest.mark.parametrize("limits", [KeptLimits(queries=10), KeptLimits(size_bytes=26_000)])
def test_nobody_drives_out_what_others_asked(objects: ObjectStorage, limits: KeptLimits) -> None:
    stores = [QueryStore(objects, limits) for _ in range(2)]
    store = stores[0]
    for place in range(4):
        store.add(MAP, query(x=place, asker=BOB))
    for place in range(40):
        stores[place % 2].add(MAP, query(x=place, time_s=1e9 + place))
    kept = store.load(MAP)
    assert len(kept) == store.kept(MAP).queries <= 10
    assert store.kept(MAP).size_bytes <= limits.size_bytes
    assert sum(one.asker == BOB for one in kept) == 4
    assert store.kept(MAP).askers == 2


def test_a_map_or_an_asker_is_forgotten(store: QueryStore) -> None:
    for place in range(3):
        store.add(MAP, query(x=place))
        store.add(MAP, query(x=place, asker=BOB))
    store.add("f" * 16, query())
    assert store.delete(MAP, BOB) == 3
    assert {one.asker for one in store.load(MAP)} == {ALICE}
    assert store.delete(MAP) == 3
    assert store.load(MAP) == []
    assert store.kept(MAP).queries == store.delete(MAP) == 0
    assert store.kept("f" * 16).queries == 1


def test_what_has_expired_goes_and_what_is_of_no_map_a_day_later(
    objects: ObjectStorage, monkeypatch: pytest.MonkeyPatch
) -> None:
    store, now = QueryStore(objects, KeptLimits(expire_s=3600)), time.time()
    store.add(MAP, query(time_s=now - 7200))
    store.add(MAP, query(x=2, time_s=now))
    store.add("f" * 16, query(time_s=now))
    store.sweep({MAP})
    assert [store.kept(one).queries for one in (MAP, "f" * 16)] == [1, 1], "another server may just have made the map"
    monkeypatch.setattr("rholoc.library.queries._ORPHANED_AFTER_S", -10)
    store.sweep()
    assert store.kept("f" * 16).queries == 1
    store.sweep({MAP})
    assert [store.kept(one).queries for one in (MAP, "f" * 16)] == [1, 0]


def test_what_cannot_be_read_is_removed(store: QueryStore, objects: ObjectStorage) -> None:
    for place in range(3):
        store.add(MAP, query(x=place, time_s=1e9 + place))
    keys = sorted(one.key for one in objects.list("queries"))
    objects.put(keys[0], objects.read(keys[0], 0, 100))
    objects.put(keys[1], b"")
    objects.put(f"queries/{MAP}/note.txt", b"not a query")
    assert [one.time_s for one in store.load(MAP)] == [1e9 + 2]
    assert store.kept(MAP).queries == 1


def test_a_map_whose_id_is_no_file_name_has_a_folder_of_its_own(store: QueryStore, tmp_path: Path) -> None:
    store.add("../../elsewhere", query(time_s=time.time()))
    assert store.kept("../../elsewhere").queries == 1
    assert store.kept("../elsewhere").queries == 0
    assert not (tmp_path.parent / "elsewhere").exists()
    store.sweep({"../../elsewhere"})
    assert store.kept("../../elsewhere").queries == 1


def test_queries_of_the_last_day_are_counted(store: QueryStore) -> None:
    for hours in (1, 30):
        store.add(MAP, replace(query(x=hours), time_s=1e9 - 3600 * hours))
    assert store.newer_than(MAP, 1e9 - 86400) == 1


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
    shared.library.put("west", point_room.map_of(point_room.walk(80)[:45:2], "west"))
    before = shared.library.get("west")
    keep_queries(tmp_path / "asked", before, point_room, LATELY_S)
    store = QueryStore(shared.objects)
    for one in QueryStore(ObjectStorage(tmp_path / "asked")).load(before.info.id):
        store.add(before.info.id, replace(one, asker=ALICE))
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
    assert latest.error_code is None, latest.error_message
    shared.refresh()
    after = shared.library.get("west").info
    assert (after.id, after.version) == (before.info.id, before.info.version + 1)
    assert after.report.learned[-1].queries is not None
    assert shared.library.versions("west")[1].version == before.info.version
    assert not list((tmp_path / "data" / "work").glob("*")), "copies of queries are removed with the job's other files"
    assert JobTable(shared.engine).learning("west") is None
