"""Refused pictures: kept only where the setting says so, bounded, and compared with the map."""

import json
from dataclasses import replace

import cv2
import httpx
import numpy as np
import pytest

from rholoc.features import Metric
from rholoc.service.access.keys import KeyStore, Scope
from rholoc.service.frames.kept.refusals import lines_between
from rholoc.service.settings import KeyPolicy
from rholoc_client import Client, Prior


@pytest.fixture(scope="module")
def keeping(serve, picture_world):
    """A service that keeps two refused pictures, with the map ``room`` and the keys of a robot and an operator."""
    running = serve(keep_refused=2, keys=KeyPolicy.ALWAYS)
    store = KeyStore(running.settings.data_dir)
    headers = {
        scope: {"Authorization": f"Bearer {store.create(f'robot-{scope}', scope)}"}
        for scope in (Scope.VISIT, Scope.LOCALIZE, Scope.MAP)
    }
    url = f"{running.url}/v1/maps/room"
    assert httpx.put(url, content=picture_world.rho(), headers=headers[Scope.MAP]).status_code == 201
    return running.url, headers


def png(image) -> bytes:
    return cv2.imencode(".png", image)[1].tobytes()


def ask(url, headers, image):
    where = f"{url}/v1/maps/room/localize"
    kind = {"Content-Type": "image/png"}
    return httpx.post(where, content=png(image), headers={**headers[Scope.LOCALIZE], **kind}, timeout=60).json()


def test_the_last_refused_pictures_are_kept_with_their_cause_and_sender(keeping, picture_world):
    url, headers = keeping
    noise = np.random.default_rng(5).integers(0, 255, (480, 640, 3), np.uint8)
    assert ask(url, headers, picture_world.image)["localized"]
    for image in (noise, np.zeros((480, 640, 3), np.uint8), noise[::-1]):
        assert not ask(url, headers, image)["localized"]
    where = f"{url}/v1/maps/room/refusals"
    assert httpx.get(where, headers=headers[Scope.LOCALIZE]).status_code == 403
    last, before = httpx.get(where, headers=headers[Scope.MAP]).json()["refusals"]
    assert (before["cause"], before["asker"]) == ("too_dark", "robot-localize")
    assert last["message"]
    picture = httpx.get(f"{where}/{last['number']}/picture.jpg", headers=headers[Scope.MAP]).content
    assert cv2.imdecode(np.frombuffer(picture, np.uint8), 1).shape == (360, 480, 3)
    assert httpx.get(f"{where}/{before['number'] - 1}", headers=headers[Scope.MAP]).status_code == 404
    likeness = httpx.get(f"{where}/{last['number']}", headers=headers[Scope.MAP]).json()
    assert set(likeness) == {"view", "lines"}
    assert all(0 <= share <= 1 for line in likeness["lines"] for share in line)


@pytest.mark.slow
def test_a_large_picture_is_answered_and_kept(keeping):
    url, headers = keeping
    answer = ask(url, headers, np.zeros((3600, 4800, 3), np.uint8))
    assert (answer.get("localized"), answer.get("reason") is not None) == (False, True)
    last = httpx.get(f"{url}/v1/maps/room/refusals", headers=headers[Scope.MAP]).json()["refusals"][0]
    assert last["cause"] == "too_dark"


def test_nothing_is_kept_unless_the_setting_says_so(service):
    answer = httpx.get(f"{service.url}/v1/maps/testsite/refusals")
    if answer.status_code != 404:
        assert (answer.status_code, answer.json()["code"]) == (409, "conflict")


def test_a_picture_is_joined_with_the_view_where_they_show_the_same(point_room):
    poses = point_room.walk(30)
    map_ = point_room.map_of(poses, "walk")
    features = point_room.see(poses[12], seed=99)
    lines = lines_between(features, (640, 480), map_, 12, Metric.HAMMING)
    assert len(lines) > 20
    np.testing.assert_allclose(lines[:, :2], lines[:, 2:], atol=0.01)  # it is the view's own pose


def test_a_view_of_another_camera_than_the_maps_is_joined_within_its_picture(point_room):
    poses = point_room.walk(30)
    map_ = point_room.map_of(poses, "walk")
    source = replace(map_.info.sources[0], camera=map_.info.camera)
    small = replace(map_.info, camera=map_.info.camera.resized(320, 240), sources=(source,))
    lines = lines_between(point_room.see(poses[12], seed=99), (640, 480), replace(map_, info=small), 12, Metric.HAMMING)
    np.testing.assert_allclose(lines[:, :2], lines[:, 2:], atol=0.01)


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
