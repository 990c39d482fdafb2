"""The catalogue as a process follows it."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
import sqlalchemy as sa

from rholoc.storage.database import open_database
from rholoc.storage.replica import MapRow, Replica
from rholoc.storage.tables import maps_table
from waiting import until


@dataclass
class _Following:
    """A replica whose fetch of a room's second version takes until ``go_on``, and another process that publishes."""

    replica: Replica
    other: Replica
    fetching: threading.Event
    go_on: threading.Event

    def publish(self, version: int, name: str = "room") -> None:
        with self.other.changing() as (connection, revision):
            row = {"blob": f"{version:032}", "size_bytes": 1, "modified": 0.0, "map_id": f"id {version}"}
            connection.execute(sa.delete(maps_table).where(maps_table.c.name == name))
            connection.execute(sa.insert(maps_table).values(name=name, version=version, revision=revision, **row))


@pytest.fixture
def following(tmp_path: Path) -> Iterator[_Following]:
    engine, writer = open_database(tmp_path), open_database(tmp_path)
    fetching, go_on = threading.Event(), threading.Event()

    def prepare(_before: MapRow, after: MapRow) -> None:
        if after.version == 2:
            fetching.set()
            go_on.wait(30)

    replica = Replica(engine, prepare, lambda before, after: False)
    made = _Following(replica, Replica(writer), fetching, go_on)
    made.publish(1)
    replica.refresh()
    replica.follow()
    yield made
    go_on.set()
    replica.close()
    engine.dispose()
    writer.dispose()


def test_a_change_seen_while_an_earlier_one_is_prepared_is_not_lost(following: _Following) -> None:
    """A slow fetch by the thread that follows must not undo what another thread noted meanwhile."""
    following.publish(2)
    assert following.fetching.wait(30)
    following.publish(3)
    following.replica.refresh()  # by a request: it does not wait
    following.go_on.set()
    until(lambda: following.replica.maps["room"].version == 3, 10)


def test_a_map_is_not_lost_for_a_change_of_another_one_while_it_is_prepared(following: _Following) -> None:
    following.publish(2)
    assert following.fetching.wait(30)
    following.publish(1, "another")
    following.replica.refresh()
    assert following.replica.maps["another"].version == 1
    following.go_on.set()
    until(lambda: following.replica.maps["room"].version == 2, 10)


def test_a_map_that_changed_while_a_server_was_down_stays_until_its_file_is_here(tmp_path: Path) -> None:
    engine = open_database(tmp_path)
    before = _Following(Replica(engine), Replica(engine), threading.Event(), threading.Event())
    before.publish(1)
    before.replica.recall(tmp_path / "catalogue")
    before.replica.follow()
    until(lambda: (tmp_path / "catalogue").exists(), 10)
    before.replica.close()
    before.publish(2)
    fetched = threading.Event()
    after = Replica(engine, lambda before, after: fetched.wait(30) and None, lambda before, after: False)
    after.recall(tmp_path / "catalogue")
    after.follow()
    until(lambda: after.revision >= 2, 10)
    assert after.maps["room"].version == 1
    fetched.set()
    until(lambda: after.maps["room"].version == 2, 10)
    after.close()
    engine.dispose()
