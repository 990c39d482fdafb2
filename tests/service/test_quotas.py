"""What keys may hold: counted whoever stores it and however, freed when it goes."""

import base64
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rholoc.service.access.keys import KeyLimits, KeyStore, Scope
from rholoc.service.settings import KeyPolicy
from rholoc.storage.database import open_database
from rholoc.storage.holdings_table import Holding, Holdings, Kind

VIDEO = b"\0\0\0\x18ftypmp42" + b"no frames" * 100
TUS = {"Tus-Resumable": "1.0.0"}


@dataclass
class Locked:
    """A service that wants keys, an administrator, and whoever else is made."""

    url: str
    store: KeyStore
    boss: httpx.Client

    def client(self, secret: str) -> httpx.Client:
        return httpx.Client(base_url=self.url, headers={"Authorization": f"Bearer {secret}"})

    def limited(self, name: str, **limits: int) -> httpx.Client:
        return self.client(self.store.create(name, Scope.ADMIN, limits=KeyLimits(**limits)))

    def used(self, name: str) -> dict[str, int]:
        return dict(self.boss.get(f"/v1/keys/{name}").json()["used"])


@pytest.fixture(scope="module")
def locked(serve: Any) -> Locked:
    running = serve(keys=KeyPolicy.ALWAYS)
    store = KeyStore(running.settings.data_dir)
    locked = Locked(running.url, store, httpx.Client())
    locked.boss = locked.client(store.create("boss", Scope.ADMIN))
    return locked


def send(client: httpx.Client, map_name: str) -> httpx.Response:
    return client.post("/v1/recordings", files={"file": ("walk.mp4", VIDEO)}, data={"map": map_name})


def begin(client: httpx.Client, map_name: str, length: int = len(VIDEO)) -> httpx.Response:
    named = (f"{name} {base64.b64encode(value.encode()).decode()}" for name, value in fields(map_name).items())
    return client.post(
        "/v1/recordings", headers={**TUS, "Upload-Length": str(length), "Upload-Metadata": ",".join(named)}
    )


def fields(map_name: str) -> dict[str, str]:
    return {"filename": "walk.mp4", "map": map_name}


def is_refused(answer: httpx.Response) -> bool:
    if answer.status_code != 429:
        return False
    assert answer.json()["code"] == "quota_exceeded"
    assert int(answer.headers["Retry-After"]) > 0
    return True


def test_maps_are_counted_until_they_are_deleted(locked: Locked, picture_world: Any) -> None:
    client, content = locked.limited("mapper", maps=1), picture_world.rho()
    assert client.put("/v1/maps/a", content=content).status_code == 201
    assert is_refused(client.put("/v1/maps/b", content=content))
    assert client.put("/v1/maps/a", content=content).status_code == 200
    assert client.patch("/v1/maps/a", json={"name": "c"}).status_code == 200
    assert is_refused(client.put("/v1/maps/b", content=content))
    assert is_refused(client.post("/v1/maps/c/merge", json={"other": "c", "into": "b"}))
    assert is_refused(send(client, "b"))
    assert locked.used("mapper") == {"maps": 1, "stored_bytes": len(content), "jobs": 0}
    assert client.delete("/v1/maps/c").status_code == 204
    assert client.put("/v1/maps/b", content=content).status_code == 201
    assert locked.boss.put("/v1/maps/free", content=content).status_code == 201


def test_a_map_that_another_key_replaces_is_that_ones(locked: Locked, picture_world: Any) -> None:
    one, other = locked.limited("one", maps=1), locked.limited("other", maps=1)
    assert one.put("/v1/maps/x", content=picture_world.rho()).status_code == 201
    assert other.put("/v1/maps/x", content=picture_world.rho()).status_code == 200
    assert (locked.used("one")["maps"], locked.used("other")["maps"]) == (0, 1)


def test_bytes_are_counted_of_maps_and_recordings(locked: Locked, picture_world: Any) -> None:
    content = picture_world.rho()
    client = locked.limited("hoarder", stored_bytes=len(content) + len(VIDEO) + 500)
    assert client.put("/v1/maps/y", content=content).status_code == 201
    assert client.put("/v1/maps/y", content=content).status_code == 200  # in place of the other
    assert is_refused(client.put("/v1/maps/z", content=content))
    begun = begin(client, "w")
    assert begun.status_code == 201, begun.text
    assert locked.used("hoarder")["stored_bytes"] == len(content) + len(VIDEO)
    assert is_refused(begin(client, "w"))
    assert is_refused(send(client, "w"))
    assert is_refused(
        client.put("/v1/maps/z", content=(piece for piece in [content]))
    )  # which does not say how long it is
    assert client.delete(begun.headers["Location"], headers=TUS).status_code == 204
    assert locked.used("hoarder")["stored_bytes"] == len(content)
    assert send(client, "w").status_code == 202


def test_jobs_are_counted_until_they_end(locked: Locked) -> None:
    client = locked.limited("impatient", jobs=1)
    first = send(client, "j1")
    assert first.status_code == 202
    job, recording = first.json()["job"]["id"], first.json()["recording"]
    again = f"/v1/recordings/{recording}/jobs"
    assert all(map(is_refused, (send(client, "j2"), begin(client, "j2"), client.post(again, json={"map": "j2"}))))
    assert client.delete(f"/v1/jobs/{job}").status_code == 200
    upload = begin(client, "j2")
    assert upload.status_code == 201
    assert locked.used("impatient")["jobs"] == 1
    assert is_refused(client.post(f"/v1/jobs/{job}/retry"))
    whole = {**TUS, "Upload-Offset": "0", "Content-Type": "application/offset+octet-stream"}
    assert client.patch(upload.headers["Location"], content=VIDEO, headers=whole).status_code == 204
    assert locked.used("impatient")["jobs"] == 1
    assert is_refused(client.post(again, json={"map": "j3"}))


def test_what_a_handed_key_stores_counts_to_the_one_that_handed_it_on(locked: Locked, picture_world: Any) -> None:
    client = locked.limited("parent", maps=1)
    wanted = {"scope": "map", "limits": {"maps": 5}}
    child = locked.client(client.post("/v1/keys", json=wanted).json()["key"])
    grandchild = locked.client(child.post("/v1/keys", json=wanted).json()["key"])
    assert grandchild.put("/v1/maps/of-child", content=picture_world.rho()).status_code == 201
    for one in (client, child, grandchild):
        assert is_refused(one.put("/v1/maps/more", content=picture_world.rho()))


def test_limits_are_set_and_lifted_by_a_route(locked: Locked, picture_world: Any) -> None:
    client = locked.client(locked.store.create("changed", Scope.MAP))
    path, content = "/v1/keys/changed/limits", picture_world.rho()
    shown = locked.boss.put(path, json={"maps": 0}).json()
    assert (shown["limits"]["maps"], shown["used"]["maps"]) == (0, 0)
    assert is_refused(client.put("/v1/maps/changed", content=content))
    assert client.put(path, json={}).status_code == 403
    assert locked.boss.put(path, json={}).json()["limits"]["maps"] is None
    assert client.put("/v1/maps/changed", content=content).status_code == 201
    for wrong in ({"maps": -1}, {"requests_per_s": 0}, {"bytes": 3}):
        assert locked.boss.put(path, json=wrong).json()["code"] == "invalid_request"
    for path in ("/v1/keys/nobody", "/v1/keys/nobody/limits"):
        answer = locked.boss.request("PUT" if path.endswith("limits") else "GET", path, json={})
        assert (answer.status_code, answer.json()["code"]) == (404, "not_found")


limits = st.builds(
    KeyLimits,
    *(st.none() | st.integers(0, 9) for _ in range(5)),
)


@given(one=limits, other=limits)
def test_within_is_the_lower_of_each(one: KeyLimits, other: KeyLimits) -> None:
    both = one.within(other)
    assert both == other.within(one) == both.within(one) == both.within(other)
    assert one.within(KeyLimits()) == one


def test_keys_of_earlier_releases_have_no_limits(tmp_path: Path) -> None:
    store = KeyStore(tmp_path)
    secret = store.create("old", Scope.READ)
    (file,) = (tmp_path / "keys").iterdir()
    stored = json.loads(file.read_text())
    file.write_text(json.dumps({name: stored[name] for name in ("name", "scope", "created", "expires")}))
    found = store.find(secret)
    assert (found.limits, found.holder) == (KeyLimits(), "")


def test_holdings_go_with_what_they_are_about(tmp_path: Path) -> None:
    holdings = Holdings(open_database(tmp_path))
    holdings.hold(Holding(Kind.MAP, "a", "one"))
    holdings.hold(Holding(Kind.MAP, "b", "handed", "one"))
    holdings.hold(Holding(Kind.RECORDING, "a", "two", "", 5))
    assert {one.name for one in holdings.of(["one"])} == {"a", "b"}
    gone = holdings.of(["one"])
    holdings.hold(Holding(Kind.MAP, "a", "two"))
    holdings.drop(gone)
    assert holdings.of(["one"]) == []
    holdings.rename(Kind.MAP, "a", "b")
    assert {(one.kind, one.name) for one in holdings.all()} == {(Kind.MAP, "b"), (Kind.RECORDING, "a")}
