"""The clients against the OpenAPI document: every route has a method in Python, and JavaScript asks for no other."""

from __future__ import annotations

import inspect
import re
from contextlib import suppress
from pathlib import Path
from typing import Any

import httpx
import pytest

from rholoc_client import Camera, Client, RholocClientError

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
