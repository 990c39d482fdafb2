"""The tables: created or updated, once; the catalogue as a process follows it."""

from __future__ import annotations

import sqlite3
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import sqlalchemy as sa

from rholoc.errors import Conflict, InvalidInput, StorageUnavailable
from rholoc.storage import tables
from rholoc.storage.database import check_database, database_engine, is_silence, open_database
from rholoc.storage.tables import jobs_table, metadata

if TYPE_CHECKING:
    from postgres_server import PostgresServer
from dataclasses import dataclass

from rholoc.storage.replica import MapRow, Replica
from rholoc.storage.tables import maps_table
from waiting import until


def tables_of(engine: sa.Engine) -> dict[str, set[str]]:
    """Table → names of its columns."""
    found = sa.inspect(engine)
    return {name: {column["name"] for column in found.get_columns(name)} for name in found.get_table_names()}


WANTED = {table.name: {column.name for column in table.columns} for table in metadata.tables.values()}


def test_a_database_of_an_earlier_version_is_updated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    open_database(tmp_path).dispose()

    def add_a_column(connection: sa.Connection) -> None:
        connection.exec_driver_sql("ALTER TABLE rholoc_jobs ADD COLUMN colour TEXT")

    monkeypatch.setattr(tables, "UPDATES", (add_a_column,))
    for _ in range(2):
        engine = open_database(tmp_path)
        assert tables_of(engine)["rholoc_jobs"] - WANTED["rholoc_jobs"] == {"colour"}
        engine.dispose()
    monkeypatch.setattr(tables, "UPDATES", ())
    with pytest.raises(Conflict, match="later version"):
        open_database(tmp_path)


def test_an_update_that_fails_changes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    open_database(tmp_path).dispose()

    def fail(connection: sa.Connection) -> None:
        connection.exec_driver_sql("DROP TABLE rholoc_jobs")
        raise ValueError("in the middle")

    monkeypatch.setattr(tables, "UPDATES", (fail,))
    with pytest.raises(ValueError, match="in the middle"):
        open_database(tmp_path)
    monkeypatch.setattr(tables, "UPDATES", ())
    engine = open_database(tmp_path)
    assert tables_of(engine) == WANTED
    engine.dispose()


def test_the_first_use_of_an_engine_creates_the_tables(tmp_path: Path) -> None:
    engine = database_engine(tmp_path / "data")
    assert not (tmp_path / "data").exists(), "it was not asked anything yet"
    with engine.connect() as connection:
        assert connection.execute(sa.select(sa.func.count()).select_from(jobs_table)).scalar() == 0
    engine.dispose()


def test_an_old_sqlite_is_refused_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sqlite3, "sqlite_version_info", (3, 37, 2))
    with pytest.raises(InvalidInput, match=r"rholoc needs 3\.38"):
        database_engine(tmp_path)


@pytest.fixture
def silent(postgres: PostgresServer, postgres_url: str) -> Iterator[str]:
    """The URL of a database whose server is stopped, as on a machine that hangs."""
    open_database(Path(), postgres_url).dispose()
    with postgres.silent():
        yield postgres_url


@pytest.mark.slow
def test_a_silent_database_is_reported_within_seconds(silent: str) -> None:
    begun_s = time.monotonic()
    with pytest.raises(StorageUnavailable, match="does not answer"):
        open_database(Path(), silent)
    assert time.monotonic() - begun_s < 15.0
    begun_s = time.monotonic()
    many = [threading.Thread(target=raises_unavailable, args=(database_engine(Path(), silent),)) for _ in range(3)]
    engine = database_engine(Path(), silent)
    many += [threading.Thread(target=raises_unavailable, args=(engine,)) for _ in range(20)]
    for thread in many:
        thread.start()
    for thread in many:
        thread.join()
    assert time.monotonic() - begun_s < 40.0, "those who wait for a connection give up too"


def raises_unavailable(engine: sa.Engine) -> None:
    with pytest.raises(StorageUnavailable):
        check_database(engine)


@pytest.mark.slow
def test_a_database_that_falls_silent_is_noticed_in_the_middle_of_a_query(
    postgres: PostgresServer, postgres_url: str
) -> None:
    engine = open_database(Path(), postgres_url)
    with engine.connect() as connection, postgres.silent():
        begun_s = time.monotonic()
        with pytest.raises(sa.exc.OperationalError) as raised:
            connection.execute(sa.text("SELECT 1"))
        assert is_silence(raised.value)
        assert time.monotonic() - begun_s < 15.0
    with engine.connect() as connection:
        assert connection.execute(sa.text("SELECT 1")).scalar() == 1, "it is back"
    engine.dispose()


@pytest.mark.slow
def test_a_statement_that_takes_too_long_is_cancelled(postgres_url: str) -> None:
    engine = open_database(Path(), postgres_url)
    with engine.connect() as connection, pytest.raises(sa.exc.OperationalError, match="statement timeout"):
        connection.execute(sa.text("SELECT pg_sleep(60)"))
    engine.dispose()


def open_at_once(url: str | None, folder: Path, times: int) -> list[sa.Engine]:
    engines: list[sa.Engine] = []
    failures: list[Exception] = []

    def open_one() -> None:
        try:
            engines.append(open_database(folder, url))
        except Exception as error:
            failures.append(error)

    threads = [threading.Thread(target=open_one) for _ in range(times)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert failures == []
    return engines


def test_several_that_start_at_once_create_the_tables_once(tmp_path: Path) -> None:
    engines = open_at_once(None, tmp_path, 8)
    assert tables_of(engines[0]) == WANTED
    for engine in engines:
        engine.dispose()


@pytest.mark.slow
def test_several_that_start_at_once_create_the_tables_once_in_postgres(tmp_path: Path, postgres_url: str) -> None:
    engines = open_at_once(postgres_url, tmp_path, 4)
    assert tables_of(engines[0]) == WANTED
    for engine in engines:
        engine.dispose()


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
