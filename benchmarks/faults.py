"""What becomes of a service while its parts fail: nothing may be lost, published twice, or torn.

    python benchmarks/faults.py [--runs 20] [--seed 0] [--minutes 10] [--longest SECONDS] [--only KIND …]
                                [--json FILE]

Starts PostgreSQL, an S3 server (moto) behind a proxy that can fail, two servers and two workers, each with folders of
its own, on 127.0.0.1. In each run, while cameras ask for poses, two writers correct one map, and a recording is
uploaded in pieces to whichever server answers, one fault happens at a random moment:

- a server, a worker or PostgreSQL is killed (-9), or a worker at a stage of the job; PostgreSQL is restarted;
- PostgreSQL or the storage is silent for some seconds: connections stay open, and nothing answers;
- the storage is gone, slow, answers 503, or breaks off in the middle of objects, for some seconds;
- the disk of a server is full for some seconds, or when a server starts.

While a part is silent, and on a full disk, /healthz of both servers has to answer.

When it is over, everything has to be as if it had not happened: the recording's map is published once and is the same
at both servers; each correction that was confirmed is a version of its own; all answers were poses of a published
version, or said that the service cannot at present. Workers use the pipeline of the tests, which makes tiny maps. Each
problem is reported with the seed of its run, and the exit status is 1 then. Filling a disk needs root.
"""

import argparse
import base64
import json
import logging
import os
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
import uuid
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any

import httpx

from measuring import free_port

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "jobs"))
from failing_storage import FailingStorage, StorageFault
from fake_pipeline import KILL_POINTS
from postgres_server import PostgresServer

TESTS = Path(__file__).resolve().parents[1] / "tests"
SHIPPED = Path(__file__).resolve().parents[1] / "maps"
MAP, BUCKET = "testsite", "rholoc"
PATIENCE_S = 120.0  # until a run has recovered: processes start in half a minute on a busy machine
DISK_BYTES = 48 * 2**20
PIECES = 4
TUS = {"Tus-Resumable": "1.0.0"}
NOT_NOW = frozenset({502, 503, 504})  # what a service may say while something is gone
DISK_FULL = 507  # and that, where a disk is


class Fault(StrEnum):
    """What happens in a run."""

    KILL_SERVER = "server killed"
    KILL_WORKER = "worker killed"
    KILL_AT_STAGE = "worker killed at a stage"
    KILL_DATABASE = "PostgreSQL killed"
    RESTART_DATABASE = "PostgreSQL restarted"
    DATABASE_SILENT = "PostgreSQL silent"
    STORAGE_SILENT = "storage silent"
    STORAGE_GONE = "storage gone"
    STORAGE_SLOW = "storage slow"
    STORAGE_UNAVAILABLE = "storage answers 503"
    STORAGE_TRUNCATES = "storage truncates"
    FULL_DISK = "disk full"
    FULL_DISK_AT_START = "disk full when a server starts"


ON_FULL_DISK = frozenset({Fault.FULL_DISK, Fault.FULL_DISK_AT_START})
STAYS_ALIVE = ON_FULL_DISK | {Fault.DATABASE_SILENT, Fault.STORAGE_SILENT}
HEALTH_WITHIN_S = 2.0  # workers, PostgreSQL and S3 compute on the same cores
STARTS_WITHIN_S = 60.0


class Program:
    """A server or a worker, started again whenever it was killed."""

    def __init__(self, command: Sequence[str], environment: dict[str, str], log: Path, url: str = "") -> None:
        self._command, self._environment, self._log, self.url = command, environment, log, url
        self._process = self._spawn()

    def _spawn(self) -> subprocess.Popen[bytes]:
        with self._log.open("ab") as log:
            return subprocess.Popen(self._command, env=self._environment, stdout=log, stderr=log)

    def kill(self) -> None:
        """Kill it; :meth:`keep` starts it again."""
        self._process.send_signal(signal.SIGKILL)
        self._process.wait(30)

    def keep(self) -> None:
        """Start it again if it has ended."""
        if self._process.poll() is not None:
            self._process = self._spawn()

    def close(self) -> None:
        """End it."""
        self._process.terminate()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(30)
            return
        self._process.kill()


class Deployment:
    """PostgreSQL, storage, two servers, two workers."""

    def __init__(self, folder: Path) -> None:
        import boto3
        from moto.server import ThreadedMotoServer

        logging.getLogger("werkzeug").setLevel(logging.ERROR)  # which tells of each request
        self._moto = ThreadedMotoServer("127.0.0.1", 0, verbose=False)
        self._moto.start()
        host, port = self._moto.get_host_and_port()
        self.storage = FailingStorage(f"http://{host}:{port}")
        credentials = {"AWS_ACCESS_KEY_ID": "test", "AWS_SECRET_ACCESS_KEY": "test", "AWS_REGION": "us-east-1"}
        s3 = boto3.client("s3", endpoint_url=f"http://{host}:{port}", region_name="us-east-1",
                          aws_access_key_id="test", aws_secret_access_key="test")  # fmt: skip
        s3.create_bucket(Bucket=BUCKET)
        self.database = PostgresServer()
        urls = {
            "RHOLOC_DATABASE_URL": self.database.create_database("faults"),
            "RHOLOC_STORAGE_URL": f"s3://{BUCKET}/service",
        }
        single = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
        aws = {**credentials, "AWS_ENDPOINT_URL": self.storage.url, "AWS_ALLOW_HTTP": "true"}
        environment = {**os.environ, **single, **aws, **urls, "RHOLOC_CONCURRENCY": "1"}
        self._control = folder / "control"
        self._control.mkdir()
        self.disks: list[Path] = []
        self.servers = [self._server(folder, number, environment) for number in range(2)]
        pipeline = str(TESTS / "fake_pipeline.py")
        self.workers = []
        for number in range(2):
            home = folder / f"worker-{number}"
            home.mkdir()
            folders = [str(home / "data"), str(home / "maps"), str(self._control)]
            capacity = ["1", "inf"]
            command = [sys.executable, pipeline, *folders, *capacity, *urls.values()]
            self.workers.append(Program(command, environment, folder / f"worker-{number}.log"))

    def _server(self, folder: Path, number: int, environment: dict[str, str]) -> Program:
        home, port = folder / f"server-{number}", free_port()
        home.mkdir()
        options = ["-t", "tmpfs", "-o", f"size={DISK_BYTES}", "tmpfs", str(home)]
        if not subprocess.run(["mount", *options], check=False, capture_output=True).returncode:
            self.disks.append(home)
        command = [sys.executable, "-m", "rholoc", "serve", "--no-worker", "--port", str(port)]
        command += ["--data", str(home / "data"), "--maps", str(home / "maps")]
        return Program(command, environment, folder / f"server-{number}.log", f"http://127.0.0.1:{port}")

    @property
    def programs(self) -> list[Program]:
        """All that is started again when it was killed."""
        return [*self.servers, *self.workers]

    def published(self, name: str) -> int:
        """How often workers noted that they published a map."""
        events = self._control / "events"
        return events.read_text().split("\n").count(f"put {name}") if events.exists() else 0

    def wait_until_ready(self) -> bool:
        """Keep everything alive until all servers answer and see all; whether they do."""

        def ready() -> bool:
            for program in self.programs:
                program.keep()
            checks = [httpx.get(f"{one.url}/readyz", timeout=10).json()["checks"] for one in self.servers]
            return all(one["jobs"] == one["maps"] == "ok" for one in checks)

        return soon(ready)

    def close(self) -> None:
        """End everything."""
        for program in self.programs:
            program.close()
        self.storage.close()
        self.database.close()
        self._moto.stop()
        for disk in self.disks:
            subprocess.run(["umount", "-l", str(disk)], check=False)


def soon(condition: Callable[[], bool]) -> bool:
    """Whether a condition comes true in time; a service that does not answer has not made it true yet."""
    end_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < end_s:
        with suppress(httpx.HTTPError, KeyError, ValueError):
            if condition():
                return True
        time.sleep(0.2)
    return False


@dataclass
class Run:
    """What was seen in a run."""

    problems: list[str] = field(default_factory=list)
    answers: Counter[str] = field(default_factory=Counter)
    confirmed: list[int] = field(default_factory=list)  # versions that writers were told of
    not_now: frozenset[int] = NOT_NOW
    unknown: int = 0  # corrections whose answer did not arrive
    stopping: threading.Event = field(default_factory=threading.Event)

    def judge(self, what: str, answer: httpx.Response | None, also: frozenset[int] = frozenset()) -> bool:
        """Count an answer; whether it is a success."""
        status = "broken off" if answer is None else str(answer.status_code)
        self.answers[f"{what} {status}"] += 1
        if answer is None or answer.is_success or answer.status_code in self.not_now | also:
            return answer is not None and answer.is_success
        self.problems.append(f"{what} was answered with {status}: {answer.text[:200]}")
        return False


def asked(method: str, url: str, **options: Any) -> httpx.Response | None:
    """The answer; None where there is none."""
    with suppress(httpx.TransportError):
        return httpx.request(method, url, timeout=30, **options)
    return None


def localize(deployment: Deployment, run: Run, pictures: Sequence[bytes], versions: range) -> None:
    """Ask for poses until the run stops: each is one of a version that is there, and complete."""
    number = 0
    while not run.stopping.wait(0.2):
        url = deployment.servers[number % 2].url
        number += 1
        picture = pictures[number % len(pictures)]
        headers = {"Content-Type": "image/jpeg"}
        answer = asked("POST", f"{url}/v1/maps/{MAP}/localize", content=picture, headers=headers)
        if run.judge("localize", answer):
            found = answer.json()
            if not found["localized"] and found["reason"] != "deadline":
                run.problems.append(f"A mapped picture was not localized: {found['reason']}.")
            if found["map_version"] < versions.start:
                run.problems.append(f"Version {found['map_version']} answered after {versions.start} had been seen.")


def correct(deployment: Deployment, run: Run, choices: random.Random) -> None:
    """Correct one map until the run stops."""
    while not run.stopping.wait(0.3 + choices.random()):
        url = deployment.servers[choices.randrange(2)].url
        wanted = {"kind": "labels", "tags": [uuid.uuid4().hex[:12]]}
        answer = asked("POST", f"{url}/v1/maps/{MAP}/corrections", json=wanted)
        if run.judge("correct", answer, frozenset({409})):
            run.confirmed.append(answer.json()["version"])
        elif answer is None or answer.status_code in run.not_now:
            run.unknown += 1


def upload(deployment: Deployment, run: Run, name: str, content: bytes, choices: random.Random) -> str | None:
    """Upload a recording piece by piece, to whichever server answers; the id of its job."""
    fields = {"filename": "walk.mp4", "map": name}
    metadata = ",".join(f"{key} {base64.b64encode(value.encode()).decode()}" for key, value in fields.items())
    begin = {**TUS, "Upload-Length": str(len(content)), "Upload-Metadata": metadata}
    place, job = "", ""
    patch = {**TUS, "Content-Type": "application/offset+octet-stream"}
    step = -(-len(content) // PIECES)

    def go_on() -> bool:
        nonlocal place, job
        url = deployment.servers[choices.randrange(2)].url
        if not place:
            begun = asked("POST", f"{url}/v1/recordings", headers=begin)
            place = begun.headers["Location"] if run.judge("begin", begun) else ""
            return False
        stands = asked("HEAD", url + place, headers=TUS)
        if not run.judge("stands", stands):
            return False
        job = stands.headers.get("Rholoc-Job", "")
        offset = int(stands.headers["Upload-Offset"])
        if offset < len(content):
            piece, here = content[offset : offset + step], {**patch, "Upload-Offset": str(offset)}
            run.judge("piece", asked("PATCH", url + place, content=piece, headers=here), frozenset({409}))
        return bool(job)

    return job if soon(go_on) else None


@contextmanager
def happening(fault: Fault, deployment: Deployment, choices: random.Random) -> Iterator[None]:
    """A fault, until it is over."""
    programs = {Fault.KILL_SERVER: deployment.servers, Fault.KILL_WORKER: deployment.workers}
    if fault in programs:
        choices.choice(programs[fault]).kill()
        yield
    elif fault in (Fault.KILL_DATABASE, Fault.RESTART_DATABASE):
        if fault is Fault.KILL_DATABASE:
            deployment.database.kill()
        else:
            deployment.database.stop()
        yield
        deployment.database.start()
    elif fault is Fault.DATABASE_SILENT:
        deployment.database.silence()
        yield
        deployment.database.resume()
    elif fault in ON_FULL_DISK:
        number = choices.randrange(len(deployment.disks))
        ballast = deployment.disks[number] / "ballast"
        with suppress(OSError), ballast.open("wb", buffering=0) as file:
            for size in (2**20, 2**12, 1):
                with suppress(OSError):
                    while True:
                        file.write(bytes(size))
        if fault is Fault.FULL_DISK_AT_START:
            deployment.servers[number].kill()
            deployment.servers[number].keep()
            end_s = time.monotonic() + STARTS_WITHIN_S
            while time.monotonic() < end_s and asked("GET", f"{deployment.servers[number].url}/healthz") is None:
                time.sleep(0.2)
        yield
        ballast.unlink()
    else:
        deployment.storage.fault = StorageFault[fault.name.removeprefix("STORAGE_")]
        yield
        deployment.storage.fault = None


def run_once(deployment: Deployment, fault: Fault, seed: int, pictures: Sequence[bytes], longest_s: float) -> Run:
    """One run, whose fault lasts no longer than that, and all that is wrong after it."""
    choices, name = random.Random(seed), f"walk-{seed}"
    run = Run(not_now=NOT_NOW | {DISK_FULL} if fault in ON_FULL_DISK else NOT_NOW)
    content = b"\0\0\0\x18ftypmp42 a walk" + b"." * 4000
    if fault is Fault.KILL_AT_STAGE:
        content = b"\0\0\0\x18ftypmp42 kill at " + f"{choices.choice(KILL_POINTS)},".encode() + b"." * 4000
    before = httpx.get(f"{deployment.servers[0].url}/v1/maps/{MAP}", timeout=60).json()["version"]
    jobs: list[str | None] = []
    tasks = [
        lambda: localize(deployment, run, pictures, range(before, 10**9)),
        lambda: correct(deployment, run, random.Random(seed + 1)),
        lambda: correct(deployment, run, random.Random(seed + 2)),
        lambda: jobs.append(upload(deployment, run, name, content, random.Random(seed + 3))),
    ]
    threads = [threading.Thread(target=task, daemon=True) for task in tasks]
    for thread in threads:
        thread.start()
    time.sleep(choices.uniform(0, 3))
    if fault is not Fault.KILL_AT_STAGE:
        with happening(fault, deployment, choices):
            if fault in STAYS_ALIVE:
                run.problems += unhealthy(deployment)
            time.sleep(choices.uniform(0.5, longest_s))
    if not deployment.wait_until_ready():
        run.problems.append("It did not recover.")
    threads[-1].join(PATIENCE_S)
    run.stopping.set()
    for thread in threads:
        thread.join(PATIENCE_S)
    run.problems += outcome(deployment, run, name, jobs[0] if jobs else None, before)
    return run


def unhealthy(deployment: Deployment) -> list[str]:
    """The servers whose /healthz does not answer in time."""
    found = []
    for server in deployment.servers:
        begun_s = time.monotonic()
        answer = asked("GET", f"{server.url}/healthz")
        took_s = time.monotonic() - begun_s
        if answer is None or not answer.is_success or took_s > HEALTH_WITHIN_S:
            found.append(f"/healthz took {took_s:.1f} s meanwhile.")
    return found


def outcome(deployment: Deployment, run: Run, name: str, job: str | None, before: int) -> list[str]:
    """What is wrong when a run is over."""
    first, second = (server.url for server in deployment.servers)
    if not job:
        return ["The upload did not end."]
    found: dict[str, Any] = {}

    def has_ended() -> bool:
        for program in deployment.programs:
            program.keep()
        found.update(httpx.get(f"{first}/v1/jobs/{job}", timeout=30).json())
        return found["state"] in ("published", "failed", "cancelled")

    if not soon(has_ended):
        return [f"The job is still {found.get('state')}: {found.get('message')}"]
    problems = []
    if found["state"] != "published":
        problems.append(f"The job {found['state']}: {found['message']}")
    elif not soon(lambda: same(f"/v1/maps/{name}/download", first, second)):
        problems.append("The new map is not the same at both servers.")
    else:
        versions = httpx.get(f"{first}/v1/maps/{name}/versions", timeout=30).json()["versions"]
        if versions or deployment.published(name) > 1:
            problems.append(f"The map was published {max(len(versions) + 1, deployment.published(name))} times.")
    if not soon(lambda: same(f"/v1/maps/{MAP}/download", first, second)):
        problems.append("The corrected map is not the same at both servers.")
    answer = httpx.get(f"{first}/v1/maps/{MAP}", timeout=30)
    if answer.status_code != 200:
        return [*problems, f"The corrected map was answered with {answer.status_code}: {answer.text[:200]}"]
    made = answer.json()["version"] - before
    if len(set(run.confirmed)) < len(run.confirmed):
        problems.append("Two writers were told of the same version.")
    if not len(run.confirmed) <= made <= len(run.confirmed) + run.unknown:
        problems.append(f"{len(run.confirmed)} corrections were confirmed, {run.unknown} unknown, {made} were made.")
    return problems


def same(path: str, *urls: str) -> bool:
    """Whether servers give the same."""
    answers = [httpx.get(url + path, timeout=60) for url in urls]
    return all(one.status_code == 200 for one in answers) and len({one.content for one in answers}) == 1


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0, help="of the first run; each has the next one")
    parser.add_argument("--minutes", type=float, default=10.0, help="no run begins later")
    parser.add_argument("--longest", type=float, default=4.0, metavar="SECONDS", help="that a fault lasts")
    parser.add_argument("--only", nargs="+", type=Fault, choices=list(Fault), metavar="KIND")
    parser.add_argument("--json", type=Path, help="write the figures here as well")
    args = parser.parse_args()
    end_s = time.monotonic() + 60 * args.minutes
    pictures = [path.read_bytes() for path in sorted((SHIPPED / "queries").glob("*.jpg"))]
    runs: Counter[str] = Counter()
    answers: Counter[str] = Counter()
    problems: list[str] = []
    longest_s = 0.0
    with tempfile.TemporaryDirectory() as name:
        deployment = Deployment(Path(name))
        try:
            if not deployment.wait_until_ready():
                raise SystemExit("The deployment did not start.")
            content = (SHIPPED / f"{MAP}.rho").read_bytes()
            httpx.put(f"{deployment.servers[0].url}/v1/maps/{MAP}", content=content, timeout=60).raise_for_status()
            faults = [fault for fault in args.only or Fault if fault not in ON_FULL_DISK or deployment.disks]
            for seed in range(args.seed, args.seed + args.runs):
                if time.monotonic() > end_s:
                    break
                fault, begun_s = faults[seed % len(faults)], time.monotonic()
                run = run_once(deployment, fault, seed, pictures, args.longest)
                longest_s = max(longest_s, time.monotonic() - begun_s)
                runs[fault] += 1
                answers += run.answers
                problems += [f"seed {seed}, {fault}: {problem}" for problem in dict.fromkeys(run.problems)]
                print(f"{seed} {fault}: {'; '.join(run.problems[:3]) or 'as if nothing had happened'}", file=sys.stderr)
        finally:
            deployment.close()
            logs = "".join(path.read_text(errors="replace") for path in Path(name).glob("server-*.log"))
    figures = {
        "runs": runs.total(), "by_fault": dict(runs), "problems": problems, "longest_run_s": round(longest_s, 1),
        "internal_errors": logs.count('"internal_error"'), "answers": dict(sorted(answers.items())),
    }  # fmt: skip
    text = json.dumps(figures, indent=2)
    print(text)
    if args.json:
        args.json.write_text(text + "\n")
    raise SystemExit(bool(problems or figures["internal_errors"]))


if __name__ == "__main__":
    main()
