"""The tables: made and brought up to date by migrations, once."""

from __future__ import annotations

import sqlite3
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import sqlalchemy as sa
from alembic.autogenerate import compare_metadata
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory

from rholoc.errors import Conflict, InvalidInput, StorageUnavailable
from rholoc.storage import database
from rholoc.storage.database import check_database, database_engine, is_silence, open_database
from rholoc.storage.tables import VERSION_TABLE, jobs_table, metadata

if TYPE_CHECKING:
    from postgres_server import PostgresServer


def differences(engine: sa.Engine) -> list[object]:
    """What migrations made that the tables in the code are not, and the other way round."""

    def is_ours(name: str | None, kind: str, _: object) -> bool:
        return kind != "table" or (name or "").startswith("rholoc_")

    options = {"include_name": is_ours, "version_table": VERSION_TABLE}
    with engine.connect() as connection:
        return compare_metadata(MigrationContext.configure(connection, opts=options), metadata)


def test_migrations_make_the_tables_that_the_code_uses(tmp_path: Path) -> None:
    engine = open_database(tmp_path)
    assert differences(engine) == []
    engine.dispose()


def test_the_last_migration_is_the_one_that_a_start_looks_for() -> None:
    scripts = ScriptDirectory(str(database._MIGRATIONS))
    assert scripts.get_heads() == [database.HEAD]
    numbers = [script.revision for script in scripts.walk_revisions()]
    assert numbers == sorted(numbers, reverse=True)


def test_a_database_of_a_later_version_is_refused(tmp_path: Path) -> None:
    engine = open_database(tmp_path)
    with engine.begin() as connection:
        connection.exec_driver_sql(f"UPDATE {VERSION_TABLE} SET version_num = '9999'")
    engine.dispose()
    with pytest.raises(Conflict, match="later version"):
        open_database(tmp_path)


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


def test_several_that_start_at_once_migrate_once(tmp_path: Path) -> None:
    engines = open_at_once(None, tmp_path, 8)
    assert differences(engines[0]) == []
    for engine in engines:
        engine.dispose()


@pytest.mark.slow
def test_several_that_start_at_once_migrate_once_in_postgres(tmp_path: Path, postgres_url: str) -> None:
    engines = open_at_once(postgres_url, tmp_path, 4)
    assert differences(engines[0]) == []
    for engine in engines:
        engine.dispose()
