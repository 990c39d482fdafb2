"""Clients that dribble, watch in crowds, and storage that fails: the others are answered."""

import asyncio
import errno
import shutil
import socket
import sqlite3
import threading
import time
from contextlib import ExitStack, closing, contextmanager
from typing import BinaryIO

import httpx
import pytest
import sqlalchemy as sa
import uvicorn

from rholoc.errors import Busy, Conflict, UnknownJob
from rholoc.jobs import JobQueue
from rholoc.library.recordings import RecordingStore
from rholoc.service import Settings, create_app
from rholoc.service.http.bodies import HeldBodies
from rholoc.service.http.connections import PatientProtocol, protocol_of
from rholoc.service.http.metrics import Metrics
from rholoc.service.maps.job_events import JobEvents
from rholoc.service.threads.storage import StorageThreads
from rholoc_client import Client

HEAD = b"PUT /v1/maps/room HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100000\r\n\r\n"


class Impatient(PatientProtocol):
    head_timeout_s = 0.3


@contextmanager
def answering(folder, protocol):
    """The address of a service that speaks a protocol."""
    settings = Settings(maps_dir=folder / "maps", data_dir=folder / "data", worker=False)
    listener = socket.create_server(("127.0.0.1", 0))
    server = uvicorn.Server(uvicorn.Config(create_app(settings), http=protocol, log_level="error"))
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]}, daemon=True)
    thread.start()
    while not server.started:
        time.sleep(0.01)
    yield listener.getsockname()
    server.should_exit = True
    thread.join(60)


@pytest.fixture
def impatient(tmp_path):
    with answering(tmp_path, Impatient) as address:
        yield address


@pytest.fixture
def crowded(tmp_path):
    protocol = protocol_of(max_connections=5)
    protocol.head_timeout_s = 3.0
    with answering(tmp_path, protocol) as address:
        yield address


def closed(connection: socket.socket) -> bool:
    """Whether the other end closes, within the socket's timeout."""
    try:
        return connection.recv(1000) == b""
    except ConnectionError:
        return True


@pytest.mark.parametrize("beginning", [b"", b"GET /healthz HTTP/1.1\r\nHo"])
def test_a_connection_whose_request_does_not_come_is_closed(impatient, beginning):
    with socket.create_connection(impatient, timeout=60) as connection:
        connection.sendall(beginning)
        assert closed(connection)


def test_a_head_that_dribbles_does_not_live_by_its_last_byte(impatient):
    with socket.create_connection(impatient, timeout=60) as connection:
        with pytest.raises(ConnectionError):  # noqa: PT012
            for byte in b"GET /healthz HTTP/1.1\r\nHost: " + b"x" * 2000:
                connection.sendall(bytes([byte]))
                time.sleep(0.01)
        assert closed(connection)


def test_the_time_for_a_head_ends_with_it(tmp_path):
    armed = []

    class Watched(PatientProtocol):
        head_timeout_s = 1000.0

        def _watch_head(self):
            super()._watch_head()
            armed.append(self._giving_up is not None)

    with answering(tmp_path, Watched) as (host, port), httpx.Client(base_url=f"http://{host}:{port}") as client:
        for _ in range(3):
            assert client.get("/healthz").is_success
    assert armed == [True, False, False, False]


def test_of_too_many_connections_the_one_that_waits_longest_makes_room(crowded, monkeypatch):
    monkeypatch.setattr("rholoc.service.http.connections._YOUNG_S", 0.0)
    with ExitStack() as stack:
        idle = [stack.enter_context(socket.create_connection(crowded, timeout=60)) for _ in range(5)]
        for _ in range(3):
            assert httpx.get(f"http://{crowded[0]}:{crowded[1]}/healthz", timeout=60).is_success
        assert closed(idle[0])
        idle[-1].sendall(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
        assert idle[-1].recv(5000).startswith(b"HTTP/1.1 200")


def test_a_connection_beyond_those_that_are_busy_is_refused_with_a_reason(crowded):
    with ExitStack() as stack:
        busy = [stack.enter_context(socket.create_connection(crowded, timeout=60)) for _ in range(5)]
        for connection in busy:  # a request whose body is on its way is not given up for another
            connection.sendall(HEAD.replace(b"\r\n\r\n", b"\r\nExpect: 100-continue\r\n\r\n"))
            assert connection.recv(1000).startswith(b"HTTP/1.1 100")
        url = f"http://{crowded[0]}:{crowded[1]}"
        answer = httpx.get(f"{url}/v1/maps", timeout=60)
        assert httpx.get(f"{url}/healthz", timeout=60).status_code == 200  # there is room for probes
        silent = [stack.enter_context(socket.create_connection(crowded, timeout=60)) for _ in range(40)]
        assert httpx.get(f"{url}/readyz", timeout=60).status_code == 200
        assert closed(silent[0])
    assert (answer.status_code, answer.json()["code"]) == (503, "busy")
    assert int(answer.headers["Retry-After"]) >= 1


def test_a_client_that_reads_nothing_is_disconnected(tmp_path):
    class Brief(PatientProtocol):
        stalled_reader_s = 0.5

    with answering(tmp_path, Brief) as address, socket.create_connection(address, timeout=60) as connection:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        with pytest.raises(ConnectionError):  # noqa: PT012
            for _ in range(5000):  # pipelined: none of the answers is read
                connection.sendall(b"GET /openapi.json HTTP/1.1\r\nHost: localhost\r\n\r\n")
                time.sleep(0.002)


def test_large_bodies_are_held_within_a_bound():
    held = HeldBodies(max_bytes=100, free_bytes=10)
    with held.hold() as first, held.hold() as second, held.hold() as third:
        for _ in range(11):
            first(b"x" * 10)
        with pytest.raises(Busy):
            second(b"x" * 11)
        third(b"x" * 10)  # as ordinary frames have
    with held.hold() as again:
        again(b"x" * 110)
        with pytest.raises(Busy):
            again(b"x")


def test_large_frames_are_refused_while_as_many_as_may_be_are_on_their_way(serve, picture_world):
    running = serve(max_request_bytes=2**21)
    (running.settings.maps_dir / "room.rho").write_bytes(picture_world.rho())
    head = b"POST /v1/maps/room/localize HTTP/1.1\r\nHost: localhost\r\nContent-Type: image/png\r\n"
    url, png = f"{running.url}/v1/maps/room/localize?dof=6", {"Content-Type": "image/png"}
    large = b"\x89PNG\r\n\x1a\n".ljust(2**21, b"x")
    with ExitStack() as stack:
        for _ in range(16):  # each has sent a mebibyte more than is free
            connection = stack.enter_context(socket.create_connection(running.address, timeout=60))
            connection.sendall(head + b"Content-Length: %d\r\n\r\n" % len(large) + large[:-1])
        held = running.app.state.rholoc.held_bodies
        deadline = time.monotonic() + 60
        while held._left > 100:
            assert time.monotonic() < deadline
            time.sleep(0.01)
        refused = httpx.post(url, content=large, headers=png, timeout=60)
        assert (refused.status_code, refused.json()["code"]) == (503, "busy")
        assert httpx.post(url, content=picture_world.png(), headers=png, timeout=60).json()["localized"]
    while held._left < 8 * 2**21:
        assert time.monotonic() < deadline
        time.sleep(0.01)


REFUSED_EARLY = {
    "image/jpeg": (b"P3 3000 3000 255 " + b"9 " * 1000, b"422"),
    "application/json": (b'{"features":{"pixels":[' + b"1," * 60_000, b"413"),
}


@pytest.mark.parametrize("kind", REFUSED_EARLY)
def test_a_body_is_refused_by_how_it_begins(serve, picture_world, kind):
    running = serve()
    (running.settings.maps_dir / "room.rho").write_bytes(picture_world.rho())
    start, status = REFUSED_EARLY[kind]
    head = f"POST /v1/maps/room/localize HTTP/1.1\r\nHost: localhost\r\nContent-Type: {kind}\r\n".encode()
    with socket.create_connection(running.address, timeout=60) as connection:
        connection.sendall(head + b"Content-Length: 5000000\r\n\r\n" + start)
        assert connection.recv(12).endswith(status)


@pytest.mark.slow
def test_what_comes_of_a_body_that_was_refused_is_read_slowly_and_the_connection_goes_on(tmp_path):
    with answering(tmp_path, PatientProtocol) as address, socket.create_connection(address, timeout=60) as connection:
        body = b"x" * 10**6
        head = b"PUT /v1/cameras/a HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
        connection.sendall(head + b"Content-Length: %d\r\n\r\n" % len(body))
        with connection.makefile("rb") as answers:
            assert _answer(answers).startswith(b"HTTP/1.1 413")
            connection.sendall(body + b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n")
            assert _answer(answers).startswith(b"HTTP/1.1 200")


def _answer(answers: BinaryIO) -> bytes:
    """The status line of the next answer, which is read to its end: it may come in pieces."""
    status, length = answers.readline(), 0
    while (line := answers.readline().lower()) not in (b"\r\n", b""):
        if line.startswith(b"content-length:"):
            length = int(line.split(b":")[1])
    answers.read(length)
    return status


def test_a_body_that_stops_coming_is_given_up(serve):
    running = serve(slow_client_timeout_s=0.3)
    with socket.create_connection(running.address, timeout=60) as connection:
        connection.sendall(HEAD + b"x" * 10)
        answer = connection.recv(5000)
    assert answer.startswith(b"HTTP/1.1 408")
    uploads = running.settings.data_dir / "uploads"
    deadline = time.monotonic() + 60
    while list(uploads.iterdir()):
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_a_body_that_trickles_is_given_up(serve):
    running = serve(slow_client_timeout_s=0.5)
    with socket.create_connection(running.address, timeout=0.05) as connection:
        connection.sendall(HEAD)
        answer, reset = b"", False
        for _ in range(1200):
            try:
                connection.sendall(b"x")
                answer = connection.recv(5000)
            except TimeoutError:
                continue
            except ConnectionError:  # our next byte crossed the answer, which is lost with it
                reset = True
            if answer or reset:
                break
    assert reset or answer.startswith(b"HTTP/1.1 408")


def test_a_job_is_looked_up_once_for_all_who_watch_it(tmp_path):
    class CountedQueue(JobQueue):
        looked = 0

        def get(self, job_id):
            self.looked += 1
            return super().get(job_id)

    recordings = RecordingStore(tmp_path)
    queue = CountedQueue(recordings)
    job = queue.submit(recordings.create([("walk.mp4", [b"x"])]).id, "room")
    before = queue.looked

    async def watch():
        events = JobEvents(queue, StorageThreads(4, 60.0))
        return await asyncio.gather(*(events.latest(job.id) for _ in range(200)))

    found = asyncio.run(watch())
    assert (queue.looked, len({event.id for event in found})) == (before + 1, 1)
    with pytest.raises(UnknownJob):
        asyncio.run(JobEvents(queue, StorageThreads(4, 60.0)).latest("0" * 32))
    queue.close()


def test_jobs_are_listed_a_page_at_a_time(serve):
    running = serve()
    state = running.app.state.rholoc
    recording = state.recordings.sync.create([("walk.mp4", [b"x"])]).id
    ids = [state.jobs.sync.submit(recording, "room").id for _ in range(5)][::-1]
    url = f"{running.url}/v1/jobs"
    assert [job["id"] for job in httpx.get(url).json()["jobs"]] == ids
    pages, before = [], None
    while True:
        page = httpx.get(url, params={"limit": 2} | ({"before": before} if before else {})).json()
        pages.append([job["id"] for job in page["jobs"]])
        before = pages[-1][-1]
        if not page["more"]:
            break
    assert pages == [ids[:2], ids[2:4], ids[4:]]
    with Client(running.url) as client:
        assert [job.id for job in client.jobs(before=ids[2])] == ids[3:]
    assert httpx.get(f"{url}?before={'0' * 32}").json()["code"] == UnknownJob.code
    for limit in (0, 501):
        assert httpx.get(f"{url}?limit={limit}").json()["code"] == "invalid_request"


def test_a_database_that_is_locked_is_no_error_of_the_service(serve, monkeypatch):
    monkeypatch.setattr("rholoc.storage.database._BUSY_TIMEOUT_MS", 100)
    running = serve()
    files = {"file": ("walk.mp4", b"\0\0\0\x18ftypisom" + b"x" * 100)}
    with closing(sqlite3.connect(running.settings.data_dir / "jobs.sqlite", isolation_level=None)) as other:
        other.execute("BEGIN EXCLUSIVE")
        refused = httpx.post(f"{running.url}/v1/recordings", files=files, data={"map": "room"}, timeout=120)
        assert (refused.status_code, refused.json()["code"]) == (503, "storage_unavailable")
        assert httpx.get(f"{running.url}/v1/recordings").json()["recordings"] == []
        assert httpx.get(f"{running.url}/healthz").is_success
        other.execute("ROLLBACK")
    assert httpx.post(f"{running.url}/v1/recordings", files=files, data={"map": "room"}).status_code == 202


def test_metrics_are_made_once_for_all_who_ask_at_a_time(monkeypatch):
    made = []
    monkeypatch.setattr("rholoc.service.http.metrics.generate_latest", lambda _: made.append(1) or b"text")
    monkeypatch.setattr("rholoc.service.http.metrics._KEPT_S", 1000.0)
    metrics = Metrics()
    assert {metrics.text() for _ in range(20)} == {b"text"}
    assert len(made) == 1


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
    def damaged(*_args):
        raise sa.exc.DatabaseError("SELECT", {}, Exception("database disk image is malformed"))

    monkeypatch.setattr(JobQueue, "counts", damaged)
    monkeypatch.setattr(JobQueue, "list", damaged)
    running = serve()
    listed = httpx.get(f"{running.url}/v1/jobs")
    assert (listed.status_code, listed.json()["code"]) == (503, "storage_unavailable")
    metrics = httpx.get(f"{running.url}/metrics")
    assert (metrics.status_code, "rholoc_request_seconds" in metrics.text) == (200, True)
    assert httpx.get(f"{running.url}/readyz").status_code == 503
