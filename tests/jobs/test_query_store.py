"""Kept queries: bounded, spread over places and askers, read back as they were, and deleted when they have to be."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kept_queries import a_query as query
from rholoc.jobs import KeptLimits, QueryStore

MAP = "0123456789abcdef"
ALICE, BOB = "a" * 12, "b" * 12


def test_a_query_is_read_back_as_it_was_kept(tmp_path: Path) -> None:
    store, kept = QueryStore(tmp_path), query(time_s=1e9 + 0.125)
    store.add(MAP, kept)
    (read,) = QueryStore(tmp_path).load(MAP)
    assert (read.camera, read.confidence, read.time_s, read.asker) == (kept.camera, 0.97, 1e9 + 0.125, ALICE)
    for name in ("T_map_camera", "covariance"):
        np.testing.assert_array_equal(getattr(read, name), getattr(kept, name))
    for name in ("pixels", "channels", "descriptors", "sizes", "angles", "colours"):
        np.testing.assert_array_equal(getattr(read.features, name), getattr(kept.features, name))


def test_who_stays_in_one_place_is_heard_once_a_while(tmp_path: Path) -> None:
    store, here = QueryStore(tmp_path), query().T_map_camera
    store.add(MAP, query())
    assert not store.wants(MAP, here, ALICE, 1e9 + 30)
    assert store.wants(MAP, here, ALICE, 1e9 + 61)
    assert store.wants(MAP, here, BOB, 1e9 + 30)
    assert store.wants(MAP, query(x=3).T_map_camera, ALICE, 1e9 + 30)
    assert store.wants(MAP, query(heading_deg=90).T_map_camera, ALICE, 1e9 + 30)


def test_the_newest_of_a_place_stay(tmp_path: Path) -> None:
    store = QueryStore(tmp_path, KeptLimits(in_a_place=3))
    for minute in range(6):
        store.add(MAP, query(time_s=1e9 + 60 * minute))
    assert [one.time_s for one in store.load(MAP)] == [1e9 + 180, 1e9 + 240, 1e9 + 300]


@pytest.mark.parametrize("limits", [KeptLimits(queries=10), KeptLimits(size_bytes=26_000)])
def test_nobody_drives_out_what_others_asked(tmp_path: Path, limits: KeptLimits) -> None:
    store = QueryStore(tmp_path, limits)
    for place in range(4):
        store.add(MAP, query(x=place, asker=BOB))
    for place in range(40):
        store.add(MAP, query(x=place, time_s=1e9 + place))
    kept = store.load(MAP)
    assert len(kept) == store.kept(MAP).queries <= 10
    assert store.kept(MAP).size_bytes <= limits.size_bytes
    assert sum(one.asker == BOB for one in kept) == 4
    assert store.kept(MAP).askers == 2


def test_a_map_or_an_asker_is_forgotten(tmp_path: Path) -> None:
    store = QueryStore(tmp_path)
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


def test_what_has_expired_and_what_is_of_no_map_goes(tmp_path: Path) -> None:
    store = QueryStore(tmp_path, KeptLimits(expire_s=3600))
    now = time.time()
    store.add(MAP, query(time_s=now - 7200))
    store.add(MAP, query(x=2, time_s=now))
    store.add("f" * 16, query(time_s=now))
    store.sweep()
    assert [store.kept(one).queries for one in (MAP, "f" * 16)] == [1, 1]
    store.sweep({MAP})
    assert [store.kept(one).queries for one in (MAP, "f" * 16)] == [1, 0]


def test_what_cannot_be_read_is_removed(tmp_path: Path) -> None:
    store = QueryStore(tmp_path)
    for place in range(3):
        store.add(MAP, query(x=place, time_s=1e9 + place))
    files = sorted((tmp_path / "queries" / MAP).iterdir())
    files[0].write_bytes(files[0].read_bytes()[:100])
    files[1].write_bytes(b"")
    (tmp_path / "queries" / MAP / "note.txt").write_text("not a query")
    assert [one.time_s for one in store.load(MAP)] == [1e9 + 2]
    assert store.kept(MAP).queries == 1


def test_a_map_whose_id_is_no_file_name_has_a_folder_of_its_own(tmp_path: Path) -> None:
    store = QueryStore(tmp_path)
    store.add("../../elsewhere", query(time_s=time.time()))
    assert store.kept("../../elsewhere").queries == 1
    assert store.kept("../elsewhere").queries == 0
    assert not (tmp_path.parent / "elsewhere").exists()
    store.sweep({"../../elsewhere"})
    assert store.kept("../../elsewhere").queries == 1


def test_queries_of_the_last_day_are_counted(tmp_path: Path) -> None:
    store = QueryStore(tmp_path)
    for hours in (1, 30):
        store.add(MAP, replace(query(x=hours), time_s=1e9 - 3600 * hours))
    assert store.newer_than(MAP, 1e9 - 86400) == 1
