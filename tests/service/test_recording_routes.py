"""Recordings and jobs over HTTP, on the real store and queue; no worker runs."""

import json
from pathlib import Path

import httpx
import numpy as np
import pytest

from rholoc.library.recording_notes import notes_of
from rholoc.library.recordings import RecordingStore
from rholoc.recordings import MemoryFrames, Recording
from rholoc_client import Client, ServiceError

VIDEO = b"\0\0\0\x18ftypmp42" + b"\0" * 3_000_000


def upload(service, files, **fields):
    return httpx.post(service.url + "/v1/recordings", files=files, data={"map": "hall", **fields}, timeout=30)


def test_an_upload_becomes_a_recording_and_a_job(service):
    answer = upload(service, {"file": ("walk.mp4", VIDEO)}, features="lab", poses="visual", camera="500,500,320,240")
    assert answer.status_code == 202
    body = answer.json()
    job = body["job"]
    assert answer.headers["Location"] == f"/v1/jobs/{job['id']}"
    assert (job["map"], job["recording"], job["state"]) == ("hall", body["recording"], "queued")
    stored = RecordingStore(service.settings.data_dir).path(body["recording"])
    assert stored.name == "walk.mp4"
    assert stored.read_bytes() == VIDEO
    assert httpx.get(service.url + answer.headers["Location"]).json()["id"] == job["id"]
    assert job["id"] in [one["id"] for one in httpx.get(service.url + "/v1/jobs").json()["jobs"]]


def test_the_files_of_a_folder_keep_their_places(service):
    files = [
        ("file", ("frames/0001.jpg", b"\xff\xd8\xff1")),
        ("file", ("frames/0002.jpg", b"\xff\xd8\xff2")),
        ("file", ("imu.csv", b"3")),
    ]
    recording = upload(service, files).json()["recording"]
    entry = RecordingStore(service.settings.data_dir).get(recording)
    assert entry.files == ("frames/0001.jpg", "frames/0002.jpg", "imu.csv")


def test_waypoints_lie_beside_the_video(service):
    files = {"file": ("walk.mp4", VIDEO), "waypoints": ("measured on monday.csv", b"name,time,x,y,z\n")}
    recording = upload(service, files).json()["recording"]
    entry = RecordingStore(service.settings.data_dir).get(recording)
    assert entry.files == ("walk.mp4", "waypoints.csv")


def test_names_of_files_are_not_trusted(service):
    recording = upload(service, {"file": ("../../../etc/evil.mp4", VIDEO[:100])}).json()["recording"]
    stored = RecordingStore(service.settings.data_dir).path(recording).resolve()
    assert service.settings.data_dir.resolve() in stored.parents


def test_a_job_has_a_priority_while_it_waits(service):
    job = upload(service, {"file": ("walk.mp4", VIDEO)}, priority="low").json()["job"]
    assert (job["priority"], job["memory_bytes"], job["obstacle"]) == ("low", None, "no_worker")
    with Client(service.url) as client:
        assert client.prioritize_job(job["id"], "high").priority == "high"
        assert client.job(job["id"]).obstacle == "no_worker"
        assert client.cancel_job(job["id"]).obstacle is None
        with pytest.raises(ServiceError, match="no longer waits"):
            client.prioritize_job(job["id"], "low")
    refused = upload(service, {"file": ("walk.mp4", VIDEO)}, priority="highest")
    assert (refused.status_code, refused.json()["code"]) == (422, "invalid_request")


def test_a_job_is_cancelled_and_tried_again(service):
    url = service.url + "/v1/jobs/" + upload(service, {"file": ("walk.mp4", VIDEO)}).json()["job"]["id"]
    assert httpx.post(url + "/retry").json()["code"] == "conflict"
    assert httpx.delete(url).json()["state"] == "cancelled"
    assert httpx.delete(url).json()["code"] == "conflict"
    again = httpx.post(url + "/retry")
    assert again.status_code == 202
    assert again.json()["state"] == "queued"
    assert httpx.delete(url).json()["state"] == "cancelled"


def test_recordings_are_listed(service):
    recording = upload(service, {"file": ("walk.mp4", VIDEO)}).json()["recording"]
    (listed,) = [
        one for one in httpx.get(service.url + "/v1/recordings").json()["recordings"] if one["id"] == recording
    ]
    assert (listed["files"], listed["size_bytes"]) == (["walk.mp4"], len(VIDEO))


def test_a_job_is_watched_until_it_ends(service):
    url = service.url + "/v1/jobs/" + upload(service, {"file": ("walk.mp4", VIDEO)}).json()["job"]["id"]
    with httpx.stream("GET", url + "/events", timeout=30) as answer:
        assert answer.headers["Content-Type"].startswith("text/event-stream")
        lines = answer.iter_lines()
        first = event(lines)
        assert (first["event"], first["data"]["state"]) == ("job", "queued")
        httpx.delete(url)
        last = event(lines)
        assert last["data"] == httpx.get(url).json()
        assert last["data"]["state"] == "cancelled"
        assert list(lines) == []
    with httpx.stream("GET", url + "/events", headers={"Last-Event-ID": first["id"]}) as answer:
        assert event(answer.iter_lines()) == last, "what was missed is reported"
    assert httpx.get(url + "/events", headers={"Last-Event-ID": last["id"]}).status_code == 204
    assert httpx.get(f"{service.url}/v1/jobs/{'0' * 32}/events").json()["code"] == "unknown_job"


def test_a_job_that_is_tried_again_is_watched_as_it_is_now(service):
    """Watchers share one look at a job, but never that of a job that had ended."""
    url = service.url + "/v1/jobs/" + upload(service, {"file": ("walk.mp4", VIDEO)}).json()["job"]["id"]
    httpx.delete(url)
    for state, change in (("cancelled", lambda: httpx.post(url + "/retry")), ("queued", lambda: httpx.delete(url))):
        with httpx.stream("GET", url + "/events", timeout=30) as answer:
            assert event(answer.iter_lines())["data"]["state"] == state
        assert change().is_success


def event(lines):
    """The next server-sent event, its data read as JSON."""
    fields = {}
    for line in lines:
        if not line:
            return {**fields, "data": json.loads(fields["data"])}
        name, _, value = line.partition(": ")
        fields[name] = value
    raise AssertionError("the events ended")


def test_a_recording_is_corrected_and_mapped_again(service):
    recording = upload(service, {"file": ("walk.mp4", VIDEO)}).json()["recording"]
    url = f"{service.url}/v1/recordings/{recording}"
    fresh = httpx.get(url).json()
    assert (fresh["content"], fresh["thumbnail"], fresh["waypoints"], fresh["corrected"]) == (None, False, [], False)
    pictures = [np.full((90, 160, 3), 90, np.uint8)] * 60
    walk = Recording(MemoryFrames(pictures, 10.0), "walk", Path("walk"))
    RecordingStore(service.settings.data_dir).note(recording, notes_of(walk))
    noted = httpx.get(url).json()
    assert noted["content"] == {
        "length_s": 5.9, "frames": 60, "width": 160, "height": 90, "format": "rholoc", "imu": False,
    }  # fmt: skip
    assert httpx.get(f"{url}/thumbnail.jpg").content.startswith(b"\xff\xd8\xff")
    places = [[0, 0, 1.5], [2, 0, 1.5], [2, 3.5, 1.5]]
    given = [{"name": f"W{i}", "position": place, "time_s": 2.0 * i, "sigma_m": 0.02} for i, place in enumerate(places)]
    corrected = httpx.put(f"{url}/waypoints", json={"waypoints": given}).json()
    assert (corrected["waypoints"], corrected["corrected"]) == (given, True)
    for wrong in (given[:2], [*given[:2], {**given[2], "time_s": 6.5}], [{**given[0], "sigma_m": 7}, *given[1:]]):
        answer = httpx.put(f"{url}/waypoints", json={"waypoints": wrong})
        assert (answer.status_code, answer.json()["code"]) == (422, "invalid_waypoints")
    again = httpx.post(f"{url}/jobs", json={"map": "hall-2", "frames": "10:50", "features": "lab"})
    assert (again.status_code, again.json()["recording"], again.json()["map"]) == (202, recording, "hall-2")
    assert again.headers["Location"] == f"/v1/jobs/{again.json()['id']}"
    for wrong, code in (({"map": "../x"}, "invalid_name"), ({"map": "x", "frames": "a:b"}, "invalid_recording")):
        assert httpx.post(f"{url}/jobs", json=wrong).json()["code"] == code
    assert httpx.get(url).json()["waypoints"] == given
    assert httpx.delete(f"{url}/waypoints").json()["corrected"] is False
    nowhere = f"{service.url}/v1/recordings/{'0' * 32}"
    assert httpx.get(nowhere).json()["code"] == "unknown_recording"
    assert httpx.put(f"{nowhere}/waypoints", json={"waypoints": given}).json()["code"] == "unknown_recording"
