"""Metrics by map, and the dashboard that shows them; liveness, readiness, logs."""

import json
import logging
import re
from pathlib import Path
from typing import Any

import httpx
import pytest

from rholoc import __version__
from rholoc.jobs.workers_table import WorkerTable
from rholoc.logs import configure_logs
from rholoc.service.http.metrics import Metrics
from rholoc.storage.database import open_database

DASHBOARD = Path(__file__).parents[2] / "docs" / "grafana.json"
_SERIES = re.compile(r"_(bucket|sum|count|created|total)$")
_METRIC = re.compile(r"\brholoc_\w+")
_LABEL = re.compile(r"(\w+)\s*(?:=~|!~|!=|=)\s*\"")
_GROUPED = re.compile(r"by \(([^)]*)\)")


def counted() -> Metrics:
    metrics = Metrics()
    metrics.request("GET", "/healthz", 200, 0.01)
    metrics.localization("hall", None, {"total": 20.0, "match": 4.0})
    return metrics


def queries() -> list[str]:
    dashboard: dict[str, Any] = json.loads(DASHBOARD.read_text())
    asked = [target["expr"] for panel in dashboard["panels"] for target in panel["targets"]]
    return asked + [one["query"] for one in dashboard["templating"]["list"] if one["type"] == "query"]


@pytest.fixture(scope="module")
def exposed(serve, picture_world) -> dict[str, set[str]]:
    """The labels of each series that a service with a map exposes, by the series' name."""
    running = serve()
    (running.settings.maps_dir / "room.rho").write_bytes(picture_world.rho())
    picture = {"content": picture_world.png(), "headers": {"content-type": "image/png"}, "timeout": 60}
    assert httpx.post(f"{running.url}/v1/maps/room/localize?dof=6", **picture).status_code == 200
    found: dict[str, set[str]] = {}
    for line in httpx.get(f"{running.url}/metrics").text.splitlines():
        if not line.startswith("#"):
            name, _, labels = line.partition("{")
            found.setdefault(name.split()[0], set()).update(_LABEL.findall(labels))
    return found


def test_the_dashboard_asks_for_metrics_that_there_are(exposed) -> None:
    assert len(queries()) > 10
    for query in queries():
        names = _METRIC.findall(query)
        assert names, query
        for name in names:
            assert name in exposed, query
        labels = {label.strip() for group in _GROUPED.findall(query) for label in group.split(",")}
        labels |= set(_LABEL.findall(query))
        assert labels <= set().union(*(exposed[name] for name in names)), query


def test_all_metrics_are_on_the_dashboard(exposed) -> None:
    shown = {name for query in queries() for name in _METRIC.findall(query)}
    assert {_SERIES.sub("", name) for name in exposed} == {_SERIES.sub("", name) for name in shown}


def test_frames_are_counted_by_map_and_outcome() -> None:
    metrics = counted()
    metrics.localization("hall", "no_matches", {})
    text = metrics.text().decode()
    assert 'rholoc_map_localizations_total{map="hall",outcome="localized"} 1.0' in text
    assert 'rholoc_map_localizations_total{map="hall",outcome="no_matches"} 1.0' in text
    assert 'rholoc_stage_seconds_count{stage="match"} 1.0' in text


def test_ten_thousand_maps_do_not_become_ten_thousand_counters() -> None:
    metrics = Metrics()
    for number in range(10_000):
        metrics.localization(f"map{number}", None, {})
    metrics.localization("map0", None, {})
    text = metrics.text().decode()
    lines = [line for line in text.splitlines() if line.startswith("rholoc_map_localizations_total{")]
    assert len(lines) == 201
    assert 'rholoc_map_localizations_total{map="other maps",outcome="localized"} 9800.0' in text
    assert 'rholoc_map_localizations_total{map="map0",outcome="localized"} 2.0' in text


_NO_WORKER = "no worker is running; jobs wait for one"


def test_alive(service):
    assert httpx.get(service.url + "/healthz").json() == {"status": "ok", "version": __version__}


def test_ready_says_what_is_not(serve):
    running = serve()
    answer = httpx.get(running.url + "/readyz")
    assert answer.status_code == 200
    assert answer.json() == {
        "ready": True,
        "checks": {**dict.fromkeys(("maps", "data", "jobs", "compute"), "ok"), "worker": _NO_WORKER},
    }
    running.settings.maps_dir.rmdir()
    answer = httpx.get(running.url + "/readyz")
    assert answer.status_code == 503
    assert not answer.json()["ready"]
    assert answer.json()["checks"]["maps"] == "the folder is missing"
    assert httpx.get(running.url + "/healthz").status_code == 200
    running.settings.maps_dir.mkdir()


def test_workers_elsewhere_are_reported(serve):
    running = serve()
    workers = WorkerTable(open_database(running.settings.data_dir))
    workers.beat("elsewhere-1")
    assert httpx.get(running.url + "/readyz").json()["checks"]["worker"] == "ok"
    workers.remove("elsewhere-1")
    assert httpx.get(running.url + "/readyz").json()["checks"]["worker"] == _NO_WORKER


def test_no_other_site_may_call_from_a_browser(service):
    answer = httpx.get(service.url + "/v1/maps", headers={"Origin": "https://example.com"})
    assert not [name for name in answer.headers if name.startswith("access-control-")]


def test_the_log_is_json_unless_the_process_writes_its_own(capsys, monkeypatch):
    root = logging.getLogger()
    monkeypatch.setattr(root, "handlers", [logging.NullHandler()])
    configure_logs()
    assert not logging.getLogger("rholoc").handlers
    monkeypatch.setattr(root, "handlers", [])
    configure_logs()
    try:
        raise ValueError("what went wrong")
    except ValueError:
        logging.getLogger("rholoc.test").exception("internal_error", extra={"request_id": "r1"})
    line = json.loads(capsys.readouterr().err)
    assert (line["event"], line["request_id"], line["level"]) == ("internal_error", "r1", "error")
    assert "what went wrong" in line["exception"]


def test_metrics_count_requests_frames_and_jobs(service, picture_world):
    for _ in range(2):
        httpx.post(
            service.url + "/v1/maps/room/localize", content=picture_world.png(), headers={"Content-Type": "image/png"}
        )
    httpx.get(service.url + "/v1/maps/attic")
    lines = httpx.get(service.url + "/metrics").text.splitlines()
    values = {name: float(value) for name, _, value in (line.rpartition(" ") for line in lines if line[0] != "#")}
    route = 'method="POST",route="/v1/maps/{map_name}/localize",status="200"'
    assert values[f"rholoc_request_seconds_count{{{route}}}"] >= 2
    assert values['rholoc_request_seconds_count{method="GET",route="/v1/maps/{map_name}",status="404"}'] >= 1
    assert values['rholoc_localizations_total{outcome="localized"}'] >= 2
    assert values['rholoc_jobs{state="queued"}'] == 0
    assert values['rholoc_jobs_waiting{obstacle="memory"}'] == 0
    assert values['rholoc_frames{at="now"}'] == 0
