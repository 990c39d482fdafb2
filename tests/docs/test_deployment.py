"""Descriptions of deployments: well-formed, and about this service."""

import json
import re
import shutil
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import httpx
import kubernetes_validate
import pytest
import yaml

from rholoc import __version__
from rholoc.service import Settings
from rholoc.service.http.web import FOLDERS, PAGES
from waiting import until

_ROOT = Path(__file__).parents[2]
_DEPLOY = _ROOT / "server" / "deploy"


@pytest.fixture(scope="module")
def manifests() -> list[dict[str, Any]]:
    return list(yaml.safe_load_all((_DEPLOY / "kubernetes.yaml").read_text(encoding="utf-8")))


def test_manifests_are_as_kubernetes_takes_them(manifests: list[dict[str, Any]]) -> None:
    for manifest in manifests:
        kubernetes_validate.validate(manifest, "1.30", strict=True)


@pytest.mark.parametrize("path", ["compose.yaml", "server/deploy/compose.yaml"])
def test_compose_files_are_as_compose_takes_them(path: str) -> None:
    command = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", "vendor.compose-spec", str(_ROOT / path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize("path", sorted(_DEPLOY.iterdir()) if _DEPLOY.is_dir() else [], ids=lambda path: path.name)
def test_only_settings_that_there_are_are_set(path: Path) -> None:
    named = set(re.findall(r"\bRHOLOC_([A-Z_]+)", path.read_text(encoding="utf-8")))
    proxy = {"SITE", "SERVERS", "SERVERS_PORT"}
    assert {name.lower() for name in named - proxy} <= set(Settings.model_fields)


def test_probes_ask_routes_that_there_are(manifests: list[dict[str, Any]], openapi) -> None:
    asked = set(re.findall(r'"path": "(/[a-z]*)"', json.dumps(manifests)))
    shown = {path.partition("/{")[0] for path in PAGES} | set(FOLDERS)
    assert {"/healthz", "/readyz", *shown} <= asked <= {*openapi["paths"], *shown}


def test_metrics_that_need_no_key_are_not_passed_on_to_others(manifests: list[dict[str, Any]]) -> None:
    (ingress,) = (one for one in manifests if one["kind"] == "Ingress")
    paths = [path for rule in ingress["spec"]["rules"] for path in rule["http"]["paths"]]
    assert not [path for path in paths if path["pathType"] == "Prefix" and "/metrics".startswith(path["path"])]
    assert "/metrics" not in [path["path"] for path in paths]


def test_containers_run_as_the_image_does(manifests: list[dict[str, Any]]) -> None:
    dockerfile = (_ROOT / "Dockerfile").read_text(encoding="utf-8")
    pods = [manifest["spec"]["template"]["spec"] for manifest in manifests if manifest["kind"] == "Deployment"]
    assert len(pods) == 2
    for pod in pods:
        assert f"--uid {pod['securityContext']['runAsUser']} " in dockerfile
        assert {mount["mountPath"] for mount in pod["containers"][0]["volumeMounts"]} == {"/data", "/tmp"}


def test_every_container_is_limited(manifests: list[dict[str, Any]]) -> None:
    for manifest in manifests:
        if manifest["kind"] == "Deployment":
            (container,) = manifest["spec"]["template"]["spec"]["containers"]
            limits = container["resources"]["limits"]
            assert set(limits) == {"cpu", "memory", "ephemeral-storage"}
    for path in (_ROOT / "compose.yaml", _DEPLOY / "compose.yaml"):
        for service in yaml.safe_load(path.read_text(encoding="utf-8"))["services"].values():
            assert set(service["deploy"]["resources"]["limits"]) == {"cpus", "memory", "pids"}


def test_a_worker_on_kubernetes_has_the_memory_that_it_plans_with(manifests: list[dict[str, Any]]) -> None:
    (worker,) = [one for one in manifests if one["kind"] == "Deployment" and one["metadata"]["name"] == "rholoc-worker"]
    resources = worker["spec"]["template"]["spec"]["containers"][0]["resources"]
    assert resources["requests"]["memory"] == resources["limits"]["memory"]


def test_autoscalers_alone_say_how_many_replicas_there_are(manifests: list[dict[str, Any]]) -> None:
    scaled = {one["spec"]["scaleTargetRef"]["name"] for one in manifests if one["kind"] == "HorizontalPodAutoscaler"}
    deployments = {one["metadata"]["name"]: one["spec"] for one in manifests if one["kind"] == "Deployment"}
    assert scaled == set(deployments)
    assert all("replicas" not in spec for spec in deployments.values())


def test_images_are_of_this_version_and_not_pulled_at_every_start(manifests: list[dict[str, Any]]) -> None:
    for manifest in manifests:
        if manifest["kind"] == "Deployment":
            (container,) = manifest["spec"]["template"]["spec"]["containers"]
            assert (container["image"], container["imagePullPolicy"]) == (f"rholoc:{__version__}", "IfNotPresent")


@pytest.mark.parametrize("path", [_ROOT / "compose.yaml", _DEPLOY / "compose.yaml"], ids=["one", "several"])
def test_what_a_read_only_container_writes_is_in_named_volumes(path: Path) -> None:
    described = yaml.safe_load(path.read_text(encoding="utf-8"))
    for service in described["services"].values():
        if service.get("read_only"):
            mounted = dict(volume.split(":")[::-1] for volume in service["volumes"])
            assert set(mounted) == {"/maps", "/data"}
            assert set(mounted.values()) <= set(described["volumes"])


def test_what_the_autoscalers_look_at_is_measured(manifests: list[dict[str, Any]]) -> None:
    names = set(re.findall(r'"metric": \{"name": "([a-z_]+)"', json.dumps(manifests)))
    source = (_ROOT / "server" / "rholoc" / "service" / "app.py").read_text(encoding="utf-8")
    assert names == {"rholoc_frames", "rholoc_jobs_waiting"}
    assert all(f'gauge("{name}"' in source for name in names)


CADDYFILE = (_DEPLOY / "Caddyfile").read_text(encoding="utf-8")
_REPLAYING_CADDY = (2, 8)  # sends a body that it kept to another server
needs_caddy = pytest.mark.skipif(shutil.which("caddy") is None, reason="Caddy is not installed")


class Upstream(ThreadingHTTPServer):
    """A server that answers with its port, or breaks off while it works on a request."""

    def __init__(self, dies: bool) -> None:
        self.broken_off: list[tuple[str, str]] = []
        upstream = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def answer(self) -> None:
                self.rfile.read(int(self.headers.get("Content-Length", 0)))
                if dies:
                    upstream.broken_off.append((self.command, self.path))
                    self.connection.shutdown(socket.SHUT_RDWR)
                    self.close_connection = True
                    return
                self.send_response(200)
                self.send_header("Content-Length", "0")
                self.end_headers()

            do_GET = do_POST = answer

            def log_message(self, *_: object) -> None:
                pass

        super().__init__(("127.0.0.1", 0), Handler)
        threading.Thread(target=self.serve_forever, daemon=True).start()


@pytest.fixture
def proxy(tmp_path: Path) -> Iterator[tuple[str, tuple[int, ...], Upstream]]:
    """The address of Caddy as it is deployed, before a server that dies and one that does not; its version; the first.

    It takes the server that dies for well again soon.
    """
    said = subprocess.run(["caddy", "version"], capture_output=True, text=True, check=True).stdout
    version = tuple(int(part) for part in re.findall(r"\d+", said)[:2])
    upstreams = [Upstream(dies=True), Upstream(dies=False)]
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    to = " ".join(f"127.0.0.1:{one.server_port}" for one in upstreams)
    text = re.sub(r"dynamic a [^}]*}[^}]*}[^}]*}", f"to {to}", CADDYFILE)
    text = text.replace("{$RHOLOC_SITE:localhost}", f"http://localhost:{port}").replace("least_conn", "first")
    if version < _REPLAYING_CADDY:
        text = text.replace("request_buffers 33MB", "")
    assert to in text
    file = tmp_path / "Caddyfile"
    file.write_text("{\n\tadmin off\n}\n" + text.replace("fail_duration 10s", "fail_duration 300ms"))
    command = ["caddy", "run", "--adapter", "caddyfile", "--config", str(file)]
    running = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    url = f"http://localhost:{port}"

    def answers() -> bool:
        assert running.poll() is None, "Caddy did not start"
        try:
            return httpx.get(f"{url}/healthz").status_code > 0
        except httpx.TransportError:
            return False

    try:
        until(answers)
        yield url, version, upstreams[0]
    finally:
        running.terminate()
        running.wait(60)
        for upstream in upstreams:
            upstream.shutdown()
            upstream.server_close()


@needs_caddy
def test_another_server_gets_what_one_died_with_if_it_changes_nothing(
    proxy: tuple[str, tuple[int, ...], Upstream],
) -> None:
    url, version, dying = proxy

    def answered(method: str, path: str, content: bytes = b"") -> set[int]:
        """With what, until the server that dies has had it."""
        statuses = set()
        dying.broken_off.clear()

        def has_had_it() -> bool:
            statuses.add(httpx.request(method, url + path, content=content).status_code)
            return (method, path) in dying.broken_off

        until(has_had_it)
        return statuses

    assert answered("GET", "/v1/maps") == {200}
    assert answered("POST", "/v1/maps/hall/localize") == {200}
    assert 502 in answered("POST", "/v1/recordings")
    assert 502 in answered("POST", "/v1/maps/hall/corrections", b"{}")
    if version >= _REPLAYING_CADDY:
        assert answered("POST", "/v1/localize", b"a picture" * 10_000) == {200}
