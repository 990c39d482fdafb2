"""The clients against the OpenAPI document: every route has a method in Python, and JavaScript asks for no other."""

from __future__ import annotations

import dataclasses
import inspect
import re
import runpy
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import httpx
import pytest

import rholoc_client
from rholoc.service.errors import error_classes, status_of
from rholoc_client import Camera, Client, RholocClientError, errors

PICTURE = b"\xff\xd8\xff\xe0"
GIVEN: dict[str, Any] = {
    "image": PICTURE,
    "frames": [],
    "camera": Camera(500.0, 500.0, 320.0, 240.0),
    "correction": {"kind": "up"},
    "features": None,
    "source": {"type": "FeatureCollection"},
    "maps": "X",
    "number": 7,
    "feature": 7,
    "view": 7,
    "waypoints": [],
}
CLIENT = Path(__file__).parents[2] / "client"
WRITTEN = re.compile(r'path`(v1/[^`]+)`|"(v1/[^"]+)"')
FOR_OTHERS = {
    "upload_map": {"source": b"rho"},
    "localize_descriptors": None,  # the route of localize
    "wait_for_job": None,  # the route of job
}


@pytest.fixture
def asked(tmp_path):
    """The routes that a client asks for, and the client."""
    routes: set[tuple[str, str]] = set()

    def answer(request: httpx.Request) -> httpx.Response:
        path = request.url.raw_path.decode().partition("?")[0]
        routes.add((request.method, re.sub(r"/[X7](?=/|$)", "/{}", path)))
        if (request.method, path) == ("POST", "/v1/recordings"):
            return httpx.Response(201, headers={"Location": "/v1/recordings/X"})
        if (request.method, path) == ("HEAD", "/v1/recordings/X"):
            return httpx.Response(200, headers={"Upload-Offset": "5", "Rholoc-Job": "X"})
        return httpx.Response(409, json={"code": "conflict", "message": "No.", "hint": ""})

    with Client("http://service", retries=1, transport=httpx.MockTransport(answer)) as client:
        yield routes, client


def arguments(name: str, method: Any, film: Path) -> dict[str, Any]:
    """Arguments for the parameters of a method that have no default."""
    needed = [key for key, one in inspect.signature(method).parameters.items() if one.default is one.empty]
    given = {**GIVEN, **(FOR_OTHERS.get(name) or {}), "path": film}
    mappings = ("document", "request", "key", "limits")
    return {key: given.get(key, {} if key in mappings else "X") for key in needed}


def test_every_route_has_a_method(asked, openapi, tmp_path):
    routes, client = asked
    film = tmp_path / "walk.mp4"
    film.write_bytes(b"film.")
    for name, method in inspect.getmembers(client, inspect.ismethod):
        if name.startswith("_") or name == "close" or FOR_OTHERS.get(name, {}) is None:
            continue
        options = arguments(name, method, film)
        before = set(routes)
        for chosen in [options, {**options, "maps": None}] if "maps" in options else [options]:
            with suppress(RholocClientError):
                answer = method(**chosen)
                if inspect.isgenerator(answer):
                    next(answer)
        assert routes != before or name in ("map", "job"), f"{name} asked for nothing new"
    assert routes == {
        (method.upper(), re.sub(r"\{.+?\}", "{}", path))
        for path, methods in openapi["paths"].items()
        for method in methods
        if method in ("get", "put", "post", "delete", "patch", "head", "options")
    }


def test_pages_and_the_javascript_client_ask_for_routes_that_there_are(openapi):
    known = {"/v1/maps/{map}/track", *openapi["paths"]}  # OpenAPI has no WebSockets
    sources = [*(CLIENT / "js").glob("*.js"), *(CLIENT / "page").rglob("*.js")]
    written = {"".join(found) for one in sources for found in WRITTEN.findall(one.read_text(encoding="utf-8"))}
    assert len(written) > 40
    for path in written:
        pattern = re.sub(r"\$\{.+?\}", "[^/]+", path) + (".+" if path.endswith("/") else "")
        assert any(re.fullmatch("/" + pattern, one) for one in known), path


MODELS = (
    "Alternative",
    "Camera",
    "CameraProfile",
    "Features",
    "Frame",
    "FramePose",
    "Job",
    "Localization",
    "MapSummary",
    "Matches",
    "NearPlace",
    "OfSite",
    "OnEarth",
    "Place",
    "Pose",
    "Prior",
    "Site",
    "SiteMap",
    "SitePose",
)


OF_TRACKING = {"AsyncTracker", "ImuNoise", "OdometryNoise", "TrackOptions", "TrackStatus", "Tracked", "Tracker"}


def client_errors() -> list[type[Exception]]:
    return [kind for _, kind in inspect.getmembers(errors, inspect.isclass) if issubclass(kind, Exception)]


def test_all_is_what_is_public():
    public = {name for name in vars(rholoc_client) if not name.startswith("_") and name[0].isupper()}
    public -= {"TYPE_CHECKING", "Any"}
    assert set(rholoc_client.__all__) == public | OF_TRACKING
    assert all(getattr(rholoc_client, name).__module__.startswith("rholoc_client") for name in OF_TRACKING)
    assert public - OF_TRACKING == {"AsyncClient", "Client", *MODELS} | {kind.__name__ for kind in client_errors()}


def test_models_are_frozen():
    for name in MODELS:
        assert getattr(rholoc_client, name).__dataclass_params__.frozen
        assert dataclasses.is_dataclass(getattr(rholoc_client, name))


def test_the_drawn_tree_is_the_real_one():
    drawn: dict[str, str] = {}
    above: list[str] = []
    for line in (errors.__doc__ or "").splitlines():
        found = re.match(r"    ([│├└─ ]*)([A-Z]\w+)", line)
        if found:
            depth = len(found[1]) // 4
            above[depth:] = [found[2]]
            drawn[found[2]] = above[depth - 1] if depth else "Exception"
    assert drawn == {kind.__name__: kind.__base__.__name__ for kind in client_errors()}


def test_every_code_of_the_service_is_an_exception():
    assert {kind.code for kind in error_classes()} <= set(errors.BY_CODE)
    for kind in error_classes():
        if kind.code != kind.__base__.code:  # others are told as the error that they are a kind of
            assert errors.BY_CODE[kind.code].__name__ == kind.__name__
        assert status_of(kind) >= 400


def test_the_blocking_client_is_written_from_the_other():
    """After a change: python client/write_sync.py."""
    script = runpy.run_path(str(Path(__file__).parents[2] / "client" / "write_sync.py"))
    assert script["SYNC_FILE"].read_text(encoding="utf-8") == script["sync_source"]()


def test_the_client_needs_neither_the_service_nor_numpy():
    code = "import sys, rholoc_client; print([m for m in ('rholoc', 'numpy', 'cv2') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
