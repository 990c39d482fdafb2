"""The catalogue as a process follows it."""

from __future__ import annotations

import threading
from pathlib import Path

import sqlalchemy as sa

from rholoc.storage.database import open_database
from rholoc.storage.replica import MapRow, Replica
from rholoc.storage.tables import maps_table
from waiting import until


def test_a_change_seen_while_an_earlier_one_is_prepared_is_not_lost(tmp_path: Path) -> None:
    """A slow fetch by the thread that follows must not undo what another thread noted meanwhile."""
    engine, writer = open_database(tmp_path), open_database(tmp_path)
    fetching, go_on = threading.Event(), threading.Event()

    def prepare(_before: MapRow, after: MapRow) -> None:
        if after.version == 2:
            fetching.set()
            go_on.wait(30)

    replica, other = Replica(engine, prepare, lambda before, after: False), Replica(writer)

    def publish(version: int) -> None:
        with other.changing() as (connection, revision):
            row = {"blob": f"{version:032}", "size_bytes": 1, "modified": 0.0, "map_id": f"id {version}"}
            if version == 1:
                connection.execute(sa.insert(maps_table).values(name="room", version=version, revision=revision, **row))
            else:
                connection.execute(sa.update(maps_table).values(version=version, revision=revision, **row))

    publish(1)
    replica.refresh()
    replica.follow()
    try:
        publish(2)
        assert fetching.wait(30)
        publish(3)
        replica.refresh()  # by a request: it does not wait
        go_on.set()
        until(lambda: replica.maps["room"].version == 3, 10)
    finally:
        go_on.set()
        replica.close()
        engine.dispose()
        writer.dispose()
