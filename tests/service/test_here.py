"""What a visitor's key shows: one site, where one may walk, and where the own camera is; and nothing else."""

from __future__ import annotations

from dataclasses import replace

import httpx
import numpy as np
import pytest

from rholoc.maps import Cloud, MapNames, NamedArea, NamedPoint, Room, map_to_bytes
from rholoc.service.access.keys import KeyStore, Scope
from rholoc.service.settings import KeyPolicy

NAMES = MapNames((NamedPoint("door", (3.0, 2.0, 1.0)),), (NamedArea("lounge", ((0, 0), (2, 0), (2, 2), (0, 2))),))
TURNED = {"position": [10.0, 0.0, 0.0], "quaternion_xyzw": [0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)]}


@pytest.fixture(scope="module")
def site(serve, picture_world):
    """A service with keys, and a site of two maps, of which one has no place in it."""
    running = serve(keys=KeyPolicy.ALWAYS)
    store = KeyStore(running.settings.data_dir)
    keys = {
        "boss": store.create("boss", Scope.ADMIN),
        "visitor": store.create("visitor", Scope.VISIT, site="campus"),
        "other": store.create("other", Scope.VISIT, site="elsewhere"),
    }
    headers = {name: {"Authorization": f"Bearer {secret}"} for name, secret in keys.items()}
    corner = Cloud(np.zeros((3, 3), np.float32), np.zeros((3, 3), np.uint8), np.zeros(3, np.int32))
    map_ = replace(picture_world.map_, room=Room(corner), info=replace(picture_world.map_.info, names=NAMES))
    for name in ("hall", "cellar"):
        answer = httpx.put(f"{running.url}/v1/maps/{name}", content=map_to_bytes(map_), headers=headers["boss"])
        assert answer.status_code == 201
    wanted = {"maps": [{"map": "hall", "floor": "1", "pose": TURNED}, {"map": "cellar"}]}
    assert httpx.put(f"{running.url}/v1/sites/campus", json=wanted, headers=headers["boss"]).status_code == 201
    return running, headers


def test_a_visitor_sees_rooms_walks_and_names_in_the_sites_frame(site):
    running, headers = site
    shown = httpx.get(f"{running.url}/v1/here/campus", headers=headers["visitor"]).json()
    (room,) = shown["rooms"]
    assert (room["map"], room["floor"], room["room"]) == ("hall", "1", 3)
    np.testing.assert_allclose(np.array(room["walked"][0])[:, 0], 8.0, atol=0.2)  # 10 - y of the map's walk
    assert {(point["name"], *point["position"][:2]) for point in shown["points"]} == {
        ("door", 8.0, 3.0),
        ("lounge", 9.0, 1.0),
    }
    mesh = httpx.get(f"{running.url}/v1/here/campus/rooms/hall", headers=headers["visitor"])
    assert np.frombuffer(mesh.content[:8], "<u4").tolist() == [3, 0]
    assert httpx.get(f"{running.url}/v1/here/campus/rooms/none", headers=headers["visitor"]).status_code == 404


def test_a_visitors_picture_is_answered_in_the_sites_frame(site, picture_world):
    running, headers = site
    where = f"{running.url}/v1/here/campus/localize"
    kind = {"Content-Type": "image/png"}
    answer = httpx.post(where, content=picture_world.png(), headers={**headers["visitor"], **kind}, timeout=60).json()
    assert set(answer) == {"localized", "floor", "position", "heading", "sigma_m", "message"}
    if answer["localized"]:  # the two maps are alike: either may answer
        np.testing.assert_allclose(answer["position"], [8.0, 1.0, 1.5], atol=0.1)
        assert answer["floor"] == "1"
    else:
        assert answer["message"] == "This room has no place on the plan yet."
    black = httpx.post(where, content=_black(), headers={**headers["visitor"], **kind}, timeout=60).json()
    assert (black["localized"], black["position"]) == (False, None)
    assert black["message"]


def _black() -> bytes:
    import cv2

    return cv2.imencode(".png", np.zeros((480, 640, 3), np.uint8))[1].tobytes()


def test_a_visitors_key_allows_nothing_else(site):
    running, headers = site
    for path in ("/v1/maps", "/v1/maps/hall", "/v1/sites/campus", "/v1/jobs"):
        assert httpx.get(running.url + path, headers=headers["visitor"]).status_code == 403
    answer = httpx.get(f"{running.url}/v1/here/campus", headers=headers["other"])
    assert (answer.status_code, answer.json()["message"]) == (403, "This link is for another site.")
    assert httpx.post(f"{running.url}/v1/keys", json={}, headers=headers["visitor"]).status_code == 403


def test_a_key_for_visitors_is_handed_on_for_one_site(site):
    running, headers = site
    wanted = {"scope": "visit", "site": "campus", "lifetime_s": 3600}
    handed = httpx.post(f"{running.url}/v1/keys", json=wanted, headers=headers["boss"]).json()
    key = httpx.get(f"{running.url}/v1/keys/{handed['name']}", headers=headers["boss"]).json()
    assert (key["scope"], key["site"]) == ("visit", "campus")
    visitor = {"Authorization": f"Bearer {handed['key']}"}
    assert httpx.get(f"{running.url}/v1/here/campus", headers=visitor).status_code == 200
    assert httpx.get(f"{running.url}/v1/here/other", headers=visitor).status_code == 403
