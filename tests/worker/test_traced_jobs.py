"""A worker's traces, as a collector gets them."""

from __future__ import annotations

import threading
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
from rholoc.jobs import JobState
from waiting import until


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
    assert asked_in is not None
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
