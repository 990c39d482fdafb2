"""Maps that learn and forget over HTTP. No worker runs: what a worker does with an update is tested with the jobs."""

from __future__ import annotations

import httpx
import numpy as np
import pytest

from rholoc.jobs import JobKind
from rholoc.jobs.leases import Leases
from rholoc.maps import load_map, save_map


@pytest.fixture(scope="module")
def learner(serve, point_room, picture_world):
    """A service with the maps ``west`` and ``east``, which overlap, and ``old``, which remembers nothing."""
    running = serve()
    walk = point_room.walk(80)
    for name, poses in (("west", walk[:45]), ("east", walk[25:65])):
        save_map(point_room.map_of(poses, name), running.settings.maps_dir / f"{name}.rho")
    (running.settings.maps_dir / "old.rho").write_bytes(picture_world.rho())
    return running


def post(service, path, body):
    return httpx.post(f"{service.url}/v1/maps/{path}", json=body, timeout=60)


def uploaded(service, **fields):
    fields = {"map": "west", **fields}
    return httpx.post(
        service.url + "/v1/recordings", files={"file": ("walk.mp4", b"\0\0\0\x18ftypmp42")}, data=fields, timeout=30
    )


def test_maps_are_merged_and_forget(learner):
    merged = post(learner, "west/merge", {"other": "east", "into": "both"})
    assert merged.status_code == 200, merged.text
    assert [source["name"] for source in merged.json()["sources"]] == ["west", "east"]
    assert merged.json()["version"] == 2
    before = load_map(learner.settings.maps_dir / "west.rho")
    left = post(learner, "both/forget", {"source": "east"}).json()
    assert (left["version"], left["id"]) == (3, merged.json()["id"])
    assert [source["name"] for source in left["sources"]] == ["west"]
    stored = load_map(learner.settings.maps_dir / "both.rho")
    np.testing.assert_allclose(stored.landmarks.positions, before.landmarks.positions, rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("path", "body", "status", "code"),
    [
        ("west/forget", {"source": "attic"}, 422, "invalid_input"),
        ("west/forget", {"source": "west"}, 409, "conflict"),
        ("west/forget", {}, 422, "invalid_request"),
        ("nowhere/forget", {"source": "west"}, 404, "unknown_map"),
        ("old/forget", {"source": "walk"}, 422, "invalid_input"),
        ("west/merge", {"other": "nowhere", "into": "both"}, 404, "unknown_map"),
        ("west/merge", {"other": "east", "into": "../both"}, 422, "invalid_name"),
        ("west/merge", {"other": "west", "into": "twice"}, 409, "conflict"),
        ("west/merge", {"other": "old", "into": "twice"}, 422, "invalid_input"),
        ("west/update", {"recording": "0" * 32}, 404, "unknown_recording"),
        ("nowhere/update", {"recording": "0" * 32}, 404, "unknown_map"),
        ("old/update", {"recording": "0" * 32}, 422, "invalid_input"),
        ("west/update", {"recording": "0" * 32, "poses": "guessed"}, 422, "invalid_request"),
    ],
)
def test_what_does_not_fit_is_refused_and_changes_nothing(learner, path, body, status, code):
    files = {file.name: file.read_bytes() for file in learner.settings.maps_dir.glob("*.rho")}
    answer = post(learner, path, body)
    assert (answer.status_code, answer.json()["code"]) == (status, code), answer.text
    assert answer.json()["message"]
    assert {file.name: file.read_bytes() for file in learner.settings.maps_dir.glob("*.rho")} == files


def test_an_update_is_a_job(learner):
    first = uploaded(learner, kind="update").json()
    again = post(learner, "west/update", {"recording": first["recording"], "poses": "visual", "camera": "1,2,3,4"})
    assert again.status_code == 202
    job = again.json()
    assert again.headers["Location"] == f"/v1/jobs/{job['id']}"
    assert (job["map"], job["recording"], job["state"]) == ("west", first["recording"], "queued")
    leases = Leases(learner.app.state.rholoc.jobs.sync.engine)
    works = [leases.take("somebody").work for _ in (first["job"], job)]
    assert [work.options.kind for work in works] == [JobKind.UPDATE, JobKind.UPDATE]
    assert [work.options.poses for work in works] == [None, "visual"]


def test_an_upload_that_no_map_could_learn_is_refused(learner):
    assert uploaded(learner, kind="update", map="nowhere").json()["code"] == "unknown_map"
    assert uploaded(learner, kind="update", map="old").json()["code"] == "invalid_input"
    assert uploaded(learner, kind="improve").json()["code"] == "invalid_request"
