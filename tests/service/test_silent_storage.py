"""A database or a storage that is silent: connections stay open, and nothing answers."""

import asyncio
import os
import statistics
import sys
import tempfile
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import httpx
import obstore
import pytest
import sqlalchemy as sa

from postgres_server import PostgresServer
from rholoc.errors import StorageUnavailable
from rholoc.service.housekeeping import clean_up_regularly
from rholoc.service.threads.storage import StorageThreads
from waiting import until

PNG = {"Content-Type": "image/png"}
_BOUND_S = 12.0  # of any answer while the database is silent
_BURST_S = 0.02
_ROUTES = (
    ("GET", "/v1/maps"),
    ("GET", "/v1/maps/room"),
    ("GET", "/v1/maps/room/versions"),
    ("GET", "/v1/maps/room/report"),
    ("GET", "/v1/maps/room/live"),
    ("GET", "/v1/maps/nosuch/live"),
    ("POST", "/v1/maps/nosuch/localize"),
    ("GET", "/v1/maps/nosuch/download"),
    ("GET", "/v1/recordings"),
    ("GET", "/v1/cameras"),
    ("GET", "/v1/sites"),
    ("GET", "/v1/audit"),
    ("GET", "/v1/jobs"),
    ("GET", f"/v1/jobs/{'0' * 32}/events"),
    ("DELETE", "/v1/maps/room"),
    ("PUT", "/v1/cameras/phone"),
)


@pytest.fixture(scope="module")
def own_postgres() -> Iterator[PostgresServer]:
    """A PostgreSQL that this module may stop."""
    server = PostgresServer()
    yield server
    server.close()


@pytest.fixture
def urls(own_postgres, tmp_path):
    return {
        "database_url": own_postgres.create_database(f"test_{uuid.uuid4().hex}"),
        "storage_url": f"file://{tmp_path}/storage",
    }


@pytest.fixture
def silenced(own_postgres) -> Iterator[PostgresServer]:
    """It is silent from the call of ``silence`` to the end of the test."""
    yield own_postgres
    own_postgres.resume()


@dataclass
class Loop:
    """A service's event loop, and what its own thread asked disks, databases and storages for."""

    loop: asyncio.AbstractEventLoop
    thread: int
    asked: list[str] = field(default_factory=list)


_WATCHED: dict[int, Loop] = {}  # by thread
_OF_PATHS = {"open", "os.listdir", "os.scandir", "os.mkdir", "os.rename", "os.remove", "os.rmdir", "os.link"}
_OTHERS = {"fcntl.flock", "sqlite3.connect", "socket.connect", "time.sleep"}


def _note(text: str) -> None:
    watched = _WATCHED.get(threading.get_ident())
    if watched is not None:
        watched.asked.append(text)


def _hear(event: str, args: tuple[object, ...]) -> None:
    if _WATCHED and (event in _OTHERS or (event in _OF_PATHS and _is_of_the_service(args[0]))):
        _note(f"{event} {args[0]}")


def _is_of_the_service(path: object) -> bool:
    """Whether a path is in its folders: Python itself reads sources, for tracebacks."""
    return isinstance(path, str | os.PathLike) and str(path).startswith(tempfile.gettempdir())


sys.addaudithook(_hear)


@pytest.fixture
def loops(monkeypatch) -> Iterator[list[Loop]]:
    """The event loops of the services that are started, watched from their first request on."""
    found: list[Loop] = []

    async def noting(state):
        found.append(Loop(asyncio.get_running_loop(), threading.get_ident()))
        _WATCHED[found[-1].thread] = found[-1]
        await clean_up_regularly(state)

    def telling(really: Callable[..., object], name: str) -> Callable[..., object]:
        return lambda *a, **k: (_note(name), really(*a, **k))[1]

    listeners = [
        ("before_cursor_execute", lambda _connection, _cursor, statement, *_: _note(statement)),
        ("engine_connect", lambda *_: _note("connect")),
    ]
    monkeypatch.setattr("rholoc.service.app.clean_up_regularly", noting)
    really_stat = os.stat

    def stat(path: Any, **options: Any) -> os.stat_result:
        if _is_of_the_service(path):
            _note(f"os.stat {path}")
        return really_stat(path, **options)

    monkeypatch.setattr(os, "stat", stat)
    for name in ("get", "get_range", "put", "list", "delete"):
        monkeypatch.setattr(obstore, name, telling(getattr(obstore, name), name))
    for name, listener in listeners:
        sa.event.listen(sa.Engine, name, listener)
    yield found
    _WATCHED.clear()
    for name, listener in listeners:
        sa.event.remove(sa.Engine, name, listener)


def longest_burst_s(watched: Loop, work: Callable[[], None]) -> float:
    """For how long at most an event loop's thread computed without a pause while ``work()`` ran [s of processor time].

    The clock of the wall would tell of other programs that need the cores, too. What waits is not computed: that the
    thread waits for nothing is told by what it asked for.
    """
    longest, ended = [0.0], threading.Event()

    async def tick() -> None:
        while not ended.is_set():
            before = time.thread_time()
            await asyncio.sleep(0.002)
            longest[0] = max(longest[0], time.thread_time() - before)

    ticking = asyncio.run_coroutine_threadsafe(tick(), watched.loop)
    try:
        work()
    finally:
        ended.set()
        ticking.result(10)
    return longest[0]


_CLIENT = httpx.Client(limits=httpx.Limits(max_connections=None), timeout=60)  # to make one takes time, too


def asked(url: str, method: str, path: str, picture: bytes) -> tuple[int, float]:
    """Status and duration [s] of a request; of a stream, its beginning."""
    begun = time.perf_counter()
    content = picture if path.endswith("localize") else b"{}" if method == "PUT" else b""
    headers = PNG if path.endswith("localize") else {"Content-Type": "application/json"}
    with _CLIENT.stream(method, url + path, content=content, headers=headers) as answer:
        return answer.status_code, time.perf_counter() - begun


@pytest.mark.slow
def test_a_silent_database_blocks_nothing(serve, urls, silenced, loops, picture_world):
    running = serve(**urls, live=True)
    httpx.put(running.url + "/v1/maps/room", content=picture_world.rho()).raise_for_status()
    localize = running.url + "/v1/maps/room/localize"
    httpx.post(localize, content=picture_world.png(), headers=PNG).raise_for_status()
    silenced.silence()
    found: list[tuple[str, int, float]] = []

    def ask(route: tuple[str, str]) -> None:
        status, took_s = asked(running.url, *route, picture_world.png())
        found.append((" ".join(route), status, took_s))

    with ThreadPoolExecutor(64) as clients:
        waiting = [clients.submit(ask, route) for route in _ROUTES * 3]
        time.sleep(0.5)
        probes = {path: [] for path in ("/healthz", "/readyz", "/metrics", "/v1/maps/room/localize")}

        def probe() -> None:
            for _ in range(10):
                for path, took in probes.items():
                    method = "POST" if path.endswith("localize") else "GET"
                    status, took_s = asked(running.url, method, path, picture_world.png())
                    took.append(took_s)
                    assert status == 200, path

        bursts_s = [longest_burst_s(loops[0], probe) for _ in range(2)]
        for one in waiting:
            one.result(60)
    assert not loops[0].asked
    assert {status for _, status, _ in found} <= {200, 404, 422, 503}, found
    slow = [one for one in found if one[2] > _BOUND_S]
    assert not slow
    for path, took in probes.items():
        assert statistics.median(took) < 0.5, (path, took)
    assert min(bursts_s) < _BURST_S
    silenced.resume()
    deadline_s = time.monotonic() + 60
    while httpx.get(running.url + "/v1/jobs").status_code != 200:
        assert time.monotonic() < deadline_s, "it did not recover"
        time.sleep(0.2)


@pytest.mark.slow
def test_a_server_that_starts_beside_a_silent_database_localizes(serve, urls, silenced, picture_world, tmp_path):
    folders = {"data_dir": tmp_path / "data"}
    first = serve(**urls, **folders)
    httpx.put(first.url + "/v1/maps/room", content=picture_world.rho()).raise_for_status()
    kept = tmp_path / "data" / "copies" / "catalogue.json"
    deadline_s = time.monotonic() + 10
    while not kept.exists() or "room" not in kept.read_text():
        assert time.monotonic() < deadline_s, "the catalogue was not kept"
        time.sleep(0.05)
    silenced.silence()
    second = serve(**urls, **folders)
    answer = httpx.post(second.url + "/v1/maps/room/localize", content=picture_world.png(), headers=PNG)
    assert answer.json()["localized"]
    ready = httpx.get(second.url + "/readyz").json()
    assert ready["ready"]
    assert "does not answer" in ready["checks"]["jobs"]


def test_a_silent_storage_costs_no_compute_threads(serve, tmp_path, picture_world, monkeypatch):
    running = serve(storage_url=f"file://{tmp_path}/storage", concurrency=2)
    for name in ("hot", *(f"cold{number}" for number in range(6))):
        httpx.put(f"{running.url}/v1/maps/{name}", content=picture_world.rho()).raise_for_status()
    picture, released = picture_world.png(), threading.Event()

    def localize(name: str, deadline_ms: int = 30_000) -> tuple[int, float]:
        begun = time.perf_counter()
        path = f"/v1/maps/{name}/localize?deadline_ms={deadline_ms}"
        answer = httpx.post(running.url + path, content=picture, headers=PNG, timeout=60)
        return answer.status_code, time.perf_counter() - begun

    alone_s = statistics.median(localize("hot")[1] for _ in range(5))
    library = running.app.state.rholoc.maps.sync
    for copy in library.folder.glob("*.rho"):
        if copy != library.path("hot"):
            copy.unlink()
    for number in range(6):
        library._cache.drop(f"cold{number}")
    real = obstore.get
    monkeypatch.setattr(obstore, "get", lambda *a, **k: (released.wait(60), real(*a, **k))[1])
    try:
        with ThreadPoolExecutor(6) as clients:
            cold = [clients.submit(localize, f"cold{number}", 3000) for number in range(6)]
            time.sleep(0.5)
            beside_s = statistics.median(localize("hot")[1] for _ in range(5))
            assert all(one.result()[0] in (503, 504) for one in cold)
            assert all(one.result()[1] < 5 for one in cold)
    finally:
        released.set()
    assert beside_s < 3 * alone_s + 1  # not the three seconds that the others wait
    until(lambda: localize("cold0")[0] == 200)


def test_calls_that_take_too_long_are_given_up_and_further_ones_refused_at_once():
    released = threading.Event()

    async def main() -> None:
        threads = StorageThreads(2, 0.2)
        held = [threads(released.wait, 30) for _ in range(3)]
        answers = await asyncio.gather(*held, return_exceptions=True)
        assert all(isinstance(one, StorageUnavailable) for one in answers)
        begun = time.perf_counter()
        with pytest.raises(StorageUnavailable):
            await threads(time.monotonic)
        assert time.perf_counter() - begun < 0.1
        released.set()
        while True:
            with suppress(StorageUnavailable):
                assert await threads(lambda: 7) == 7
                break
            await asyncio.sleep(0.01)
        threads.close()

    asyncio.run(main())


@pytest.mark.parametrize("shared", [pytest.param(False, marks=pytest.mark.slow), True], ids=["alone", "shared"])
def test_nothing_is_asked_of_a_disk_or_a_database_in_the_loops_thread(serve, loops, tmp_path, picture_world, shared):
    """All routes that read, and one of each kind that writes, once with everything cold."""
    running = serve(
        keep_failures=True,
        keep_refused=10,
        live=True,
        **({"storage_url": f"file://{tmp_path}/storage"} if shared else {}),
    )
    json, video = {"Content-Type": "application/json"}, b"\0\0\0\x18ftypisom" + b"x" * 100
    camera = {"width": 640, "height": 480, "fx": 500, "fy": 500, "cx": 320, "cy": 240}
    site = {"maps": [{"map": "room", "pose": {}}]}
    with httpx.Client(base_url=running.url, timeout=60) as client:
        assert client.put("/v1/maps/room", content=picture_world.rho()).status_code == 201
        assert client.put("/v1/maps/room", content=picture_world.rho(version=2)).status_code == 200
        assert client.put("/v1/cameras/phone", json=camera).status_code == 201
        assert client.put("/v1/sites/campus", json=site).status_code == 201
        begun = client.post("/v1/recordings", files={"file": ("walk.mp4", video)}, data={"map": "hall"}).json()
        for maps, parameters in (("maps/room/", {}), ("", {"maps": "all"}), ("", {"site": "campus"})):
            found = client.post(f"/v1/{maps}localize", params=parameters, content=picture_world.png(), headers=PNG)
            assert found.json()["localized"], found.text
        known = {
            "map_name": "room",
            "recording": begun["recording"],
            "job": begun["job"]["id"],
            "feature": "1",
            "view": "0",
        }
        known |= {"camera": "phone", "site": "campus", "name": "nosuch", "number": "0"}
        for path, methods in running.app.openapi()["paths"].items():
            if "get" in methods and not path.endswith(("/events", "/live")):
                assert client.get(path.format(**known)).status_code in (200, 404), path
        assert client.post("/v1/maps/room/corrections", json={"kind": "origin", "at": [0, 0, 0]}).status_code == 200
        assert client.post("/v1/maps/room/restore").status_code == 200
        assert client.patch("/v1/maps/room", content=b'{"name": "lobby"}', headers=json).status_code == 200
        assert client.delete("/v1/sites/campus").status_code == client.delete("/v1/cameras/phone").status_code == 204
        assert client.delete("/v1/maps/lobby").status_code == 204
    (watched,) = loops
    assert watched.asked == []


def test_a_call_in_the_loops_thread_would_be_seen(serve, loops):
    running = serve()

    async def ask() -> None:
        running.app.state.rholoc.jobs.sync.counts()
        running.app.state.rholoc.maps.sync.names()

    asyncio.run_coroutine_threadsafe(ask(), loops[0].loop).result(10)
    assert any("SELECT" in one for one in loops[0].asked)
    assert any(one.startswith(("os.stat", "os.scandir", "os.listdir")) for one in loops[0].asked)
