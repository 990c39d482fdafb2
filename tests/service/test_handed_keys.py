"""Keys that are handed on: never more, never longer than the one that asks; and QR codes."""

from __future__ import annotations

import re
import time

import cv2
import httpx
import numpy as np
import pytest

from rholoc.service.access.keys import KeyStore, Scope
from rholoc.service.settings import KeyPolicy


@pytest.fixture(scope="module")
def locked(serve):
    return serve(keys=KeyPolicy.ALWAYS)


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
    """The picture of segno's SVG: one path of horizontal strokes, relative to each other, one unit high."""
    size = int(re.search(r'width="(\d+)', svg)[1])
    picture = np.full((size, size), 255, np.uint8)
    x = y = 0.0
    for command, numbers in re.findall(r"([Mmh])([-\d. ]+)", re.search(r'stroke="#000" d="([^"]+)"', svg)[1]):
        values = [float(one) for one in re.findall(r"-?[\d.]+", numbers)]
        if command == "h":
            picture[int(y), int(x) : int(x + values[0])] = 0
            x += values[0]
        else:
            x, y = (values[0], values[1]) if command == "M" else (x + values[0], y + values[1])
    return cv2.resize(picture, None, fx=6, fy=6, interpolation=cv2.INTER_NEAREST)


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
