"""Liveness, readiness, logs."""

from __future__ import annotations

import json

import httpx
import structlog

from rholoc import __version__
from rholoc.jobs.workers_table import WorkerTable
from rholoc.logs import configure_logs
from rholoc.storage.database import open_database

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


def test_the_log_is_json(capsys):
    configure_logs()
    try:
        raise ValueError("what went wrong")
    except ValueError:
        structlog.get_logger("test").exception("internal_error", request_id="r1")
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
