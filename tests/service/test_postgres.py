"""The database of jobs: Postgres by URL, or one line that says why not."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from rholoc.errors import InvalidInput
from rholoc.jobs import JobQueue
from rholoc.library import RecordingStore
from rholoc.storage.database import database_engine, open_database
from rholoc_client import Client, JobFailed


@pytest.mark.slow
def test_jobs_are_kept_in_postgres_and_worked_on(postgres_url, serve, tmp_path):
    running = serve(worker=True, database_url=postgres_url)
    (tmp_path / "walk.mp4").write_bytes(b"\0\0\0\x18ftypmp42" + b"no frames" * 100)
    with Client(running.url) as client:
        job = client.upload_recording(tmp_path / "walk.mp4", "hall")
        with pytest.raises(JobFailed) as caught:
            client.wait_for_job(job.id, timeout_s=120, poll_s=0.1)
        assert caught.value.code == "invalid_recording"
    assert not (running.settings.data_dir / "jobs.sqlite").exists()
    queue = JobQueue(RecordingStore(tmp_path, engine=database_engine(tmp_path, postgres_url)))
    assert [one.id for one in queue.list()] == [job.id]
    assert queue.has_worker()
    queue.close()


def test_a_database_that_is_not_there_is_reported_in_one_line(tmp_path):
    with pytest.raises(InvalidInput) as caught:
        open_database(tmp_path, f"postgresql://jobs:secret@/jobs?host={tmp_path}")
    assert "cannot be reached" in caught.value.message
    assert "\n" not in caught.value.message
    assert "secret" not in str(caught.value)


@pytest.mark.parametrize("url", ["jobs:secret", "mysql://jobs:secret@localhost/jobs", "://"])
def test_what_is_no_address_of_a_database_is_refused(tmp_path, url):
    with pytest.raises(InvalidInput, match="not the URL of a Postgres database") as caught:
        database_engine(tmp_path, url)
    assert "secret" not in str(caught.value)


@pytest.mark.slow
@pytest.mark.parametrize("command", [["serve", "--port", "0", "--no-worker"], ["worker"]])
def test_the_commands_refuse_a_database_in_one_line(tmp_path, command):
    environment = {**os.environ, "RHOLOC_DATABASE_URL": "postgresql://jobs:secret@127.0.0.1:1/jobs"}
    arguments = [sys.executable, "-m", "rholoc", *command, "--data", str(tmp_path), "--maps", str(tmp_path)]
    ended = subprocess.run(arguments, env=environment, capture_output=True, text=True, timeout=200, check=False)
    assert ended.returncode == 1
    (line,) = [line for line in ended.stderr.splitlines() if not line.startswith("Working on")]
    assert "127.0.0.1, database jobs cannot be reached" in line
    assert "secret" not in line
