"""The worker beside a server: it starts, and it ends with its server."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from rholoc.jobs import EmbeddedWorker, JobQueue, JobState, RecordingStore
from waiting import alive, until

_SERVER = """
import sys, time
from pathlib import Path
from rholoc.jobs import EmbeddedWorker
worker = EmbeddedWorker(Path(sys.argv[1]), Path(sys.argv[2]))
worker.start()
sys.stdout.write(f"{worker.pid}\\n")
sys.stdout.flush()
time.sleep(60)
"""


@pytest.mark.slow
def test_it_works_restarts_and_stops(tmp_path: Path) -> None:
    queue, recordings = JobQueue(tmp_path), RecordingStore(tmp_path)
    worker = EmbeddedWorker(tmp_path, tmp_path / "maps")
    worker.start()
    try:
        job = queue.submit(recordings.create([("notes.txt", [b"not a recording"])]).id, "room")
        until(lambda: queue.get(job.id).state.ended)
        failed = queue.get(job.id)
        assert (failed.state, failed.error_code) == (JobState.FAILED, "invalid_recording")
        first = worker.pid
        os.kill(first, signal.SIGKILL)
        until(lambda: worker.running and worker.pid != first)
    finally:
        worker.stop()
        queue.close()
    assert not worker.running


@pytest.mark.slow
def test_it_ends_with_a_killed_server(tmp_path: Path) -> None:
    server = subprocess.Popen(
        [sys.executable, "-c", _SERVER, str(tmp_path), str(tmp_path / "maps")], stdout=subprocess.PIPE
    )
    worker_pid = int(server.stdout.readline())
    assert alive(worker_pid)
    server.kill()
    server.wait()
    server.stdout.close()
    until(lambda: not alive(worker_pid))
