"""Every route declares who may use it, the guard holds it to that, and the documents and OpenAPI say the same."""

import asyncio
import re
import socket
import time
from pathlib import Path

import cv2
import httpx
import numpy as np
import pytest
from fastapi import Request

from rholoc.service import Settings, create_app
from rholoc.service.access.keys import KeyStore, Scope
from rholoc.service.access.scopes import OPEN, find_route, route_access
from rholoc.service.qr_code import qr_for_terminal
from rholoc.service.settings import KeyPolicy
from waiting import until

PAGES = "".join(
    page.read_text(encoding="utf-8") for page in sorted((Path(__file__).parents[2] / "docs" / "service").glob("*.md"))
)
ROUTES = route_access(create_app(Settings()).routes)
REQUESTS = [(method, route) for route in ROUTES for method in sorted(route.methods)]
NAMES = {
    route.path: re.sub(r"{[^}]*}", "localize", route.path) for route in ROUTES
}  # a name that is a path's last word


def name_of(request) -> str:
    return f"{request[0]} {request[1].path}"


@pytest.fixture(scope="module")
def locked(serve):
    return serve(keys=KeyPolicy.ALWAYS)


@pytest.fixture(scope="module")
def secrets(locked):
    """Headers by what they hold: a key of each scope, none, one that was revoked, one that has expired."""
    store = KeyStore(locked.settings.data_dir)
    keys = {scope: store.create(f"key-{scope}", scope) for scope in Scope}  # no route of a request revokes one
    keys["revoked"] = store.create("revoked", Scope.ADMIN)
    keys["expired"] = store.create("expired", Scope.ADMIN, lifetime_s=0)
    store.revoke("revoked")
    headers = {held: {"Authorization": f"Bearer {secret}"} for held, secret in keys.items()}
    until(lambda: httpx.get(f"{locked.url}/v1/maps", headers=headers["revoked"]).status_code == 401)
    return {**headers, "none": {}}


@pytest.fixture(scope="module")
def http(locked):
    with httpx.Client(base_url=locked.url, timeout=60) as client:
        yield client


def test_every_route_declares_who_may_use_it():
    assert len(ROUTES) > 30
    assert [route.path for route in ROUTES if route.access is None] == []


@pytest.mark.parametrize("request_", REQUESTS, ids=map(name_of, REQUESTS))
def test_a_route_takes_the_keys_of_its_scope_and_no_other(request_, http, secrets):
    method, route = request_
    for held, headers in secrets.items():
        answer = http.request(method, NAMES[route.path], headers=headers)
        if route.access.scope is None:
            expected = None
        elif held not in list(Scope):
            expected = 401
        else:
            expected = None if held.allows(route.access.scope) else 403
        refused = answer.status_code if answer.status_code in (401, 403) else None
        assert refused == expected, (held, answer.status_code)


def test_a_key_that_localizes_changes_no_map_or_camera_called_localize(http, secrets):
    for method, path in (
        ("PUT", "/v1/maps/localize"),
        ("DELETE", "/v1/maps/localize"),
        ("PUT", "/v1/cameras/localize"),
    ):
        assert http.request(method, path, headers=secrets[Scope.LOCALIZE]).status_code == 403
    assert http.delete("/v1/maps/localize", headers=secrets[Scope.MAP]).status_code == 403


def test_the_readme_shows_what_the_code_declares():
    section = PAGES.split("## Routes\n", 1)[1].split("\nNames of maps", 1)[0]
    documented = dict(re.findall(r"^\| `(\w+ \S+)` \| `?(\w+)`? \|", section, re.MULTILINE))
    declared = {name_of(one): str(one[1].access.scope or "open") for one in REQUESTS}
    assert documented == {name: declared[name] for name in documented}
    hidden = declared.keys() - documented.keys()
    assert {declared[name] for name in hidden if "/v1/" not in name} == {"open"}
    assert {name for name in hidden if "/v1/" in name} == {"OPTIONS /v1/recordings/{recording}"}


def test_openapi_shows_the_scopes(openapi):
    shown = {
        f"{method.upper()} {path}": [scope for one in operation.get("security", []) for scope in one["ApiKey"]]
        for path, item in openapi["paths"].items()
        for method, operation in item.items()
    }
    declared = {name_of(one): [one[1].access.scope] if one[1].access.scope else [] for one in REQUESTS}
    assert shown == {name: declared[name] for name in shown}
    assert openapi["components"]["securitySchemes"]["ApiKey"]["scheme"] == "bearer"


@pytest.mark.parametrize("policy", [KeyPolicy.NEVER, KeyPolicy.ALWAYS])
def test_a_route_that_declares_nothing_is_closed(policy):
    app = create_app(Settings(keys=policy))

    async def endpoint(request: Request) -> None:
        raise AssertionError("reached")

    app.get("/undeclared")(endpoint)
    app.add_route("/plain", endpoint)
    app.mount("/mounted", app)
    transport = httpx.ASGITransport(app)

    async def ask():
        async with httpx.AsyncClient(transport=transport, base_url="http://localhost") as client:
            return [(await client.get(path)).status_code for path in ("/undeclared", "/plain", "/mounted/healthz")]

    assert asyncio.run(ask()) == [403, 403, 403]


def test_an_open_route_that_is_added_is_open():
    app = create_app(Settings(keys=KeyPolicy.ALWAYS))

    @app.get("/open", dependencies=[OPEN])
    async def endpoint() -> None: ...

    scope = {"type": "http", "method": "GET", "path": "/open", "headers": []}
    assert find_route(route_access(app.routes), scope).route.access.scope is None


def test_without_a_key_unknown_paths_and_methods_look_like_the_known(http, secrets):
    for method, path in (("GET", "/v1/nothing"), ("DELETE", "/v1/maps"), ("BREW", "/v1/maps"), ("POST", "/healthz")):
        assert http.request(method, path).json()["code"] == "unauthorized"
    reader = secrets[Scope.READ]
    assert http.get("/v1/nothing", headers=reader).json()["code"] == "unknown_route"
    refused = http.delete("/v1/maps", headers=reader)
    assert (refused.status_code, refused.headers["Allow"]) == (405, "GET")
    assert http.patch("/v1/maps/room/scene", headers=reader).headers["Allow"] == "GET"


def test_a_method_that_is_overridden_needs_the_scope_of_what_it_becomes(http, secrets):
    headers = {**secrets[Scope.MAP], "Tus-Resumable": "1.0.0", "X-HTTP-Method-Override": "DELETE"}
    assert http.post("/v1/maps/localize", headers=headers).status_code == 403


def test_the_key_is_judged_before_the_body_arrives(locked):
    with socket.create_connection(locked.address, timeout=60) as connection:
        connection.sendall(b"PUT /v1/maps/localize HTTP/1.1\r\nHost: localhost\r\nContent-Length: 1000000\r\n\r\n")
        assert connection.recv(64).startswith(b"HTTP/1.1 401")


@pytest.fixture(scope="module")
def store(locked):
    return KeyStore(locked.settings.data_dir)


def ask(locked, secret, method="POST", path="/v1/keys", **request):
    return httpx.request(method, locked.url + path, headers={"Authorization": f"Bearer {secret}"}, **request)


def test_a_key_is_handed_on_works_is_listed_and_revoked(locked, store):
    admin = store.create("admin", Scope.ADMIN)
    handed = ask(locked, admin, json={"scope": "read", "lifetime_s": 3600}).json()
    assert handed["expires"] == pytest.approx(time.time() + 3600, abs=60)
    assert ask(locked, handed["key"], "GET", "/v1/maps").status_code == 200
    assert ask(locked, handed["key"], json={}).status_code == 403  # a reader hands nothing on
    listed = ask(locked, admin, "GET").json()["keys"]
    assert {"admin", handed["name"]} <= {key["name"] for key in listed}
    assert handed["key"] not in str(listed)
    assert ask(locked, admin, "DELETE", f"/v1/keys/{handed['name']}").status_code == 204
    assert ask(locked, handed["key"], "GET", "/v1/maps").status_code == 401
    assert ask(locked, admin, "DELETE", f"/v1/keys/{handed['name']}").status_code == 404


def test_a_key_has_the_name_that_was_asked_for_once(locked, store):
    admin = store.create("names", Scope.ADMIN)
    assert ask(locked, admin, json={"name": "robot-7"}).json()["name"] == "handed-robot-7"
    again = ask(locked, admin, json={"name": "robot-7"})
    assert (again.status_code, again.json()["code"]) == (409, "conflict")
    assert ask(locked, admin, json={"name": "a\nb"}).json()["code"] == "invalid_name"


def test_never_more_and_never_longer_than_the_key_that_asks(locked, store):
    mapper = store.create("mapper", Scope.MAP, lifetime_s=600)
    answer = ask(locked, mapper, json={"scope": "admin"})
    assert (answer.status_code, answer.json()["code"]) == (403, "forbidden")
    handed = ask(locked, mapper, json={"scope": "map", "lifetime_s": 86400}).json()
    assert handed["expires"] <= store.find(mapper).expires + 1


@pytest.mark.parametrize("body", [{"lifetime_s": 1}, {"lifetime_s": 1e9}, {"scope": "all"}, {"forever": True}])
def test_what_makes_no_sense_is_refused(locked, store, body):
    secret = store.create(f"asks {body}", Scope.ADMIN)
    assert ask(locked, secret, json=body).json()["code"] == "invalid_request"


def test_where_nobody_needs_a_key_none_is_made(service):
    answer = httpx.post(f"{service.url}/v1/keys", json={})
    assert answer.status_code == 201
    assert answer.json()["key"] is None


def test_a_qr_code_says_what_was_asked(service):
    text = "https://maps.example/record#/key/rho_0123456789abcdefghijklmnopqrstuvwxyz"
    answer = httpx.post(f"{service.url}/v1/qr", json={"text": text})
    assert answer.headers["Content-Type"] == "image/svg+xml"
    assert cv2.QRCodeDetector().detectAndDecode(drawn(answer.text))[0] == text
    assert httpx.post(f"{service.url}/v1/qr", json={"text": ""}).status_code == 422
    assert httpx.post(f"{service.url}/v1/qr", json={"text": "x" * 1001}).status_code == 422


def drawn(svg):
    """The picture of an SVG whose last path is of cells of one unit each."""
    size = int(re.search(r'width="(\d+)', svg)[1])
    picture = np.full((size, size), 255, np.uint8)
    for x, y in re.findall(r"M(\d+) (\d+)h1v1", svg):
        picture[int(y), int(x)] = 0
    return cv2.resize(picture, None, fx=6, fy=6, interpolation=cv2.INTER_NEAREST)


def test_a_qr_code_can_be_read_from_a_terminal():
    text = "https://192.168.1.5:8080/here/campus#key=rho_abc"
    rows = [re.sub(r"\x1b\[[\d;]*m", "", row) for row in qr_for_terminal(text).splitlines()]
    halves = np.array([[" ▄▀█".index(one) for one in row] for row in rows])
    picture = np.stack([halves // 2, halves % 2], axis=1).reshape(-1, halves.shape[1])
    shown = cv2.resize(np.uint8(255 * (1 - picture)), None, fx=6, fy=6, interpolation=cv2.INTER_NEAREST)
    assert cv2.QRCodeDetector().detectAndDecode(shown)[0] == text


def test_an_expired_key_that_another_request_removes_at_the_same_moment_is_no_error(locked, store, monkeypatch):
    asking = store.create("asks beside another", Scope.MAP)
    store.create("handed-expired", Scope.READ, lifetime_s=-1.0)
    read = KeyStore.keys

    def removed_meanwhile(self):
        found = read(self)
        if any(key.name == "handed-expired" for key in found):
            self.revoke("handed-expired")
        return found

    monkeypatch.setattr(KeyStore, "keys", removed_meanwhile)
    assert ask(locked, asking, json={}).status_code == 201
