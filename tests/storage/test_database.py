"""The tables: made and brought up to date by migrations, once."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest
import sqlalchemy as sa
from alembic.autogenerate import compare_metadata
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory

from rholoc.storage import database
from rholoc.storage.database import database_engine, open_database
from rholoc.storage.tables import VERSION_TABLE, jobs_table, metadata


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


def test_a_database_of_before_there_were_migrations_keeps_its_jobs(tmp_path: Path) -> None:
    engine = database_engine(tmp_path)
    with engine.begin() as connection:
        connection.exec_driver_sql(
            "CREATE TABLE rholoc_workers (id VARCHAR(100) NOT NULL PRIMARY KEY, heartbeat FLOAT NOT NULL)"
        )
        later = {"warnings", "worker", "release", "turn", "memory_bytes", "asked_in"}
        columns = [str(sa.schema.CreateColumn(c).compile(engine)) for c in jobs_table.columns if c.name not in later]
        connection.exec_driver_sql(f"CREATE TABLE rholoc_jobs ({', '.join(columns)}, PRIMARY KEY (id))")
        connection.exec_driver_sql(
            "INSERT INTO rholoc_jobs (id, recording, map_name, options, state, stage, progress, message, log, created,"
            " attempts, workflow_id) VALUES ('1', '2', 'room', '{}', 'queued', 'received', 0, '', '[]', 0, 0, 'w')"
        )
    engine.dispose()
    engine = open_database(tmp_path)
    with engine.connect() as connection:
        row = connection.execute(sa.select(jobs_table)).mappings().one()
    assert (row["map_name"], row["warnings"]) == ("room", None)
    assert differences(engine) == []
    engine.dispose()


def test_a_later_releases_tables_are_left_alone(tmp_path: Path) -> None:
    engine = open_database(tmp_path)
    with engine.begin() as connection:
        connection.exec_driver_sql(f"UPDATE {VERSION_TABLE} SET version_num = '9999'")
    engine.dispose()
    engine = open_database(tmp_path)
    with engine.connect() as connection:
        assert connection.exec_driver_sql(f"SELECT version_num FROM {VERSION_TABLE}").scalar() == "9999"
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
