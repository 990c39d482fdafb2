"""Whether any request makes the server fail: made-up requests for every route, as its schema allows and forbids.

    python benchmarks/fuzz.py [--cases 100000] [--seconds 3600] [--clients 2] [--seed 0] [--json]

Starts `rholoc serve` on the shipped map. Each client is a process that goes through all routes again and again and
sends schemathesis' made-up requests, other ones in each round, until there were as many as asked for or the time is
over. Prints how they were answered, the slowest /healthz of twenty a second, and the most memory that the server's
processes held together.

The exit status is 1, and the standard error says why, where a request was answered with 500, with a status or a body
that the schema does not know, or broken off; where /healthz took more than a second or the memory more than 2 GiB; or
where the server does not localize a frame afterwards.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import sys
import time
from collections import Counter
from dataclasses import asdict, dataclass
from typing import Any

import httpx

from hostile import JPEG, LOCALIZE, MAPS, MOST_HEALTH_MS, MOST_MEMORY_MIB, Watched, shipped_service, watch

CASES_PER_ROUND = 20  # of one route
TIMEOUT_S = 300.0
SERVED = "testsite"
NOT_FOUND = 404
INTERNAL = 500  # a busy service answers 503, which its schema knows
SAID_PROBLEMS = 5  # of one client
FORK = multiprocessing.get_context("fork")


@dataclass(frozen=True)
class Sent:
    """What one client sent.

    Attributes:
        answers: how many requests were answered so, by route and status.
        problems: what the schema does not allow, and how to send it again.
    """

    answers: dict[str, int]
    problems: list[str]


@dataclass(frozen=True)
class Found:
    """What all clients found.

    Attributes:
        requests: how many were sent.
        answers: how many of them were answered so, by status.
        problems: as in :class:`Sent`.
        health_worst_ms: the slowest answer to /healthz.
        memory_mib: the most that the server's processes held together.
        took_s: how long it took.
    """

    requests: int
    answers: dict[str, int]
    problems: list[str]
    health_worst_ms: float
    memory_mib: float
    took_s: float

    def missed(self) -> list[str]:
        """The bounds that were not kept, and what went wrong."""
        broken = list(self.problems)
        if self.health_worst_ms > MOST_HEALTH_MS:
            broken.append(f"/healthz after {self.health_worst_ms:.0f} ms")
        if self.memory_mib > MOST_MEMORY_MIB:
            broken.append(f"{self.memory_mib:.0f} MiB of memory")
        return broken


def main() -> int:
    """Send, print; the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=100_000, help="how many requests all clients send together")
    parser.add_argument("--seconds", type=float, default=3600, help="the longest that it takes")
    parser.add_argument("--clients", type=int, default=2, help="how many send at once")
    parser.add_argument("--seed", type=int, default=0, help="of the first client's first round")
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")
    options = parser.parse_args()
    with shipped_service() as server:
        found = sent_to(server.url, options)
        restore(server.url)
        localizes = localizes_a_frame(server.url)
    if options.json:
        print(json.dumps({**asdict(found), "localizes": localizes}, indent=2))
    else:
        print(
            f"{found.requests} requests in {found.took_s:.0f} s: {found.answers}; "
            f"/healthz {found.health_worst_ms:.0f} ms, {found.memory_mib:.0f} MiB"
        )
    missed = found.missed() + ([] if localizes else ["no frame is localized afterwards"])
    for line in missed:
        print(f"missed: {line}", file=sys.stderr)
    return 1 if missed else 0


def restore(url: str) -> None:
    """Upload the map again where a request has deleted or renamed it."""
    with httpx.Client(base_url=url, timeout=TIMEOUT_S) as client:
        if client.get(f"/v1/maps/{SERVED}").status_code == NOT_FOUND:
            client.put(f"/v1/maps/{SERVED}", content=(MAPS / f"{SERVED}.rho").read_bytes())


def localizes_a_frame(url: str) -> bool:
    """Whether the server still does what it is for."""
    picture = sorted((MAPS / "queries").glob("*.jpg"))[0].read_bytes()
    answer = httpx.post(f"{url}{LOCALIZE}?deadline_ms=30000", content=picture, headers=JPEG, timeout=TIMEOUT_S)
    return answer.is_success and bool(answer.json()["localized"])


def sent_to(url: str, options: argparse.Namespace) -> Found:
    """What came of all that the clients sent."""
    stop, said = FORK.Event(), FORK.SimpleQueue()
    start_s = time.monotonic()
    each = -(-options.cases // options.clients)
    clients = [
        FORK.Process(target=client, args=(url, options.seed + 1000 * number, each, start_s + options.seconds, said))
        for number in range(options.clients)
    ]
    watcher = FORK.Process(target=watch, args=(url, stop, said))
    for process in (watcher, *clients):
        process.start()
    reported = [said.get() for _ in clients]  # before they are joined: they wait until it is read
    stop.set()
    reported.append(said.get())
    sent = [one for one in reported if isinstance(one, Sent)]
    health = next(one for one in reported if isinstance(one, Watched))
    for process in (watcher, *clients):
        process.join(TIMEOUT_S)
    answers = sum((Counter(one.answers) for one in sent), Counter[str]())
    return Found(
        sum(answers.values()),
        dict(sorted(answers.items())),
        [problem for one in sent for problem in one.problems],
        1000 * health.slowest_s,
        health.memory_mib,
        time.monotonic() - start_s,
    )


def client(url: str, first_seed: int, cases: int, last_s: float, said: Any) -> None:
    """One client; says what was answered, whatever happens to it."""
    try:
        said.put(send(url, first_seed, cases, last_s))
    except Exception as error:
        said.put(Sent({}, [f"a client failed: {error!r}"]))


def send(url: str, first_seed: int, cases: int, last_s: float) -> Sent:
    """Rounds through all routes."""
    import schemathesis
    from hypothesis import HealthCheck, Phase, given, seed, settings
    from schemathesis.checks import CHECKS

    schemathesis.serializer.alias("application/offset+octet-stream", "application/octet-stream")
    schema = schemathesis.openapi.from_url(url + "/openapi.json", timeout=TIMEOUT_S)
    operations = [found.ok() for found in schema.get_all_operations()]
    checks = CHECKS.get_by_names(["status_code_conformance", "response_schema_conformance"])
    bounded = settings(
        max_examples=CASES_PER_ROUND,
        deadline=None,
        database=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    answers: Counter[str] = Counter()
    problems: list[str] = []

    def over() -> bool:
        return answers.total() >= cases or time.monotonic() > last_s or len(problems) >= SAID_PROBLEMS

    def probe(operation: Any, round_seed: int) -> None:
        @seed(round_seed)
        @bounded
        @given(case=operation.as_strategy())
        def one(case: Any) -> None:
            if over():
                return
            if "map_name" in (case.path_parameters or {}) and answers.total() % 2:
                case.path_parameters["map_name"] = SERVED  # made-up names are of no map
            try:
                answer = case.call(timeout=TIMEOUT_S)
            except Exception as error:
                answers["broken off"] += 1
                problems.append(f"{operation.label}: {error}")
                return
            answers[str(answer.status_code)] += 1
            if answer.status_code == INTERNAL:
                problems.append(f"{operation.label}: {answer.text}\n{case.as_curl_command()}")
            try:
                case.validate_response(answer, checks=checks)
            except BaseExceptionGroup as failures:
                causes = "; ".join(str(failure) for failure in failures.exceptions)
                problems.append(f"{operation.label}: {causes}\n{case.as_curl_command()}")

        one()

    round_seed = first_seed
    while not over():
        for operation in operations:
            if over():
                break
            restore(url)
            probe(operation, round_seed)
        round_seed += 1
    return Sent(dict(answers), problems)


if __name__ == "__main__":
    sys.exit(main())
