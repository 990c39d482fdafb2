"""Clients that dribble, watch in crowds, and storage that fails: the others are answered."""

from __future__ import annotations

import asyncio
import errno
import shutil
import socket
import threading
import time

import httpx
import pytest
import sqlalchemy as sa
import uvicorn

from rholoc.errors import Conflict, UnknownJob
from rholoc.jobs import JobQueue, RecordingStore
from rholoc.service import Settings, create_app
from rholoc.service.connections import PatientProtocol
from rholoc.service.job_events import JobEvents

HEAD = b"PUT /v1/maps/room HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100000\r\n\r\n"


class Impatient(PatientProtocol):
    head_timeout_s = 0.3


@pytest.fixture
def impatient(tmp_path):
    settings = Settings(maps_dir=tmp_path / "maps", data_dir=tmp_path / "data", worker=False)
    listener = socket.create_server(("127.0.0.1", 0))
    server = uvicorn.Server(uvicorn.Config(create_app(settings), http=Impatient, log_level="error"))
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]}, daemon=True)
    thread.start()
    while not server.started:
        time.sleep(0.01)
    yield listener.getsockname()
    server.should_exit = True
    thread.join(10)


def closed(connection: socket.socket) -> bool:
    """Whether the other end closes, within the socket's timeout."""
    try:
        return connection.recv(1000) == b""
    except ConnectionError:
        return True


@pytest.mark.parametrize("beginning", [b"", b"GET /healthz HTTP/1.1\r\nHo"])
def test_a_connection_whose_request_does_not_come_is_closed(impatient, beginning):
    with socket.create_connection(impatient, timeout=20) as connection:
        connection.sendall(beginning)
        assert closed(connection)


def test_a_head_that_dribbles_does_not_live_by_its_last_byte(impatient):
    with socket.create_connection(impatient, timeout=20) as connection:
        with pytest.raises(ConnectionError):  # noqa: PT012
            for byte in b"GET /healthz HTTP/1.1\r\nHost: " + b"x" * 2000:
                connection.sendall(bytes([byte]))
                time.sleep(0.01)
        assert closed(connection)


def test_one_connection_serves_many_requests(impatient):
    with httpx.Client(base_url=f"http://{impatient[0]}:{impatient[1]}") as client:
        for _ in range(3):
            assert client.get("/healthz").is_success
            time.sleep(0.2)


def test_a_body_that_stops_coming_is_given_up(serve):
    running = serve(slow_client_timeout_s=0.3)
    with socket.create_connection(running.address, timeout=20) as connection:
        connection.sendall(HEAD + b"x" * 10)
        answer = connection.recv(5000)
    assert answer.startswith(b"HTTP/1.1 408")
    uploads = running.settings.data_dir / "uploads"
    deadline = time.monotonic() + 20
    while list(uploads.iterdir()):
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_a_body_that_trickles_is_given_up(serve):
    running = serve(slow_client_timeout_s=0.5)
    with socket.create_connection(running.address, timeout=0.05) as connection:
        connection.sendall(HEAD)
        answer = b""
        for _ in range(400):
            try:
                connection.sendall(b"x")
                answer = connection.recv(5000)
            except TimeoutError:
                continue
            except ConnectionError:
                break
            if answer:
                break
    assert answer.startswith(b"HTTP/1.1 408")


def test_a_job_is_looked_up_once_for_all_who_watch_it(tmp_path):
    class CountedQueue(JobQueue):
        looked = 0

        def get(self, job_id):
            self.looked += 1
            return super().get(job_id)

    queue = CountedQueue(tmp_path)
    job = queue.submit(RecordingStore(tmp_path).create([("walk.mp4", [b"x"])]).id, "room")
    before = queue.looked

    async def watch():
        events = JobEvents(queue)
        return await asyncio.gather(*(events.latest(job.id) for _ in range(200)))

    found = asyncio.run(watch())
    assert (queue.looked, len({event.id for event in found})) == (before + 1, 1)
    with pytest.raises(UnknownJob):
        asyncio.run(JobEvents(queue).latest("0" * 32))
    queue.close()


def test_a_job_that_has_ended_can_be_removed(serve):
    running = serve()
    files = {"file": ("walk.mp4", b"\0\0\0\x18ftypisom" + b"x" * 100)}
    job = httpx.post(f"{running.url}/v1/recordings", files=files, data={"map": "room"}).json()["job"]["id"]
    url = f"{running.url}/v1/jobs/{job}"
    assert httpx.delete(f"{url}?ended=true").json()["code"] == Conflict.code
    assert httpx.delete(url).json()["state"] == "cancelled"
    assert httpx.delete(url).json()["code"] == Conflict.code
    assert httpx.delete(f"{url}?ended=true").json()["state"] == "cancelled"
    assert httpx.get(url).json()["code"] == UnknownJob.code


def test_a_server_whose_disk_is_full_is_not_ready(serve, monkeypatch):
    running = serve()
    assert httpx.get(f"{running.url}/readyz").json()["checks"]["data"] == "ok"
    usage = shutil.disk_usage("/")
    monkeypatch.setattr("shutil.disk_usage", lambda _: usage._replace(free=1000))
    answer = httpx.get(f"{running.url}/readyz")
    assert (answer.status_code, answer.json()["checks"]["data"]) == (503, "the disk is full")


def test_maps_that_cannot_be_written_are_no_error_of_the_service(serve, picture_world, monkeypatch):
    running = serve()
    (running.settings.maps_dir / "room.rho").write_bytes(picture_world.rho())

    def read_only(*_args, **_options):
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr("pathlib.Path.unlink", read_only)
    answer = httpx.delete(f"{running.url}/v1/maps/room")
    monkeypatch.undo()
    assert (answer.status_code, answer.json()["code"]) == (503, "storage_unavailable")
    assert httpx.get(f"{running.url}/v1/maps/room").is_success


def test_a_database_that_is_damaged_is_no_error_of_the_service(serve, monkeypatch):
    running = serve()

    def damaged(*_args):
        raise sa.exc.DatabaseError("SELECT", {}, Exception("database disk image is malformed"))

    monkeypatch.setattr(JobQueue, "counts", damaged)
    monkeypatch.setattr(JobQueue, "list", damaged)
    listed = httpx.get(f"{running.url}/v1/jobs")
    assert (listed.status_code, listed.json()["code"]) == (503, "storage_unavailable")
    metrics = httpx.get(f"{running.url}/metrics")
    assert (metrics.status_code, "rholoc_request_seconds" in metrics.text) == (200, True)
    assert httpx.get(f"{running.url}/readyz").status_code == 503
