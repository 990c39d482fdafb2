"""Resumable uploads as tus 1.0 has them, by a client of our own making, on the real store and queue."""

import base64
import hashlib
import io
import socket
import time
import zipfile
from unittest.mock import Mock

import httpx
import pytest

from rholoc.library.recordings import RecordingStore
from rholoc.storage.tables import uploads_table

VIDEO = b"\0\0\0\x18ftypmp42" + bytes(range(256)) * 8000
TUS = {"Tus-Resumable": "1.0.0"}


def b64(value) -> str:
    return base64.b64encode(value if isinstance(value, bytes) else value.encode()).decode()


def create(service, length, filename="walk.mp4", headers=None, **fields):
    metadata = {"filename": filename, "map": "hall", "filetype": "video/mp4", **fields}
    encoded = ",".join(f"{key} {b64(value)}" for key, value in metadata.items())
    headers = {**TUS, "Upload-Length": str(length), "Upload-Metadata": encoded, **(headers or {})}
    return httpx.post(service.url + "/v1/recordings", headers=headers)


def begun(service, length=len(VIDEO), **options) -> str:
    answer = create(service, length, **options)
    assert answer.status_code == 201, answer.text
    return service.url + answer.headers["Location"]


@pytest.mark.parametrize("value", ["filename \xe9", "filename a"])
def test_metadata_that_are_no_base64_are_refused(service, value):
    headers = {**TUS, "Upload-Length": "5", "Upload-Metadata": value.encode("latin-1")}
    answer = httpx.post(service.url + "/v1/recordings", headers=headers)
    assert (answer.status_code, answer.json()["code"]) == (422, "invalid_request")


def patch(url, offset, data, **headers):
    kind = {"Content-Type": "application/offset+octet-stream"}
    return httpx.patch(url, content=data, headers={**TUS, **kind, "Upload-Offset": str(offset), **headers})


def offset_at(url) -> int:
    answer = httpx.head(url, headers=TUS)
    assert answer.status_code == 200
    assert answer.headers["Cache-Control"] == "no-store"
    return int(answer.headers["Upload-Offset"])


def refused(answer, status, code):
    assert (answer.status_code, answer.json()["code"]) == (status, code), answer.text
    assert answer.json()["message"]


def stored(service, url):
    return RecordingStore(service.settings.data_dir).path(url.rsplit("/", 1)[1])


def touched(service, time_s):
    """Let all uploads have had their last byte at a time."""
    with service.app.state.rholoc.jobs.sync.engine.begin() as connection:
        connection.execute(uploads_table.update().values(touched=time_s))


def test_unfinished_uploads_have_a_limit(serve):
    running = serve(max_unfinished_uploads=2)
    first, _ = begun(running), begun(running)
    refused(create(running, 100), 503, "busy")
    assert httpx.delete(first, headers=TUS).status_code == 204
    second = begun(running)
    refused(create(running, 100), 503, "busy")
    assert patch(second, 0, VIDEO).status_code == 204  # whole: it counts no more
    begun(running)


def test_expired_uploads_make_room(serve):
    running = serve(max_unfinished_uploads=1, upload_expires_s=1000)
    begun(running)
    touched(running, 0.0)
    begun(running)


def test_the_server_tells_what_it_can(service):
    answer = httpx.options(service.url + "/v1/recordings")
    assert answer.status_code == 204
    assert (answer.headers["Tus-Version"], answer.headers["Tus-Resumable"]) == ("1.0.0", "1.0.0")
    assert set(answer.headers["Tus-Extension"].split(",")) == {"creation", "expiration", "checksum", "termination"}
    assert "sha1" in answer.headers["Tus-Checksum-Algorithm"].split(",")
    assert int(answer.headers["Tus-Max-Size"]) == service.settings.max_upload_bytes


def test_pieces_become_a_recording_and_a_job(service):
    url = begun(service, features="lab", kind="build")
    assert offset_at(url) == 0
    for start in range(0, len(VIDEO), 600_000):
        answer = patch(url, start, VIDEO[start : start + 600_000])
        assert answer.status_code == 204
        assert answer.headers["Tus-Resumable"] == "1.0.0"
        assert int(answer.headers["Upload-Offset"]) == min(start + 600_000, len(VIDEO))
    job = httpx.get(f"{service.url}/v1/jobs/{answer.headers['Rholoc-Job']}").json()
    assert (job["map"], job["state"], job["recording"]) == ("hall", "queued", url.rsplit("/", 1)[1])
    assert stored(service, url).name == "walk.mp4"
    assert stored(service, url).read_bytes() == VIDEO
    assert offset_at(url) == len(VIDEO)
    assert httpx.head(url, headers=TUS).headers["Rholoc-Job"] == job["id"]
    refused(patch(url, 0, b"x"), 409, "conflict")
    refused(httpx.delete(url, headers=TUS), 409, "conflict")
    httpx.delete(f"{service.url}/v1/jobs/{job['id']}")
    assert httpx.delete(url, headers=TUS).status_code == 204
    refused(httpx.delete(url, headers=TUS), 404, "unknown_recording")


def test_what_came_before_the_connection_broke_is_kept(service):
    url = begun(service)
    host, port = service.address
    head = (
        f"PATCH {httpx.URL(url).path} HTTP/1.1\r\nHost: {host}:{port}\r\nTus-Resumable: 1.0.0\r\nUpload-Offset: 0\r\n"
        f"Content-Type: application/offset+octet-stream\r\nContent-Length: {len(VIDEO)}\r\n\r\n"
    )
    with socket.create_connection(service.address) as connection:
        connection.sendall(head.encode() + VIDEO[:300_000])
    deadline = time.monotonic() + 60
    while offset_at(url) < 300_000:
        assert time.monotonic() < deadline
    assert patch(url, 300_000, VIDEO[300_000:]).status_code == 204
    assert stored(service, url).read_bytes() == VIDEO


@pytest.mark.parametrize("algorithm", ["sha256", "sha1", "md5"])
def test_a_piece_with_a_checksum_is_kept_whole_or_not_at_all(service, algorithm):
    url = begun(service)
    digest = b64(hashlib.new(algorithm, VIDEO[:1000]).digest())
    refused(patch(url, 0, VIDEO[1:1001], **{"Upload-Checksum": f"{algorithm} {digest}"}), 460, "checksum_mismatch")
    assert offset_at(url) == 0
    assert patch(url, 0, VIDEO[:1000], **{"Upload-Checksum": f"{algorithm} {digest}"}).status_code == 204
    assert offset_at(url) == 1000
    for wrong in ("crc32 AAAA", f"{algorithm} !", algorithm.upper()):
        refused(patch(url, 1000, b"x", **{"Upload-Checksum": wrong}), 422, "invalid_request")


def test_a_wrong_offset_changes_nothing(service):
    url = begun(service)
    assert patch(url, 0, VIDEO[:5000]).status_code == 204
    for offset in (0, 4999, 5001):
        refused(patch(url, offset, b"xyz"), 409, "conflict")
    for offset in ("", "-1", "5e3", "9" * 30):
        refused(patch(url, offset, b"xyz"), 422, "invalid_request")
    assert offset_at(url) == 5000
    refused(patch(url, 5000, VIDEO + b"more"), 413, "too_large")


def test_requests_that_are_not_tus(service):
    url = begun(service)
    wrong_type = httpx.patch(url, content=b"x", headers={**TUS, "Upload-Offset": "0"})
    refused(wrong_type, 415, "unsupported_media_type")
    newer = httpx.head(url, headers={"Tus-Resumable": "2.0.0"})
    assert newer.status_code == 412
    assert newer.headers["Tus-Version"] == "1.0.0"
    refused(create(service, 10, headers={"Tus-Resumable": "0.2.2"}), 412, "unsupported_version")


def test_a_proxy_that_knows_no_patch(service):
    url = begun(service)
    headers = {**TUS, "X-HTTP-Method-Override": "PATCH", "Content-Type": "application/offset+octet-stream"}
    answer = httpx.post(url, content=VIDEO[:100], headers={**headers, "Upload-Offset": "0"})
    assert (answer.status_code, answer.headers["Upload-Offset"]) == (204, "100")


@pytest.mark.parametrize(
    ("length", "filename", "fields", "status", "code"),
    [
        (0, "walk.mp4", {}, 422, "invalid_recording"),
        (10 * 2**30, "walk.mp4", {}, 413, "too_large"),
        ("", "walk.mp4", {}, 422, "invalid_request"),
        ("-5", "walk.mp4", {}, 422, "invalid_request"),
        (100, "..", {}, 422, "invalid_recording"),
        (100, "walk.exe", {}, 422, "invalid_recording"),
        (100, "imu.csv", {}, 422, "invalid_recording"),
        (100, "walk.mp4", {"map": "../x"}, 422, "invalid_name"),
        (100, "walk.mp4", {"features": "magic"}, 422, "invalid_input"),
        (100, "walk.mp4", {"poses": "magic"}, 422, "invalid_request"),
        (100, "walk.mp4", {"map": "attic", "kind": "update"}, 404, "unknown_map"),
        (100, "walk.mp4", {"map": b"\xff"}, 422, "invalid_request"),
    ],
)
def test_uploads_that_are_refused_before_a_byte_is_sent(service, length, filename, fields, status, code):
    before = sorted((service.settings.data_dir / "recordings").iterdir())
    refused(create(service, length, filename, **fields), status, code)
    assert sorted((service.settings.data_dir / "recordings").iterdir()) == before


def test_a_name_does_not_lead_out_of_the_folder(service):
    url = begun(service, filename="../../../etc/walk.mp4")
    assert patch(url, 0, VIDEO).status_code == 204
    assert stored(service, url).name == "walk.mp4"
    assert service.settings.data_dir.resolve() in stored(service, url).resolve().parents


def packed(*entries) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for entry, content in entries:
            archive.writestr(entry, content)
    return buffer.getvalue()


def link(name) -> zipfile.ZipInfo:
    entry = zipfile.ZipInfo(name)
    entry.external_attr = 0o120777 << 16
    return entry


BAD_FILES = {
    "bomb": ("walk.zip", packed(("frames/0001.jpg", b"\0" * 30_000_000)), 413, "too_large"),
    "traversal": ("walk.zip", packed(("../../evil", b"x")), 422, "invalid_recording"),
    "link": ("walk.zip", packed((link("video.mp4"), b"/etc/passwd")), 422, "invalid_recording"),
    "cut": ("walk.zip", packed(("imu.csv", b"timestamp\n" * 100))[:-40], 422, "invalid_recording"),
    "text": ("walk.mp4", b"this is a text and no video", 422, "invalid_recording"),
    "picture": ("walk.mp4", b"\x89PNG\r\n\x1a\n" + b"\0" * 100, 422, "invalid_recording"),
    "no zip": ("walk.zip", VIDEO[:1000], 422, "invalid_recording"),
    "tiny": ("walk.mp4", b"x", 422, "invalid_recording"),
}


@pytest.mark.parametrize("way", ["plain", "resumable"])
@pytest.mark.parametrize("bad", BAD_FILES)
def test_files_that_are_no_recordings_are_refused_and_removed(service, bad, way):
    filename, content, status, code = BAD_FILES[bad]
    folder = service.settings.data_dir / "recordings"
    before = sorted(folder.iterdir())
    if way == "plain":
        files = {"file": (filename, content)}
        answer = httpx.post(service.url + "/v1/recordings", files=files, data={"map": "hall"})
    else:
        answer = patch(begun(service, len(content), filename=filename), 0, content)
    refused(answer, status, code)
    assert sorted(folder.iterdir()) == before


def test_a_wrong_type_is_refused_with_its_first_bytes(service):
    url = begun(service, filename="walk.webm")
    refused(patch(url, 0, b"<html><body>not found"), 422, "invalid_recording")
    assert httpx.head(url, headers=TUS).status_code == 404


def test_unknown_uploads(service):
    for name in ("0" * 32, "nonsense", "..%2f..", ".pending-x"):
        url = f"{service.url}/v1/recordings/{name}"
        assert httpx.head(url, headers=TUS).status_code == 404
        assert patch(url, 0, b"x").status_code == 404
        assert httpx.delete(url, headers=TUS).status_code == 404


def test_an_unfinished_upload_expires(service):
    url = begun(service)
    assert patch(url, 0, VIDEO[:1000]).headers["Upload-Expires"].endswith(" GMT")
    folder = service.settings.data_dir / "uploads" / url.rsplit("/", 1)[1]
    assert folder.exists()
    touched(service, time.time() - service.settings.upload_expires_s - 10)
    service.app.state.rholoc.recordings.uploads.sweep()
    assert not folder.exists()
    assert httpx.head(url, headers=TUS).status_code == 404


def test_an_upload_can_be_given_up(service):
    url = begun(service)
    assert httpx.delete(url, headers=TUS).status_code == 204
    assert httpx.head(url, headers=TUS).status_code == 404


def test_a_server_that_died_after_the_last_byte_queues_the_job_when_asked(service, monkeypatch):
    url = begun(service)
    with monkeypatch.context() as dead:
        dead.setattr(service.app.state.rholoc.jobs.sync, "submit", Mock(side_effect=OSError("killed")))
        patch(url, 0, VIDEO)
    answer = httpx.head(url, headers=TUS)
    assert int(answer.headers["Upload-Offset"]) == len(VIDEO)
    jobs = [job for job in httpx.get(service.url + "/v1/jobs").json()["jobs"] if url.endswith(job["recording"])]
    assert [job["id"] for job in jobs] == [answer.headers["Rholoc-Job"]]
