"""Who asks for poses now, and where requests failed: shown and kept only where the settings say so."""

from __future__ import annotations

import json

import cv2
import httpx
import numpy as np
import pytest

from rholoc.service.access.keys import KeyStore, Scope
from rholoc.service.settings import KeyPolicy
from rholoc_client import Client, Prior


@pytest.fixture(scope="module")
def watched(serve, picture_world):
    running = serve(live=True, keep_failures=True, keys=KeyPolicy.ALWAYS)
    (running.settings.maps_dir / "room.rho").write_bytes(picture_world.rho())
    (running.settings.maps_dir / "other.rho").write_bytes(picture_world.rho())
    return running


@pytest.fixture(scope="module")
def keys(watched):
    store = KeyStore(watched.settings.data_dir)
    return {name: store.create(name, Scope.LOCALIZE) for name in ("robot-1", "robot-2", "watcher")}


def blank(picture_world):
    return cv2.imencode(".png", np.full_like(picture_world.image, 128))[1].tobytes()


def watch(watched, keys, wanted, map_name="room"):
    """The latest sighting of each asker, once ``wanted`` says that they are enough."""
    seen = {}
    headers = {"Authorization": f"Bearer {keys['watcher']}"}
    with httpx.stream("GET", f"{watched.url}/v1/maps/{map_name}/live", headers=headers) as stream:
        assert stream.headers["Content-Type"].startswith("text/event-stream")
        for line in stream.iter_lines():
            if line.startswith("data: "):
                seen |= {one["asker"]: one for one in json.loads(line[6:])}
                if wanted(seen):
                    return seen
    raise AssertionError("the stream ended")


def test_who_asks_is_seen_by_key_where_and_how_surely(watched, keys, picture_world):
    for name in ("robot-1", "robot-2"):
        found = Client(watched.url, api_key=keys[name]).localize("room", picture_world.png())
        assert found.localized
    Client(watched.url, api_key=keys["robot-2"]).localize("room", blank(picture_world))
    seen = watch(watched, keys, lambda seen: len(seen) == 2)
    assert seen["robot-1"]["localized"]
    np.testing.assert_allclose(seen["robot-1"]["position"], found.pose.position, atol=1e-6)
    assert 0 < seen["robot-1"]["sigma_m"] < 0.1
    assert not seen["robot-2"]["localized"]
    assert seen["robot-2"]["reason"]
    assert seen["robot-2"]["position"] is None  # where it had been says nothing about this picture


def test_failures_are_kept_without_names(watched, keys, picture_world):
    client = Client(watched.url, api_key=keys["robot-1"])
    prior = Prior(position=(4.0, 5.0, 1.0), heading=(1.0, 0.0, 0.0))
    assert not client.localize("other", blank(picture_world), prior=prior).localized
    assert client.localize("other", picture_world.png()).localized
    assert not client.localize("other", blank(picture_world)).localized  # nobody knows where
    headers = {"Authorization": f"Bearer {keys['watcher']}"}
    kept, unknown = httpx.get(f"{watched.url}/v1/maps/other/failures", headers=headers).json()["failures"]
    assert kept["position"] == [4.0, 5.0, 1.0]
    assert kept["reason"]
    assert (unknown["position"], unknown["heading"]) == (None, None)
    assert "robot" not in json.dumps(kept)


def test_both_are_off_unless_switched_on(service):
    for what in ("live", "failures"):
        answer = httpx.get(f"{service.url}/v1/maps/room/{what}")
        assert (answer.status_code, answer.json()["code"]) == (409, "conflict")
        assert "RHOLOC_" in answer.json()["hint"]
        assert httpx.get(f"{service.url}/v1/maps/nowhere/{what}").status_code == 404
