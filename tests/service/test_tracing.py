"""Traces: a request with its stages and what the storage did; a job, linked to what asked for it."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import httpx
import pytest
from opentelemetry.sdk.trace import ReadableSpan, TracerProvider
from opentelemetry.sdk.trace.export import SimpleSpanProcessor
from opentelemetry.sdk.trace.export.in_memory_span_exporter import InMemorySpanExporter
from opentelemetry.trace import SpanKind, StatusCode

from rholoc import telemetry
from rholoc.errors import NotFound
from rholoc.service.settings import KeyPolicy
from waiting import until

TRACE, PARENT = "0af7651916cd43dd8448eb211c80319c", "b7ad6b7169203331"
TRACEPARENT = f"00-{TRACE}-{PARENT}-01"
PNG = {"Content-Type": "image/png"}


class Spans:
    """What was traced."""

    def __init__(self) -> None:
        self.exporter = InMemorySpanExporter()

    def named(self, name: str) -> ReadableSpan:
        """The last span of a name, which ends after its answer was sent."""

        def found() -> list[ReadableSpan]:
            return [one for one in self.exporter.get_finished_spans() if one.name == name]

        until(lambda: bool(found()))
        return found()[-1]

    def within(self, parent: ReadableSpan) -> list[ReadableSpan]:
        """The spans of its parts."""
        of_parent = [one for one in self.exporter.get_finished_spans() if one.parent is not None]
        return [one for one in of_parent if one.parent.span_id == parent.context.span_id]


@pytest.fixture
def spans() -> Iterator[Spans]:
    """Traces everything that this process does."""
    spans, provider = Spans(), TracerProvider()
    provider.add_span_processor(SimpleSpanProcessor(spans.exporter))
    telemetry.use(provider)
    yield spans
    telemetry.end()


@pytest.fixture
def traced(spans: Spans, serve: Any, tmp_path: Path, picture_world: Any) -> str:
    """The address of a service on a storage, with a map."""
    url = str(serve(storage_url=f"file://{tmp_path}/storage").url)
    assert httpx.put(f"{url}/v1/maps/room", content=picture_world.rho()).status_code == 201
    return url


def test_a_request_is_traced_with_its_stages_in_the_callers_trace(
    traced: str, spans: Spans, picture_world: Any
) -> None:
    asked = httpx.post(
        f"{traced}/v1/maps/room/localize?dof=6",
        content=picture_world.png(),
        headers={**PNG, "traceparent": TRACEPARENT},
    )
    assert asked.status_code == 200
    span = spans.named("POST /v1/maps/{map_name}/localize")
    assert f"{span.context.trace_id:032x}" == TRACE
    assert f"{span.parent.span_id:016x}" == PARENT
    assert span.kind is SpanKind.SERVER
    assert span.attributes["http.response.status_code"] == 200
    assert span.attributes["rholoc.request_id"] == asked.headers["X-Request-ID"]
    parts = spans.within(span)
    spent = {stage for stage, took_ms in asked.json()["timings_ms"].items() if took_ms > 0} - {"total"}
    assert {"queue", "load", "decode", "extract", "match"} <= {one.name for one in parts}
    assert {one.name for one in parts if one.kind is SpanKind.INTERNAL} == spent
    for one in parts:
        assert span.start_time <= one.start_time <= one.end_time <= span.end_time


def test_what_the_storage_and_the_database_do_is_a_part(traced: str, spans: Spans) -> None:
    span = spans.named("PUT /v1/maps/{map_name}")
    assert span.parent is None
    of_others = {one.name: one for one in spans.within(span) if one.kind is SpanKind.CLIENT}
    assert {"storage put", "database INSERT", "database UPDATE"} <= set(of_others)
    assert of_others["storage put"].attributes["rholoc.storage.key"].startswith("maps/")
    assert of_others["database INSERT"].attributes["db.system.name"] == "sqlite"
    assert "?" in of_others["database UPDATE"].attributes["db.query.text"], "without values"


def test_failures_say_so_and_probes_are_not_traced(traced: str, spans: Spans) -> None:
    assert httpx.get(f"{traced}/v1/maps/none", headers={"traceparent": "nonsense"}).status_code == 404
    missing = spans.named("GET /v1/maps/{map_name}")
    assert missing.parent is None
    assert missing.status.status_code is StatusCode.UNSET
    before = len(spans.exporter.get_finished_spans())
    for path in ("/healthz", "/readyz", "/metrics", "/"):
        assert httpx.get(traced + path).status_code == 200
    assert len(spans.exporter.get_finished_spans()) == before


def test_a_part_of_nothing_is_not_traced(spans: Spans) -> None:
    with telemetry.span("storage list"):
        telemetry.note("database SELECT", 0.1)
        assert telemetry.traceparent() is None
    assert spans.exporter.get_finished_spans() == ()


def test_work_that_was_asked_for_is_linked_to_the_request(spans: Spans) -> None:
    with telemetry.request_span("POST", {"traceparent": TRACEPARENT}):
        asked_in = telemetry.traceparent()
    with suppress(NotFound), telemetry.job_span("job build", {"rholoc.map": "hall"}, asked_in):
        telemetry.note("poses", 0.01)
        raise NotFound("It is gone.")
    job = spans.named("job build")
    assert job.parent is None
    assert [f"{link.context.trace_id:032x}" for link in job.links] == [TRACE]
    assert job.links[0].context.span_id == spans.named("POST").context.span_id
    assert job.status.status_code is StatusCode.ERROR
    assert [one.name for one in spans.within(job)] == ["poses"]
    with telemetry.job_span("job learn", {}, None):
        pass
    assert list(spans.named("job learn").links) == []


@pytest.mark.parametrize(
    ("environment", "on"),
    [
        ({}, False),
        ({"OTEL_SERVICE_NAME": "x"}, False),
        ({"OTEL_EXPORTER_OTLP_ENDPOINT": "http://collector:4318"}, True),
        ({"OTEL_EXPORTER_OTLP_TRACES_ENDPOINT": "http://collector:4318/v1/traces"}, True),
        ({"OTEL_EXPORTER_OTLP_ENDPOINT": "http://collector:4318", "OTEL_SDK_DISABLED": "true"}, False),
        ({"OTEL_EXPORTER_OTLP_ENDPOINT": "http://collector:4318", "OTEL_TRACES_EXPORTER": "none"}, False),
    ],
)
def test_the_environment_says_whether(environment: dict[str, str], on: bool) -> None:
    assert telemetry.wanted(environment) is on


def test_a_service_imports_neither_it_nor_the_solvers_of_its_workers(tmp_path: Path) -> None:
    code = """
import sys
from rholoc.service import Settings, create_app
create_app(Settings())
from rholoc import telemetry
telemetry.begin("rholoc-server")
with telemetry.request_span("GET", {}) as marks, telemetry.span("x"):
    marks.rename("y")
    telemetry.note("z", 1.0)
telemetry.end()
for needless in ("opentelemetry.sdk", "gtsam", "pycolmap", "matplotlib"):
    assert needless not in sys.modules, needless
"""
    subprocess.run([sys.executable, "-c", code], check=True, cwd=tmp_path)


def test_the_key_that_asked_is_named(spans: Spans, serve: Any) -> None:
    from rholoc.service.access.keys import KeyStore, Scope

    running = serve(keys=KeyPolicy.ALWAYS)
    secret = KeyStore(running.settings.data_dir).create("robot", Scope.READ)
    assert httpx.get(f"{running.url}/v1/maps", headers={"Authorization": f"Bearer {secret}"}).status_code == 200
    assert spans.named("GET /v1/maps").attributes["rholoc.key"] == "robot"
