"""What is revoked is gone, with all that was handed on by it; what one client holds open is bounded."""

import base64
import threading
import time
from contextlib import ExitStack

import httpx
import pytest

from rholoc.service.access.keys import KeyStore, Scope
from rholoc.service.settings import KeyPolicy
from waiting import until


def bearer(secret: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {secret}"}


@pytest.fixture
def watched(serve, picture_world):
    """A service that wants a key for everything, and shows who asks."""
    running = serve(keys=KeyPolicy.ALWAYS, live=True, max_connections=40, max_unfinished_uploads=8)
    (running.settings.maps_dir / "room.rho").write_bytes(picture_world.rho())
    return running


@pytest.fixture
def store(watched) -> KeyStore:
    return watched.app.state.rholoc.keys.sync


def hand_on(running, secret: str, scope: Scope) -> tuple[str, str]:
    answer = httpx.post(f"{running.url}/v1/keys", json={"scope": scope, "lifetime_s": 3600}, headers=bearer(secret))
    answer.raise_for_status()
    return answer.json()["name"], answer.json()["key"]


def begin_upload(running, secret: str) -> httpx.Response:
    parts = {"filename": "walk.mp4", "map": "hall"}
    metadata = ",".join(f"{name} {base64.b64encode(value.encode()).decode()}" for name, value in parts.items())
    headers = {"Tus-Resumable": "1.0.0", "Upload-Length": "1000", "Upload-Metadata": metadata}
    return httpx.post(f"{running.url}/v1/recordings", headers={**headers, **bearer(secret)})


def status(running, secret: str) -> int:
    return httpx.get(f"{running.url}/v1/maps", headers=bearer(secret)).status_code


def test_revoking_a_key_ends_those_below_it_and_the_list_shows_the_tree(watched, store):
    owner, first = store.create("owner", Scope.ADMIN), store.create("first", Scope.ADMIN)
    second_name, second = hand_on(watched, first, Scope.ADMIN)
    third_name, third = hand_on(watched, second, Scope.ADMIN)
    listed = httpx.get(f"{watched.url}/v1/keys", headers=bearer(owner)).json()["keys"]
    above = {key["name"]: key["handed_on_by"] for key in listed}
    assert above == {"owner": None, "first": None, second_name: "first", third_name: second_name}
    assert status(watched, third) == 200
    httpx.delete(f"{watched.url}/v1/keys/first", headers=bearer(owner)).raise_for_status()
    assert [status(watched, one) for one in (first, second, third, owner)] == [401, 401, 401, 200]
    (left,) = store.keys()
    assert left.name == "owner"


def test_a_key_whose_holder_is_revoked_while_it_is_handed_on_is_worth_nothing(tmp_path):
    store = KeyStore(tmp_path)
    store.create("first", Scope.ADMIN)
    first = store.named("first")
    store.revoke("first")
    assert store.find(store.create("late", Scope.ADMIN, handed_by=first)) is None


@pytest.mark.parametrize("by", ["route", "command"])
def test_the_streams_of_a_revoked_key_end_within_a_second(watched, store, by):
    owner, reader = store.create(f"owner {by}", Scope.ADMIN), store.create(f"mapper {by}", Scope.MAP)
    _, below = hand_on(watched, reader, Scope.READ)
    ended: list[float] = []

    def watch(secret: str) -> None:
        with httpx.stream("GET", f"{watched.url}/v1/maps/room/live", headers=bearer(secret)) as answer:
            for _ in answer.iter_raw():
                pass
        ended.append(time.monotonic())

    threads = [threading.Thread(target=watch, args=(one,)) for one in (reader, below)]
    for thread in threads:
        thread.start()
    streams = f"{watched.url}/v1/streams"
    until(lambda: len(httpx.get(streams, headers=bearer(owner)).json()["streams"]) == 2)
    assert {one["counted_to"] for one in httpx.get(streams, headers=bearer(owner)).json()["streams"]} == {
        f"mapper {by}"
    }
    begun = time.monotonic()
    if by == "route":
        httpx.delete(f"{watched.url}/v1/keys/mapper {by}", headers=bearer(owner)).raise_for_status()
    else:
        KeyStore(watched.settings.data_dir).revoke(f"mapper {by}")
    for thread in threads:
        thread.join(60)
    assert max(ended) - begun < 1
    assert httpx.get(streams, headers=bearer(owner)).json()["streams"] == []


def test_an_administrator_ends_a_stream(watched, store):
    owner, reader = store.create("ends", Scope.ADMIN), store.create("reads", Scope.READ)
    with httpx.stream("GET", f"{watched.url}/v1/maps/room/live", headers=bearer(reader)) as answer:
        (one,) = httpx.get(f"{watched.url}/v1/streams", headers=bearer(owner)).json()["streams"]
        assert (one["key"], one["kind"], one["path"]) == ("reads", "events", "/v1/maps/room/live")
        address = f"{watched.url}/v1/streams/{one['id']}"
        assert httpx.delete(address, headers=bearer(owner)).status_code == 204
        for _ in answer.iter_raw():
            pass
    assert httpx.delete(address, headers=bearer(owner)).status_code == 404


def test_one_key_does_not_take_all_streams_and_what_it_handed_on_counts(watched, store):
    greedy, other = store.create("greedy", Scope.MAP), store.create("other", Scope.READ)
    _, below = hand_on(watched, greedy, Scope.READ)
    with ExitStack() as stack:

        def watch(secret: str) -> int:
            request = httpx.stream("GET", f"{watched.url}/v1/maps/room/live", headers=bearer(secret))
            return stack.enter_context(request).status_code

        assert [watch(one) for one in (greedy, below) * 3] == [200] * 4 + [429] * 2  # a fifth of half the connections
        assert watch(other) == 200


def test_uploads_are_budgeted_for_each_key_and_go_with_it(watched, store):
    owner, greedy = store.create("abandons", Scope.ADMIN), store.create("uploads", Scope.MAP)
    _, below = hand_on(watched, greedy, Scope.MAP)
    answers = [begin_upload(watched, one) for one in (greedy, below, greedy)]
    assert [one.status_code for one in answers] == [201, 201, 429]
    assert answers[2].json()["code"] == "quota_exceeded"
    listed = httpx.get(f"{watched.url}/v1/uploads", headers=bearer(owner)).json()["uploads"]
    assert [(one["map"], one["counted_to"]) for one in listed] == [("hall", "uploads")] * 2
    gone = httpx.delete(
        f"{watched.url}/v1/recordings/{listed[0]['id']}", headers={**bearer(owner), "Tus-Resumable": "1.0.0"}
    )
    assert gone.status_code == 204
    assert begin_upload(watched, greedy).status_code == 201
    httpx.delete(f"{watched.url}/v1/keys/uploads", headers=bearer(owner)).raise_for_status()
    assert httpx.get(f"{watched.url}/v1/uploads", headers=bearer(owner)).json()["uploads"] == []


def test_handed_on_keys_are_budgeted_for_each_key(watched, store, monkeypatch):
    monkeypatch.setattr("rholoc.service.access.keys._MAX_HANDED_BY", 2)
    greedy, other = store.create("hands on", Scope.MAP), store.create("hands on too", Scope.MAP)
    for _ in range(2):
        hand_on(watched, greedy, Scope.READ)
    answer = httpx.post(f"{watched.url}/v1/keys", json={"scope": "read"}, headers=bearer(greedy))
    assert (answer.status_code, answer.json()["code"]) == (429, "quota_exceeded")
    hand_on(watched, other, Scope.READ)
