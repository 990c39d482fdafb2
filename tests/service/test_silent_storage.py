"""A database or a storage that is silent: connections stay open, and nothing answers."""

from __future__ import annotations

import asyncio
import statistics
import threading
import time
import uuid
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress

import httpx
import obstore
import pytest
import sqlalchemy as sa

from postgres_server import PostgresServer
from rholoc.errors import StorageUnavailable
from rholoc.service.housekeeping import clean_up_regularly
from rholoc.service.threads.storage import StorageThreads

PNG = {"Content-Type": "image/png"}
_BOUND_S = 12.0  # of any answer while the database is silent
_BLOCKED_S = 0.02
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


@pytest.fixture
def loops(monkeypatch) -> list[asyncio.AbstractEventLoop]:
    """The event loops of the services that are started."""
    found: list[asyncio.AbstractEventLoop] = []

    async def noting(state):
        found.append(asyncio.get_running_loop())
        await clean_up_regularly(state)

    monkeypatch.setattr("rholoc.service.app.clean_up_regularly", noting)
    return found


@pytest.fixture
def asked_by_loops() -> Iterator[list[str]]:
    """What event loops themselves asked databases and storages for: nothing, if all is well."""
    found: list[str] = []

    def note(text: str) -> None:
        with suppress(RuntimeError):
            asyncio.get_running_loop()
            found.append(text)

    def note_statement(_connection, _cursor, statement, *_):
        note(statement)

    def note_connection(*_):
        note("connect")

    listeners = [("before_cursor_execute", note_statement), ("engine_connect", note_connection)]
    with pytest.MonkeyPatch.context() as patch:
        for name in ("get", "put", "list", "delete"):
            asked = getattr(obstore, name)
            patch.setattr(obstore, name, lambda *a, _asked=asked, _name=name, **k: (note(_name), _asked(*a, **k))[1])
        for name, listener in listeners:
            sa.event.listen(sa.Engine, name, listener)
        yield found
        for name, listener in listeners:
            sa.event.remove(sa.Engine, name, listener)


def longest_block_s(loop: asyncio.AbstractEventLoop, work) -> float:
    """For how long at most an event loop did not run what was due while ``work()`` ran, in seconds."""
    slowest, ended = [0.0], threading.Event()

    async def tick() -> None:
        while not ended.is_set():
            before = time.perf_counter()
            await asyncio.sleep(0.002)
            slowest[0] = max(slowest[0], time.perf_counter() - before - 0.002)

    ticking = asyncio.run_coroutine_threadsafe(tick(), loop)
    try:
        work()
    finally:
        ended.set()
        ticking.result(10)
    return slowest[0]


def asked(url: str, method: str, path: str, picture: bytes) -> tuple[int, float]:
    """Status and duration [s] of a request; of a stream, its beginning."""
    begun = time.perf_counter()
    content = picture if path.endswith("localize") else b"{}" if method == "PUT" else b""
    headers = PNG if path.endswith("localize") else {"Content-Type": "application/json"}
    with httpx.stream(method, url + path, content=content, headers=headers, timeout=60) as answer:
        return answer.status_code, time.perf_counter() - begun


@pytest.mark.slow
def test_a_silent_database_blocks_nothing(serve, urls, silenced, loops, asked_by_loops, picture_world):
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

        blocks_s = [longest_block_s(loops[0], probe) for _ in range(2)]
        for one in waiting:
            one.result(60)
    assert not asked_by_loops
    assert {status for _, status, _ in found} <= {200, 404, 422, 503}, found
    slow = [one for one in found if one[2] > _BOUND_S]
    assert not slow
    for path, took in probes.items():
        assert statistics.median(took) < 0.5, (path, took)
    assert min(blocks_s) < 2 * _BLOCKED_S  # other programs need the cores, too
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
    assert beside_s < 3 * alone_s + 0.1
    assert localize("cold0")[0] == 200


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
