"""The worker beside a server: it starts, and it ends with its server; A worker's traces, as a collector gets them."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Any

import pytest
from opentelemetry.proto.collector.trace.v1.trace_service_pb2 import ExportTraceServiceRequest
from opentelemetry.sdk.trace import TracerProvider

from fake_pipeline import BUILD_STAGES
from job_site import Site
from rholoc import telemetry
from rholoc.jobs import JobQueue, JobState, Obstacle
from rholoc.jobs.leases import Leases
from rholoc.jobs.workers_table import WorkerTable, process_name
from rholoc.library.recordings import RecordingStore
from rholoc.worker import EmbeddedWorker, WorkerSetup
from rholoc.worker.embedded import reason_of_death
from waiting import BREAKS_WORKERS, alive, until

_SERVER = """
import sys, time
from pathlib import Path
from rholoc.worker import EmbeddedWorker, WorkerSetup
worker = EmbeddedWorker(WorkerSetup(Path(sys.argv[1]), Path(sys.argv[2])))
worker.start()
sys.stdout.write(f"{worker.pid}\\n")
sys.stdout.flush()
time.sleep(60)
"""


@pytest.mark.slow
def test_it_works_restarts_and_stops(tmp_path: Path) -> None:
    recordings = RecordingStore(tmp_path)
    queue, worker = JobQueue(recordings), EmbeddedWorker(WorkerSetup(tmp_path, tmp_path / "maps"))
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
def test_one_that_dies_whenever_it_is_started_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "sitecustomize.py").write_text(BREAKS_WORKERS)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    recordings = RecordingStore(tmp_path / "data")
    queue = JobQueue(recordings)
    job = queue.submit(recordings.create([("walk.mp4", [b"a walk"])]).id, "room")
    worker = EmbeddedWorker(WorkerSetup(tmp_path / "data", tmp_path / "maps"), queue)
    worker.start()
    try:
        until(lambda: queue.get(job.id).obstacle is Obstacle.WORKER_FAILS, timeout_s=30.0)
        assert "signal 6: its library is broken" in queue.get(job.id).message
        assert worker.trouble is not None
        other = JobQueue(RecordingStore(tmp_path / "data"))
        until(lambda: other.worker_trouble() == worker.trouble)  # other servers say it too
        other.close()
        until(lambda: "4 times" in str(worker.trouble))
        begun_s = time.monotonic()
        until(lambda: "5 times" in str(worker.trouble))
        assert time.monotonic() - begun_s > 6.0, "it is started less and less often"
    finally:
        worker.stop()
        queue.close()


@pytest.mark.slow
def test_the_jobs_of_one_that_is_killed_are_queued_at_once(tmp_path: Path) -> None:
    recordings = RecordingStore(tmp_path)
    queue = JobQueue(recordings)
    leases, workers = Leases(queue.engine), WorkerTable(queue.engine)
    entry = recordings.create([("walk.mp4", [b"a walk"])])
    job = queue.submit(entry.id, "room")
    name = process_name(12345)
    workers.beat(f"{name}-1")
    workers.beat(f"{name}6-1")
    assert leases.take(f"{name}-1") is not None
    queue.requeue_jobs_of(12345, "signal 9")
    assert [worker.id for worker in workers.living()] == [f"{name}6-1"], "of another process"
    assert (queue.get(job.id).state, queue.get(job.id).log[-1].endswith("its worker died (signal 9)")) == (
        JobState.QUEUED,
        True,
    )
    queue.close()


@pytest.mark.parametrize(
    ("status", "errors", "reason"),
    [
        (-9, [], "signal 9"),
        (1, ["Traceback (most recent call last):", "ValueError: no", ""], "exit status 1: ValueError: no"),
        (1, ['{"level": "info", "event": "started"}'], "exit status 1"),
        (
            1,
            ['{"level": "error", "event": "it failed", "exception": "Traceback\\nKeyError: 1"}'],
            "exit status 1: KeyError: 1",
        ),
        (1, ["why", '{"level": "info", "event": "stopped"}'], "exit status 1: why"),
    ],
)
def test_why_a_worker_died_is_one_line(status: int, errors: list[str], reason: str) -> None:
    assert reason_of_death(status, errors) == reason


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


class Collector(BaseHTTPRequestHandler):
    """Takes what is exported to it."""

    received: list[ExportTraceServiceRequest]

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["Content-Length"]))
        if self.path == "/v1/traces":
            self.received.append(ExportTraceServiceRequest.FromString(body))
        self.send_response(200)
        self.end_headers()

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def collected(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[Any]]:
    """What a collector on this machine gets."""
    Collector.received = []
    server = HTTPServer(("127.0.0.1", 0), Collector)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    monkeypatch.setenv("OTEL_EXPORTER_OTLP_ENDPOINT", f"http://127.0.0.1:{server.server_port}")
    monkeypatch.setenv("OTEL_EXPORTER_OTLP_COMPRESSION", "none")
    monkeypatch.setenv("OTEL_BSP_SCHEDULE_DELAY", "200")
    yield Collector.received
    server.shutdown()
    server.server_close()


@pytest.mark.slow
def test_a_job_is_traced_with_its_stages_and_linked_to_the_request(tmp_path: Path, collected: list[Any]) -> None:
    site = Site(tmp_path)
    telemetry.use(TracerProvider())
    try:
        with telemetry.request_span("POST /v1/recordings", {}):
            asked_in = telemetry.traceparent()
            job = site.submit()
        site.start_worker()
        assert site.wait_for(job, JobState.PUBLISHED, JobState.FAILED).state is JobState.PUBLISHED
        spans = wait_for_spans(collected, "job build")
    finally:
        telemetry.end()
        site.close()
    (traced,) = [one for one in spans if one.name == "job build"]
    assert [(link.trace_id.hex(), link.span_id.hex()) for link in traced.links] == [tuple(asked_in.split("-")[1:3])]
    assert {one.key: one.value.string_value for one in traced.attributes}["rholoc.map"] == "room"
    within = [one for one in spans if one.parent_span_id == traced.span_id]
    names = [one.name for one in sorted(within, key=lambda one: one.start_time_unix_nano)]
    assert [name for name in names if name in {str(stage) for stage in BUILD_STAGES}] == [
        str(one) for one in BUILD_STAGES
    ]
    assert {"inputs", "publish"} <= set(names)
    assert all(one.trace_id == traced.trace_id for one in within)
    (resource,) = {str(one.resource) for part in collected for one in part.resource_spans}
    assert "rholoc-worker" in resource


def wait_for_spans(collected: list[Any], name: str) -> list[Any]:
    """All spans, once one of a name is among them."""

    def spans() -> list[Any]:
        scopes = [scope for part in collected for one in part.resource_spans for scope in one.scope_spans]
        return [span for scope in scopes for span in scope.spans]

    until(lambda: any(span.name == name for span in spans()))
    return spans()
