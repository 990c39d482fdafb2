"""Recordings and jobs over HTTP, on the real store and queue; no worker runs."""

from __future__ import annotations

import json

import httpx

from rholoc.jobs import RecordingStore

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
