"""Whether any request makes the service fail: made-up requests and damaged good ones, for every route and stream.

    python benchmarks/fuzz.py [--cases 100000] [--seconds 3600] [--served 0.1] [--seed 0] [--json FILE]

A quarter of the requests is what schemathesis makes up from the schema; the others are requests that are accepted
(`fuzz_requests.py`) to which one to three things have befallen. Most are answered by the application within this
process; the share `--served` goes to `rholoc serve`, which also gets the streams (WebSockets and server-sent events)
and is asked whether it lives meanwhile.

Prints how they were answered by route, how many came to a second, the server's slowest /healthz and its most memory.
The exit status is 1, and the standard error says why, where a request was answered with 500, with a status or a body
that the schema does not know, or not within a minute; where /healthz took more than a second or the server more than
2 GiB; or where no frame is localized afterwards.
"""

import argparse
import asyncio
import json
import logging
import multiprocessing
import os
import random
import re
import sys
import tempfile
import time
from collections import Counter
from collections.abc import AsyncIterator, Coroutine, Iterable, Iterator
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed, InvalidStatus

from fuzz_requests import (
    JPEG,
    MAP,
    Request,
    World,
    a_picture,
    befallen,
    befallen_session,
    good_requests,
    prepared,
    request,
)
from hostile import MOST_HEALTH_MS, MOST_MEMORY_MIB, Watched, shipped_service, watch
from rholoc.maps.name_rules import is_name
from rholoc.service.access.keys import KeyStore, Scope

BATCH = 20  # cases of one route in a row
MADE_UP = 5  # of them by schemathesis
STREAMS = 100  # in a row: there is one such route
AT_ONCE = 4
TIMEOUT_S = 60.0
STREAM_QUIET_S = 0.3  # after which no more answers of a stream are waited for
SHOWN = 20  # problems
SETTINGS = {
    "RHOLOC_LEARN": "1",
    "RHOLOC_LIVE": "1",
    "RHOLOC_KEEP_FAILURES": "1",
    "RHOLOC_KEEP_REFUSED": "10",
    "RHOLOC_WORKER": "0",
    "RHOLOC_KEYS": "always",
}
CHECKS = (
    "status_code_conformance", "content_type_conformance", "response_headers_conformance",
    "response_schema_conformance",
)  # fmt: skip
MADE_UP_CHECKS = (*CHECKS, "negative_data_rejection", "missing_required_header")
TRACK = "WEBSOCKET /v1/maps/{map_name}/track"
EVENTS = "text/event-stream"
DRAWN = tuple(f"GET /v1/maps/{{map_name}}/{name}" for name in ("report.png", "coverage", "preview.png"))
DRAWN_EVERY = 8  # rounds: a picture of another version of the map takes seconds
INTERNAL = 500
FORK = multiprocessing.get_context("fork")


@dataclass
class Tally:
    """What came of cases.

    Attributes:
        answers: how many were answered so, by operation and status.
        problems: what must not be, and how to send it again: the first of each kind.
        kinds: how many there were of each kind.
        slowest: the longest that one took, in seconds, and its operation.
        health_ms: the slowest answer to /healthz.
        memory_mib: the most that the server held.
    """

    answers: dict[str, Counter[str]] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)
    kinds: Counter[str] = field(default_factory=Counter)
    slowest: tuple[float, str] = (0.0, "")
    health_ms: float = 0.0
    memory_mib: float = 0.0

    def count(self, operation: str, status: str, took_s: float) -> None:
        """Note an answer."""
        self.answers.setdefault(operation, Counter())[status] += 1
        self.slowest = max(self.slowest, (took_s, operation))

    def complain(self, operation: str, wrong: str, sent: str) -> None:
        """Note a problem."""
        kind = f"{operation}: {' '.join(wrong.split())[:100]}"
        self.kinds[kind] += 1
        if self.kinds[kind] == 1:
            self.problems.append(f"{operation}: {wrong}\n    {sent}")

    @property
    def cases(self) -> int:
        """How many there were."""
        return sum(statuses.total() for statuses in self.answers.values())

    def missed(self) -> list[str]:
        """The bounds that were not kept, and what went wrong."""
        broken = list(self.problems)
        if self.health_ms > MOST_HEALTH_MS:
            broken.append(f"/healthz after {self.health_ms:.0f} ms")
        if self.memory_mib > MOST_MEMORY_MIB:
            broken.append(f"{self.memory_mib:.0f} MiB of memory")
        return broken


class Operations:
    """The routes as the schema has them: makes requests up, and judges answers."""

    def __init__(self, document: dict[str, Any], seed: int) -> None:
        import schemathesis
        from schemathesis.checks import CHECKS as KNOWN

        logging.disable(logging.WARNING)
        schemathesis.serializer.alias("application/offset+octet-stream", "application/octet-stream")
        self._schema = schemathesis.openapi.from_dict(document)
        self._seed = seed
        self._found = {found.ok().label: found.ok() for found in self._schema.get_all_operations()}
        self._checks = KNOWN.get_by_names(list(CHECKS))
        self._made_up_checks = KNOWN.get_by_names(list(MADE_UP_CHECKS))

    def labels(self, streams: bool) -> list[str]:
        """Those that answer with a stream, or those that do not."""
        answers = {label: str(one.definition.raw.get("responses")) for label, one in self._found.items()}
        return [label for label, text in answers.items() if (EVENTS in text) is streams]

    def made_up(self, label: str, count: int, number: int) -> list[Any]:
        """Schemathesis' cases of an operation."""
        from hypothesis import HealthCheck, Phase, given, seed, settings

        cases: list[Any] = []

        @seed(random.Random(f"{self._seed} {label} {number}").getrandbits(32))
        @settings(
            max_examples=count,
            deadline=None,
            database=None,
            phases=[Phase.generate],
            suppress_health_check=list(HealthCheck),
        )
        @given(case=self._found[label].as_strategy())
        def collect(case: Any) -> None:
            cases.append(case)

        collect()
        return cases

    def judge(self, label: str, answer: httpx.Response, case: Any = None) -> str:
        """What is wrong with an answer; empty where nothing is. ``case`` is the one that was made up, if it was."""
        if answer.status_code == INTERNAL:
            return f"500: {answer.text[:500]}"
        checks = self._made_up_checks if case else self._checks
        if answer.headers.get("Content-Type", "").startswith(EVENTS):
            checks = [
                check for check in checks if check.__name__ != "response_schema_conformance"
            ]  # text, not an event
        try:
            (case or self._any_case(label)).validate_response(answer, checks=list(checks))
        except BaseExceptionGroup as failures:
            return "; ".join(str(failure)[:500] for failure in failures.exceptions)
        return ""

    def _any_case(self, label: str) -> Any:
        """A case for checks that only look at the answer."""
        return self._found[label].Case(path_parameters=dict.fromkeys(re.findall(r"{(\w+)}", label), "x"))


class Fuzzer:
    """Sends cases with a client, and tallies what came of them."""

    def __init__(self, client: httpx.AsyncClient, operations: Operations, seed: int, cases: int, last_s: float) -> None:
        self.tally = Tally()
        self._client = client
        self._operations = operations
        self._seed, self._cases, self._last_s = seed, cases, last_s
        self._at_once = asyncio.Semaphore(AT_ONCE)

    @property
    def over(self) -> bool:
        """Whether enough was sent."""
        return self.tally.cases >= self._cases or time.monotonic() > self._last_s or len(self.tally.problems) >= SHOWN

    async def rounds(self, labels: list[str]) -> None:
        """Go through the operations again and again."""
        world: World | None = None
        number = 0
        while not self.over:
            for label in labels:
                if self.over:
                    return
                if label in DRAWN and number % DRAWN_EVERY:
                    continue
                world = await prepared(self._send, world)
                await asyncio.gather(*self._batch(label, number, world))
            number += 1

    def _batch(self, label: str, number: int, world: World) -> Iterator[Coroutine[Any, Any, None]]:
        if label == TRACK:
            for place in range(STREAMS):
                yield self._stream(random.Random(f"{self._seed} {label} {number} {place}"))
            return
        for case in self._operations.made_up(label, MADE_UP, number):
            with suppress(Exception):  # not every case can be written as a request
                yield self._made_up(label, case)
        good = good_requests(world, label)
        for place in range(BATCH - MADE_UP):
            choices = random.Random(f"{self._seed} {label} {number} {place}")
            yield self._damaged(label, befallen(choices.choice(good), choices))

    async def _send(self, one: Request) -> httpx.Response:
        return await self._client.send(one.built(self._client))

    async def _made_up(self, label: str, case: Any) -> None:
        import requests

        if is_name(str((case.path_parameters or {}).get("map_name", ""))):
            case.path_parameters["map_name"] = MAP  # valid names that are made up are of no map
        wanted = case.as_transport_kwargs(base_url=str(self._client.base_url))
        known = ("method", "url", "headers", "files", "data", "params", "cookies", "json")
        ready = requests.Request(**{name: wanted[name] for name in known if name in wanted}).prepare()
        try:
            headers = {name: value for name, value in ready.headers.items() if name.lower() != "authorization"}
            built = self._client.build_request(str(ready.method), str(ready.url), headers=headers, content=ready.body)
        except (httpx.InvalidURL, ValueError, TypeError):
            return
        await self._ask(label, built, case)

    async def _damaged(self, label: str, one: Request) -> None:
        try:
            built = one.built(self._client)
        except httpx.InvalidURL:
            return
        # What the schema says of the operation is not of another method, nor of another path.
        template = label.split(" ")[1].strip("/").split("/")
        ours = one.method == label.split(" ")[0] and len(template) == len(one.path)
        ours = ours and all(segment and "/" not in segment for segment in one.path)
        ours = ours and all(have == want for have, want in zip(one.path, template, strict=True) if "{" not in want)
        await self._ask(label if ours else "", built)

    async def _ask(self, label: str, built: httpx.Request, case: Any = None) -> None:
        async with self._at_once:
            begun = time.monotonic()
            try:
                async with asyncio.timeout(TIMEOUT_S):
                    answer = await self._answer(built)
            except (httpx.LocalProtocolError, httpx.UnsupportedProtocol):
                return  # the client itself refuses to send it
            except (httpx.TransportError, TimeoutError) as error:
                self.tally.complain(label, repr(error), as_text(built))
                return
            took_s = time.monotonic() - begun
        self.tally.count(label or "another path", str(answer.status_code), took_s)
        if not label:
            wrong = f"500: {answer.text[:500]}" if answer.status_code == INTERNAL else ""
        else:
            wrong = self._operations.judge(label, answer, case)
        if wrong:
            self.tally.complain(label, wrong, as_text(built))

    async def _answer(self, built: httpx.Request) -> httpx.Response:
        """The answer to a request; of a stream, its first piece."""
        answer = await self._client.send(built, stream=True)
        if not answer.headers.get("Content-Type", "").startswith(EVENTS):
            await answer.aread()
            return answer
        pieces = answer.aiter_bytes()
        first = await anext(pieces, b"")
        await answer.aclose()
        beginning = httpx.Response(answer.status_code, headers=answer.headers, content=first, request=built)
        beginning.elapsed = answer.elapsed
        return beginning

    async def _stream(self, choices: random.Random) -> None:
        """A stream of messages; that it ends well is all that is known of it."""
        messages = befallen_session(choices)
        name = MAP if choices.random() < 0.9 else "%00"
        url = f"{str(self._client.base_url).replace('http', 'ws', 1)}/v1/maps/{name}/track"
        async with self._at_once:
            begun = time.monotonic()
            status, said = await talk(url, self._client.headers["Authorization"], messages)
        self.tally.count(TRACK, status, time.monotonic() - begun)
        if status in ("internal", "1011", "broken off"):
            self.tally.complain(TRACK, f"{status} {said[-1:]}", str([one[:300] for one in messages]))


async def talk(url: str, key: str, messages: Iterable[str | bytes]) -> tuple[str, list[str]]:
    """How a stream ended (a WebSocket's code, an error's, or the handshake's status), and what was answered."""
    said: list[str] = []
    try:
        allowed = {"Authorization": key}
        async with connect(url, open_timeout=TIMEOUT_S, max_size=2**24, additional_headers=allowed) as socket:
            with suppress(ConnectionClosed):
                for message in messages:
                    await socket.send(message)
            with suppress(TimeoutError, ConnectionClosed):
                while True:
                    said.append(str(await asyncio.wait_for(socket.recv(), STREAM_QUIET_S)))
        ended = [json.loads(one) for one in said[-1:]]
        return (ended[0]["code"] if ended and ended[0]["type"] == "error" else str(socket.close_code)), said
    except InvalidStatus as error:
        return str(error.response.status_code), said
    except (OSError, TimeoutError) as error:
        return "broken off", [repr(error)]


def as_text(built: httpx.Request) -> str:
    """A request, to send again."""
    headers = {name: value for name, value in built.headers.items() if name not in ("host", "user-agent", "accept")}
    content = built.content if hasattr(built, "_content") else b""
    return f"{built.method} {built.url} {headers} {len(content)} bytes: {content[:1000]!r}"


@asynccontextmanager
async def application(folder: Path) -> AsyncIterator[httpx.AsyncClient]:
    """A client of the application within this process."""
    from rholoc.service import Settings, create_app
    from rholoc.service.http import boundary

    boundary._REFUSAL_TAKES_S = 0.0  # which is a pause, not work
    app = create_app(Settings(maps_dir=folder / "maps", data_dir=folder / "data"))
    async with app.router.lifespan_context(app):
        transport = httpx.ASGITransport(app, raise_app_exceptions=False, client=("127.0.0.1", 1))
        key = {"Authorization": f"Bearer {KeyStore(folder / 'data').create('fuzz', Scope.ADMIN)}"}
        async with httpx.AsyncClient(
            transport=transport, base_url="http://127.0.0.1", timeout=TIMEOUT_S, headers=key
        ) as client:
            yield client


async def within(seed: int, cases: int, last_s: float) -> Tally:
    """Fuzz the application within this process."""
    from rholoc.service import create_app

    document = create_app().openapi()
    with tempfile.TemporaryDirectory() as name:
        async with application(Path(name)) as client:
            operations = Operations(document, seed)
            fuzzer = Fuzzer(client, operations, seed, cases, last_s)
            await fuzzer.rounds(operations.labels(streams=False))
            fuzzer.tally.problems += await not_localizing(client)
    return fuzzer.tally


async def not_localizing(client: httpx.AsyncClient) -> list[str]:
    """What prevents the service from doing what it is for."""
    await prepared(lambda one: client.send(one.built(client)))
    frame = request("POST", f"/v1/maps/{MAP}/localize", a_picture(), JPEG, deadline_ms=30_000)
    answer = await client.send(frame.built(client))
    fine = answer.is_success and answer.json()["localized"]
    return [] if fine else [f"no frame is localized afterwards: {answer.text[:500]}"]


async def served(url: str, key: dict[str, str], seed: int, cases: int, last_s: float) -> Tally:
    """Fuzz a server."""
    async with httpx.AsyncClient(base_url=url, timeout=TIMEOUT_S, headers=key) as client:
        operations = Operations((await client.get("/openapi.json")).json(), seed)
        labels = [TRACK, *operations.labels(streams=True), *operations.labels(streams=False)]
        fuzzer = Fuzzer(client, operations, seed, cases, last_s)
        await fuzzer.rounds(labels)
        fuzzer.tally.problems += await not_localizing(client)
    return fuzzer.tally


def fuzz_server(seed: int, cases: int, last_s: float) -> Tally:
    """Fuzz a server as users start it, while others ask whether it lives and look how much memory it holds."""
    with shipped_service() as keyed:
        url, key = keyed.server.url, {"Authorization": f"Bearer {keyed.honest}"}
        stop, said = FORK.Event(), FORK.SimpleQueue()
        watcher = FORK.Process(target=watch, args=(url, stop, said))
        watcher.start()
        try:
            tally = asyncio.run(served(url, key, seed, cases, last_s))
        finally:
            stop.set()
            watched: Watched = said.get()
            watcher.join(TIMEOUT_S)
    tally.health_ms, tally.memory_mib = 1000 * watched.slowest_s, watched.memory_mib
    return tally


def main() -> int:
    """Send, print; the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=100_000, help="how many requests are sent")
    parser.add_argument("--seconds", type=float, default=3600, help="the longest that it takes")
    parser.add_argument("--served", type=float, default=0.1, help="which share of them goes to a server")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path, help="write the figures here as well")
    options = parser.parse_args()
    begun, to_server = time.monotonic(), round(options.cases * options.served)
    parts: dict[str, Tally] = {}
    os.environ.update(SETTINGS)
    if to_server:
        parts["server"] = fuzz_server(options.seed, to_server, begun + options.seconds * options.served)
    if options.cases > to_server:
        more = options.cases - to_server
        parts["application"] = asyncio.run(within(options.seed + 1, more, begun + options.seconds))
    took_s = time.monotonic() - begun
    cases = sum(one.cases for one in parts.values())
    figures = {
        "cases": cases,
        "problems": sum(one.kinds.total() for one in parts.values()),
        "took_s": round(took_s),
        "cases_per_s": round(cases / took_s, 1),
        "parts": {name: vars(one) for name, one in parts.items()},
    }
    text = json.dumps(figures, indent=2, sort_keys=True)
    print(text)
    if options.json:
        options.json.write_text(text + "\n")
    missed = [f"{name}: {line}" for name, one in parts.items() for line in one.missed()]
    for line in missed:
        print(f"missed: {line}", file=sys.stderr)
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
