"""How a service holds up: throughput against cores, latency at 80 % of it, shedding beyond, memory over time.

    python benchmarks/load.py [--servers 2] [--seconds 30] [--json FILE]
    python benchmarks/load.py --soak 3600 [--rate 2] [--servers 2] [--json FILE]

Starts servers on 127.0.0.1 with the shipped map and asks them for poses of its pictures:

- capacity: as many requests at a time as a server works on, with 1, 2, … of the machine's cores; frames a second;
- clients: with 1, 2, 4 and 8 at once, frames a second, and how many cores the server and what asks keep busy: what one
  client leaves idle is all that more clients can gain;
- 80 %: requests that come at random moments (Poisson), four fifths of the capacity; the median, 99 % and worst. Beside
  them what an ideal service has, whose frames all take the same time and wait in one queue: at random moments several
  come at once, however quick the service is;
- overload: twice the capacity; what is shed (503 with Retry-After), the times of what is accepted, and of /healthz: a
  process of its own asks for that, because several hundred open requests delay each other where they are sent, too;
- ``--soak``, instead of these: so many seconds at ``--rate`` frames a second, lists, a report and metrics beside; the
  resident memory from the first tenth on, which is for warming up.

With ``--servers`` above 1 they share the cores, a storage (a folder) and a database file, as on several machines, and
requests take turns. What asks runs on the cores that are measured, which costs some of them. Ends by itself; prints one
JSON object.
"""

import argparse
import asyncio
import heapq
import json
import os
import random
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import cycle
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import psutil

from measuring import free_port

SHIPPED = Path(__file__).resolve().parents[1] / "maps"
MAP = "testsite"
START_SECONDS = 60  # by which a service answers
WARM_UP = 10  # requests to each server, before anything is measured
HEALTH_EVERY_S = 0.1
MOST_AT_ONCE = 400  # requests that are open: more would measure what asks
PATIENCE_S = 60.0
CLIENTS = (1, 2, 4, 8)
SAMPLES = 180  # of the memory, over the part of a soak that counts
BESIDE = ("/v1/maps", f"/v1/maps/{MAP}", f"/v1/maps/{MAP}/report", "/metrics", "/readyz")  # asked during a soak


@dataclass
class Outcome:
    """What came of a number of requests."""

    seconds: float = 0.0
    accepted_ms: list[float] = field(default_factory=list)
    health_ms: list[float] = field(default_factory=list)
    statuses: Counter[str] = field(default_factory=Counter)

    @property
    def frames_a_second(self) -> float:
        """Answered with 200."""
        return len(self.accepted_ms) / self.seconds

    def summary(self) -> dict[str, Any]:
        """As it is printed."""
        figures: dict[str, Any] = {"seconds": round(self.seconds, 1), "statuses": dict(self.statuses)}
        figures["frames_a_second"] = round(self.frames_a_second, 1)
        for name, values in (("accepted", self.accepted_ms), ("healthz", self.health_ms)):
            if values:
                p50, p99 = np.percentile(values, [50, 99])
                figures[name] = {"p50_ms": round(p50, 1), "p99_ms": round(p99, 1), "worst_ms": round(max(values), 1)}
                figures[name]["p99_over_p50"] = round(p99 / p50, 2)
        return figures


@dataclass(frozen=True)
class Server:
    """A server and where it is."""

    process: subprocess.Popen[bytes]
    url: str

    def resident_mib(self) -> float:
        """The memory of its process."""
        return float(psutil.Process(self.process.pid).memory_info().rss / 2**20)

    def busy_s(self) -> float:
        """How long cores have worked for its process."""
        spent = psutil.Process(self.process.pid).cpu_times()
        return float(spent.user + spent.system)


@contextmanager
def serving(count: int, cores: int) -> Iterator[list[Server]]:
    """Servers that together work on as many frames at a time as they have cores; stopped in the end."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        servers: list[Server] = []
        try:
            for number in range(count):
                servers.append(start(folder, number if count > 1 else None, cores, -(-cores // count)))
            for server in servers:
                wait_until_ready(server)
            publish(servers[0])
            yield servers
        finally:
            for server in servers:
                server.process.terminate()
            for server in servers:
                server.process.wait(30)


def start(folder: Path, number: int | None, cores: int, concurrency: int) -> Server:
    """A server: one of several that share a storage, or the only one where ``number`` is None."""
    port = free_port()
    home = folder / (str(number) if number is not None else "only")
    single = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    environment = {**os.environ, **single, "RHOLOC_CONCURRENCY": str(concurrency)}
    if number is not None:
        environment["RHOLOC_STORAGE_URL"] = f"file://{folder}/storage"
        home = folder / "shared"  # of the database's file; copies of maps never change, and may be shared as well
    chosen = set(sorted(os.sched_getaffinity(0))[:cores])
    command = [sys.executable, "-c", "from rholoc.cli import main; main()", "serve", "--port", str(port), "--no-worker"]
    process = subprocess.Popen(
        [*command, "--maps", str(home / "maps"), "--data", str(home / "data")],
        env=environment, preexec_fn=lambda: os.sched_setaffinity(0, chosen),
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    return Server(process, f"http://127.0.0.1:{port}")


def wait_until_ready(server: Server) -> None:
    """Raises SystemExit where the server does not start."""
    deadline = time.monotonic() + START_SECONDS
    while time.monotonic() < deadline and server.process.poll() is None:
        try:
            if httpx.get(f"{server.url}/readyz").status_code == 200:
                return
        except httpx.TransportError:
            time.sleep(0.1)
    raise SystemExit("A server did not start.")


def publish(server: Server) -> None:
    """Give the servers the shipped map."""
    content = (SHIPPED / f"{MAP}.rho").read_bytes()
    httpx.put(f"{server.url}/v1/maps/{MAP}", content=content, timeout=PATIENCE_S).raise_for_status()


class Asker:
    """Asks servers for poses, in turns."""

    def __init__(self, servers: Sequence[Server], client: httpx.AsyncClient) -> None:
        self._client = client
        self._urls = [server.url for server in servers]
        pictures = [path.read_bytes() for path in sorted((SHIPPED / "queries").glob("*.jpg"))]
        self._next = cycle([(url, picture) for picture in pictures for url in self._urls])

    async def ask(self, outcome: Outcome) -> None:
        """Ask once, and note what came of it."""
        url, picture = next(self._next)
        begun = time.perf_counter()
        try:
            answer = await self._client.post(
                f"{url}/v1/maps/{MAP}/localize", content=picture, headers={"Content-Type": "image/jpeg"}
            )
        except httpx.HTTPError as error:
            outcome.statuses[type(error).__name__] += 1
            return
        status = str(answer.status_code)
        if answer.status_code == 503 and "Retry-After" not in answer.headers:
            status += " without Retry-After"
        outcome.statuses[status] += 1
        if answer.status_code == 200:
            outcome.accepted_ms.append(1e3 * (time.perf_counter() - begun))

    async def warm_up(self) -> None:
        """Ask each server a few times; what comes of it does not count."""
        for _ in range(WARM_UP * len(self._urls)):
            await self.ask(Outcome())

    async def always(self, at_once: int, seconds: float) -> Outcome:
        """Keep so many requests open."""
        outcome, end_s = Outcome(), time.perf_counter() + seconds

        async def go_on() -> None:
            while time.perf_counter() < end_s:
                await self.ask(outcome)

        begun = time.perf_counter()
        await asyncio.gather(*(go_on() for _ in range(at_once)))
        outcome.seconds = time.perf_counter() - begun
        return outcome

    async def at_random(self, rate_hz: float, seconds: float, seed: int = 0) -> Outcome:
        """Requests at random moments, ``rate_hz`` on average, however long the answers take; /healthz beside."""
        outcome, moments = Outcome(), random.Random(seed)
        tasks: set[asyncio.Task[None]] = set()
        watcher = ProcessPoolExecutor(1, get_context("spawn"))
        watching = asyncio.wrap_future(watcher.submit(watch_health, self._urls, seconds))
        begun = due = time.perf_counter()
        while due < begun + seconds:
            due += moments.expovariate(rate_hz)
            await asyncio.sleep(max(0.0, due - time.perf_counter()))
            if len(tasks) < MOST_AT_ONCE:
                task = asyncio.create_task(self.ask(outcome))
                tasks.add(task)
                task.add_done_callback(tasks.discard)
        await asyncio.gather(*tasks)
        outcome.seconds = time.perf_counter() - begun
        outcome.health_ms = await watching
        watcher.shutdown()
        return outcome

    async def others(self, every_s: float) -> None:
        """Ask for other things in turns, for as long as nobody cancels it."""
        for path in cycle(BESIDE):
            for url in self._urls:
                await self._client.get(url + path)
            await asyncio.sleep(every_s)


def watch_health(urls: Sequence[str], seconds: float) -> list[float]:
    """Ask servers for /healthz in turns; how long each answer took, ms."""
    took_ms, end_s = [], time.perf_counter() + seconds
    with httpx.Client(timeout=PATIENCE_S) as client:
        for url in cycle(urls):
            begun = time.perf_counter()
            if begun > end_s:
                return took_ms
            client.get(f"{url}/healthz").raise_for_status()
            took_ms.append(1e3 * (time.perf_counter() - begun))
            time.sleep(HEALTH_EVERY_S)
    raise ValueError("There are no servers to ask.")


async def measure(servers: Sequence[Server], cores: int, seconds: float) -> dict[str, Any]:
    """All that is asked of servers on all the cores."""
    limits = httpx.Limits(max_connections=2 * MOST_AT_ONCE, max_keepalive_connections=2 * MOST_AT_ONCE)
    async with httpx.AsyncClient(timeout=PATIENCE_S, limits=limits) as client:
        asker = Asker(servers, client)
        await asker.warm_up()
        capacity = await asker.always(2 * cores, seconds)
        figures = {"capacity": capacity.summary(), "clients": await by_clients(asker, servers, seconds)}
        hz = capacity.frames_a_second
        figures["at 80 %"] = (await asker.at_random(0.8 * hz, seconds)).summary()
        figures["at 80 %"]["ideal_p99_over_p50"] = round(ideal_p99_over_p50(cores, 0.8), 2)
        figures["at 200 %"] = (await asker.at_random(2 * hz, seconds)).summary()
    return figures


async def by_clients(asker: Asker, servers: Sequence[Server], seconds: float) -> dict[str, Any]:
    """Frames a second and busy cores by the number of requests that are kept open, and what the most gain over one."""

    def busy_s() -> float:
        return time.process_time() + sum(server.busy_s() for server in servers)

    found = {}
    for clients in CLIENTS:
        before_s = busy_s()
        outcome = await asker.always(clients, seconds)
        cores = round((busy_s() - before_s) / outcome.seconds, 2)
        found[clients] = {"frames_a_second": round(outcome.frames_a_second, 1), "busy_cores": cores}
    rates = [one["frames_a_second"] for one in found.values()]
    return {"at_once": found, "most_over_one": round(rates[-1] / rates[0], 2)}


async def soak(servers: Sequence[Server], rate_hz: float, seconds: float) -> dict[str, Any]:
    """Keep servers moderately busy, and watch their memory."""
    resident: list[list[float]] = []

    async def watch(every_s: float) -> None:
        while True:
            resident.append([server.resident_mib() for server in servers])
            await asyncio.sleep(every_s)

    async with httpx.AsyncClient(timeout=PATIENCE_S) as client:
        asker = Asker(servers, client)
        beside = asyncio.create_task(asker.others(every_s=1.0))
        await asker.at_random(rate_hz, 0.1 * seconds, seed=1)
        watching = asyncio.create_task(watch(0.9 * seconds / SAMPLES))
        soaked = await asker.at_random(rate_hz, 0.9 * seconds, seed=2)
        for task in (watching, beside):
            assert not task.done(), "What runs beside a soak ended."
            task.cancel()
    by_server = np.array(resident).T
    growth = 100 * (by_server / by_server[:, :1] - 1)
    return {
        **soaked.summary(), "asked_hz": rate_hz, "resident_mib": by_server[:, :: SAMPLES // 10].round(1).tolist(),
        "growth_%": {"at_most": growth.max(axis=1).round(1).tolist(), "in_the_end": growth[:, -1].round(1).tolist()},
    }  # fmt: skip


async def capacity_of(servers: Sequence[Server], cores: int, seconds: float) -> float:
    """Frames a second."""
    async with httpx.AsyncClient(timeout=PATIENCE_S) as client:
        asker = Asker(servers, client)
        await asker.warm_up()
        return (await asker.always(2 * cores, seconds)).frames_a_second


def ideal_p99_over_p50(cores: int, load: float, requests: int = 100_000) -> float:
    """Of the times in a queue with so many servers (M/D/c): random arrivals, frames that all take one unit of time."""
    moments = np.cumsum(np.random.default_rng(0).exponential(1 / (cores * load), requests))
    free, took = [0.0] * cores, []
    for moment in moments.tolist():
        begun = max(moment, heapq.heappop(free))
        heapq.heappush(free, begun + 1.0)
        took.append(begun + 1.0 - moment)
    p50, p99 = np.percentile(took, [50, 99])
    return float(p99 / p50)


@contextmanager
def confined_to(cores: int) -> Iterator[None]:
    """Ask from the cores that servers have, too: else what asks would have one of its own."""
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, set(sorted(before)[:cores]))
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


def by_cores(available: int, seconds: float, with_all: float) -> dict[str, Any]:
    """Capacity of one server with fewer cores, and what share of the linear it is with all of them."""
    rates = {available: with_all}
    for cores in range(1, available):
        with serving(1, cores) as servers, confined_to(cores):
            rates[cores] = round(asyncio.run(capacity_of(servers, cores, seconds)), 1)
    return {"frames_a_second_by_cores": rates, "share_of_linear": round(with_all / (available * rates[1]), 2)}


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--servers", type=int, default=1, choices=range(1, 9), metavar="N")
    parser.add_argument("--seconds", type=float, default=30.0, help="how long each part takes")
    parser.add_argument("--soak", type=float, metavar="SECONDS", help="only a soak, so long")
    parser.add_argument("--rate", type=float, default=2.0, metavar="HZ", help="frames a second of a soak")
    parser.add_argument("--json", type=Path, help="write the figures here as well")
    args = parser.parse_args()
    available = len(os.sched_getaffinity(0))
    figures: dict[str, Any] = {"cores": available, "servers": args.servers}
    with serving(args.servers, available) as servers:
        if args.soak:
            figures["soak"] = asyncio.run(soak(servers, args.rate, args.soak))
        else:
            figures |= asyncio.run(measure(servers, available, args.seconds))
    if not args.soak:
        figures |= by_cores(available, args.seconds, figures["capacity"]["frames_a_second"])
    text = json.dumps(figures, indent=2)
    print(text)
    if args.json:
        args.json.write_text(text + "\n")


if __name__ == "__main__":
    main()
