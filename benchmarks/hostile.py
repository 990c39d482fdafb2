"""What hostile clients cost the others: each attack in turn, on a server of its own on this machine.

    python benchmarks/hostile.py [--seconds 4] [--attackers 2] [--rounds 3] [--only NAME] [--json]

Starts `rholoc serve`, which requires keys, on the shipped map, and asks for poses one after the other, for so many
seconds alone and then for as many beside each attack: a few processes with keys of their own that send the same thing
again and again. Prints for each the slowest /healthz of twenty a second, the ratio of the median times of honest frames
beside the attack and alone just before it, the most memory that the server's processes held together, and what the
attack was answered; at the end, how long streams go on whose key is revoked.

The exit status is 1, and the standard error says which, where a bound was missed in each of three rounds: /healthz
within half a second, honest frames within twice their time and none refused, all processes within 2 GiB, none answered
`internal` or broken off. Several rounds, because times depend on what else the machine does; stop other work on it.
"""

import argparse
import io
import json
import math
import multiprocessing
import os
import random
import resource
import socket
import statistics
import struct
import sys
import tempfile
import time
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import httpx
import numpy as np
from PIL import Image

from rholoc.cli.server_process import RunningServer, running_server
from rholoc.service import Settings
from rholoc.service.access.keys import KeyStore, Scope

MAPS = Path(__file__).parents[1] / "maps"
JPEG = {"Content-Type": "image/jpeg"}
JSON = {"Content-Type": "application/json"}
LOCALIZE = "/v1/maps/testsite/localize"
CAMERA = {"width": 640, "height": 480, "fx": 520.0, "fy": 520.0, "cx": 320.0, "cy": 240.0}
HEALTH_EVERY_S = 0.05
MEMORY_EVERY_S = 0.2
TIMEOUT_S = 60.0
DRIBBLERS = 50
STREAMS = 300
STALLED = 300
TENSORS = 1_300_000
STRANGERS = 4
ATTACKERS_NICE = 5
MOST_ATTACKERS = 8

MOST_HEALTH_MS = 500
MOST_REVOCATION_S = 1.0
MOST_FRAME_RATIO = 2.0
MOST_MEMORY_MIB = 2048
FORK = multiprocessing.get_context("fork")

Answer = httpx.Response | None
Attack = Callable[[httpx.Client], Answer]


@dataclass(frozen=True)
class Frames:
    """How long honest frames took, and how many of them were not answered with 200."""

    took_s: list[float]
    refused: int


@dataclass(frozen=True)
class Watched:
    """The slowest answer to /healthz, and the most memory that the server's processes held together."""

    slowest_s: float
    memory_mib: float


@dataclass(frozen=True)
class Outcome:
    """What one attack cost the others.

    Attributes:
        attack: its name.
        requests: how many it made.
        answers: how many of them were answered so: by error code, else by status.
        frames: how many honest frames were answered meanwhile.
        frame_ratio: the median of their times to that alone.
        frames_refused: how many of them were not answered with 200.
        health_worst_ms: the slowest answer to /healthz.
        memory_mib: the most that the server's processes held together.
    """

    attack: str
    requests: int
    answers: dict[str, int]
    frames: int
    frame_ratio: float
    frames_refused: int
    health_worst_ms: float
    memory_mib: float

    def missed(self) -> list[str]:
        """The bounds that were not kept."""
        broken = [f"{self.answers[code]} × {code}" for code in ("internal", "broken off") if code in self.answers]
        if self.health_worst_ms > MOST_HEALTH_MS:
            broken.append(f"/healthz after {self.health_worst_ms:.0f} ms")
        if self.frame_ratio > MOST_FRAME_RATIO:
            broken.append(f"frames took {self.frame_ratio:.1f} × their time")
        if self.frames_refused:
            broken.append(f"{self.frames_refused} frames refused")
        if self.memory_mib > MOST_MEMORY_MIB:
            broken.append(f"{self.memory_mib:.0f} MiB of memory")
        return broken


def progressive_jpeg(width: int, height: int, scans: int) -> bytes:
    """A progressive JPEG file of few bytes whose last scan is there very often."""
    file = io.BytesIO()
    Image.new("RGB", (width, height), (128, 90, 60)).save(file, "JPEG", progressive=True)
    data = file.getvalue()
    return data[:-2] + data[data.rfind(b"\xff\xda") : -2] * scans + b"\xff\xd9"


def noise(width: int, height: int, format_: str) -> bytes:
    """A picture of noise, which has features everywhere."""
    file = io.BytesIO()
    pixels = np.random.default_rng(0).integers(0, 255, (height, width, 3), np.uint8)
    Image.fromarray(pixels).save(file, format_)
    return file.getvalue()


def many_entries(count: int) -> bytes:
    """A ZIP file of many empty folders."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for number in range(count):
            archive.writestr(f"{number}/", b"")
    return file.getvalue()


def rho_with(info: dict[str, object]) -> bytes:
    """A file with a map's metadata and no arrays that fit."""
    header = json.dumps({"__metadata__": {"format": "rholoc-map", "format_version": "1", "info": json.dumps(info)}})
    return struct.pack("<Q", len(header)) + header.encode()


def endless_tensors(count: int) -> bytes:
    """A file whose header describes very many empty arrays."""
    header = b"{" + b",".join(b'"%d":{"dtype":"U8","shape":[0],"data_offsets":[0,0]}' % n for n in range(count)) + b"}"
    return struct.pack("<Q", len(header)) + header


def another_room() -> bytes:
    """A picture full of features that no map knows."""
    rng = np.random.default_rng(1)
    layers = [
        Image.fromarray(rng.integers(0, 255, (480 // k, 640 // k), np.uint8)).resize((640, 480)) for k in (4, 8, 16)
    ]
    pixels = np.mean([np.asarray(layer) for layer in layers], axis=0)
    pixels = np.clip(128 + 2.0 * (pixels - 128), 0, 255).astype(np.uint8)
    file = io.BytesIO()
    Image.fromarray(pixels).convert("RGB").save(file, "JPEG", quality=92)
    return file.getvalue()


def post(path: str, content: bytes, headers: dict[str, str]) -> Attack:
    """An attack that posts the same again and again."""
    return lambda client: client.post(path, content=content, headers=headers)


def attacks(url: str) -> dict[str, Attack]:
    """All attacks by name."""
    address = urlsplit(url)
    numbers = b'{"features":{"pixels":[' + b"1," * 4_000_000 + b'1],"descriptors":"AA"}}'
    members = b"{" + b",".join(b'"%d":1' % number for number in range(60_000)) + b"}"
    n = Settings().max_features
    valid = {
        "camera": CAMERA,
        "features": {"pixels": [[1.5, 2.5]] * n, "descriptors": ["00" * 32] * n, "channels": [0] * n},
    }
    scans, large = progressive_jpeg(8160, 6120, 1000), progressive_jpeg(4000, 3000, 20)
    tensors, stranger = endless_tensors(TENSORS), another_room()
    noisy, text = noise(3200, 2400, "JPEG"), b"P3 3000 3000 255 " + b"9 " * 15_000_000
    archive = many_entries(100_000)
    boundary = b"x" * 20
    parts = b"".join(
        b"--" + boundary + b'\r\nContent-Disposition: form-data; name="a"\r\n\r\n\r\n' for _ in range(100_000)
    )
    form = {"Content-Type": f"multipart/form-data; boundary={boundary.decode()}"}
    deep = '{"a":' + "[" * 30_000 + "]" * 30_000 + "}"

    def zip_upload(client: httpx.Client) -> Answer:
        return client.post("/v1/recordings", files={"file": ("a.zip", archive)}, data={"map": "hostile"})

    def dribble(client: httpx.Client) -> Answer:
        with suppress(OSError):
            connections = [socket.create_connection((address.hostname, address.port), 5) for _ in range(DRIBBLERS)]
            for connection in connections:
                connection.sendall(b"PUT /v1/maps/x HTTP/1.1\r\nContent-Length: 100\r\nHo")
            time.sleep(1)
            for connection in connections:
                connection.close()
        return None

    def held(head: str, count: int) -> Attack:
        """An attack that opens so many connections with one key, sends a head on each, and holds them."""

        def hold(client: httpx.Client) -> Answer:
            text = head + f"Host: {address.netloc}\r\nAuthorization: {client.headers['Authorization']}\r\n\r\n"
            connections = []
            with suppress(OSError):
                for _ in range(count):
                    connections.append(socket.create_connection((address.hostname, address.port), 5))
                    connections[-1].sendall(text.encode())
            time.sleep(3)
            for connection in connections:
                connection.close()
            return None

        return hold

    def abandon(client: httpx.Client) -> Answer:
        with suppress(httpx.TimeoutException):
            return client.get("/v1/maps/testsite/download?format=csv&degree=3", timeout=0.5)
        return None

    def methods(client: httpx.Client) -> Answer:
        client.request("M" + "X" * random.randrange(50_000), "/v1/maps")
        return client.get("/metrics")

    def replace(client: httpx.Client) -> Answer:
        client.put("/v1/maps/copy", content=(MAPS / "testsite.rho").read_bytes())
        client.get("/v1/maps/copy/download")
        return client.delete("/v1/maps/copy")

    return {
        "numbers for pixels": post(LOCALIZE, numbers, JSON),
        "unknown members": post(LOCALIZE, members, JSON),
        "a full descriptor set": post(LOCALIZE, json.dumps(valid).encode(), JSON),
        "1000 scans": post(f"{LOCALIZE}?deadline_ms=500", scans, JPEG),
        "20 scans": post(f"{LOCALIZE}?deadline_ms=500", large, JPEG),
        "noise of 7.7 megapixels": post(f"{LOCALIZE}?deadline_ms=500", noisy, JPEG),
        "pixels as text": post(LOCALIZE, text, JPEG),
        "a deep camera": lambda client: client.put("/v1/cameras/deep", content=deep, headers=JSON),
        "a long camera": lambda client: client.put("/v1/cameras/long", content="[" + "1," * 2**22, headers=JSON),
        "half a character": post("/v1/maps/testsite/forget", b'{"source":"\\ud800"}', JSON),
        "a map of nothing": lambda client: client.put("/v1/maps/nothing", content=rho_with({"waypoints": ["a"]})),
        "100 000 folders": zip_upload,
        "100 000 parts": post("/v1/recordings", parts, form),
        "connections that dribble": dribble,
        "exports given up": abandon,
        "made-up methods": methods,
        "maps replaced": replace,
        "endless tensors": lambda client: client.put("/v1/maps/endless", content=tensors),
        "streams of one key": held("GET /v1/maps/testsite/live HTTP/1.1\r\n", STREAMS),
        "bodies that stall": held(
            f"POST {LOCALIZE} HTTP/1.1\r\nContent-Type: image/jpeg\r\nContent-Length: 99999\r\n", STALLED
        ),
        "frames of another room": post(LOCALIZE, stranger, JPEG),
    }


@dataclass(frozen=True)
class Keyed:
    """A service, and the keys of who asks it."""

    server: RunningServer
    honest: str
    attackers: tuple[str, ...]


@contextmanager
def shipped_service() -> Iterator[Keyed]:
    """A service of its own, with the shipped map, which requires keys."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "maps").mkdir()
        (folder / "maps" / "testsite.rho").write_bytes((MAPS / "testsite.rho").read_bytes())
        store = KeyStore(folder / "data")
        honest = store.create("honest", Scope.ADMIN)
        attackers = tuple(store.create(f"attacker {number}", Scope.ADMIN) for number in range(MOST_ATTACKERS))
        os.environ.update(RHOLOC_KEYS="always", RHOLOC_LIVE="true")
        with running_server(folder / "maps", folder / "data", folder / "log") as server:
            yield Keyed(server, honest, attackers)


def revocation_s(keyed: Keyed) -> float:
    """How long the streams of a key and of one that it handed on go on after it is revoked [s]."""
    url, admin = keyed.server.url, bearer(keyed.honest)
    lent = httpx.post(f"{url}/v1/keys", json={"scope": "map"}, headers=admin).json()
    below = httpx.post(f"{url}/v1/keys", json={"scope": "read"}, headers=bearer(lent["key"])).json()
    with ExitStack() as stack:
        live = f"{url}/v1/maps/testsite/live"
        streams = [
            stack.enter_context(httpx.stream("GET", live, headers=bearer(one["key"]), timeout=TIMEOUT_S))
            for one in (lent, below)
        ]
        begun_s = time.monotonic()
        httpx.delete(f"{url}/v1/keys/{lent['name']}", headers=admin).raise_for_status()
        for stream in streams:
            for _ in stream.iter_raw():
                pass
        return time.monotonic() - begun_s


def bearer(key: str) -> dict[str, str]:
    """The header that a key is sent in."""
    return {"Authorization": f"Bearer {key}"}


def main() -> int:
    """Measure and print; the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=4, help="how long each attack lasts")
    parser.add_argument("--attackers", type=int, default=2, help="how many clients attack at once")
    parser.add_argument("--rounds", type=int, default=3, help="how often an attack that misses a bound is measured")
    parser.add_argument("--only", help="the name of one attack")
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")
    options = parser.parse_args()
    with shipped_service() as keyed:
        found = []
        for one in measured(keyed, options):
            found.append(one)
            if not options.json:
                print(row(one), flush=True)
        took_s = revocation_s(keyed)
        if not options.json:
            print(f"streams of a key that is revoked end after {took_s:.2f} s")
    if options.json:
        print(json.dumps([{**asdict(one), "missed": one.missed()} for one in found], indent=2))
    missed = [f"{one.attack}: {bound}" for one in found for bound in one.missed()]
    if took_s > MOST_REVOCATION_S:
        missed.append(f"revocation: streams went on for {took_s:.1f} s")
    for line in missed:
        print(f"missed: {line}", file=sys.stderr)
    return 1 if missed else 0


def row(one: Outcome) -> str:
    """A line of the table."""
    answers = ", ".join(f"{code} {count}" for code, count in one.answers.items())
    costs = f"{one.frames:3} frames, {one.frame_ratio:5.1f} ×, /healthz {one.health_worst_ms:5.0f} ms, "
    return f"{one.attack:26} {costs}{one.memory_mib:5.0f} MiB  {answers}"


def measured(keyed: Keyed, options: argparse.Namespace) -> Iterator[Outcome]:
    """The outcome of each attack, as it is found; of none first."""
    url = keyed.server.url
    picture = sorted((MAPS / "queries").glob("*.jpg"))[0].read_bytes()
    chosen = {name: one for name, one in attacks(url).items() if options.only in (None, name)}
    with httpx.Client(base_url=url, timeout=TIMEOUT_S, headers=bearer(keyed.honest)) as honest:

        def frames(seconds: float) -> Frames:
            took_s, refused, last_s = [], 0, time.monotonic() + seconds
            while time.monotonic() < last_s or not took_s:
                start = time.perf_counter()
                try:
                    answer = honest.post(f"{LOCALIZE}?deadline_ms=30000", content=picture, headers=JPEG)
                    refused += not answer.is_success
                except httpx.TransportError:
                    refused += 1
                took_s.append(time.perf_counter() - start)
            return Frames(took_s, refused)

        frames(1)  # the map is loaded
        for name, attack in {"none": None, **chosen}.items():
            rounds: list[Outcome] = []
            while len(rounds) < options.rounds and (not rounds or rounds[-1].missed()):
                alone = frames(options.seconds)
                rounds.append(beside(keyed, name, attack, frames, alone, options))
            yield rounds[-1] if not rounds[-1].missed() else rounds[0]


def beside(
    keyed: Keyed,
    name: str,
    attack: Attack | None,
    frames: Callable[[float], Frames],
    alone: Frames,
    options: argparse.Namespace,
) -> Outcome:
    """The outcome of one attack. Each attacker is a process, for the server competes with them and frames do not."""
    stop, said = FORK.Event(), FORK.SimpleQueue()
    url, count = keyed.server.url, STRANGERS if name == "frames of another room" else options.attackers
    attackers = [FORK.Process(target=repeat, args=(url, key, attack, stop, said)) for key in keyed.attackers[:count]]
    watcher = FORK.Process(target=watch, args=(url, stop, said))
    chosen = [watcher] if attack is None else [watcher, *attackers]
    for process in chosen:
        process.start()
    attacked = frames(options.seconds)
    stop.set()
    reported = [said.get() for _ in chosen]
    for process in chosen:
        process.join(TIMEOUT_S)
    answers = sum((one for one in reported if isinstance(one, Counter)), Counter[str]())
    health = next(one for one in reported if isinstance(one, Watched))
    ratio = statistics.median(attacked.took_s) / statistics.median(alone.took_s)
    return Outcome(
        name,
        sum(answers.values()),
        dict(answers),
        len(attacked.took_s),
        ratio,
        attacked.refused,
        1000 * health.slowest_s,
        health.memory_mib,
    )


def repeat(url: str, key: str, attack: Attack, stop: Any, said: Any) -> None:
    """One attacker: the same again and again; says how often it was answered how."""
    os.nice(ATTACKERS_NICE)  # what it computes it would compute on its own machine
    answers: Counter[str] = Counter()
    with httpx.Client(base_url=url, timeout=TIMEOUT_S, headers=bearer(key)) as client:
        while not stop.is_set():
            try:
                answer = attack(client)
            except httpx.TransportError as error:
                refused_early = isinstance(error, httpx.WriteError | httpx.ReadError)  # before the body was sent
                answers["closed" if refused_early else "broken off"] += 1
                continue
            if answer is None:
                stop.wait(0.1)
                continue
            kind = answer.headers.get("Content-Type", "")
            code = answer.json().get("code") if kind == "application/json" and not answer.is_success else None
            answers[code or str(answer.status_code)] += 1
    said.put(answers)


def watch(url: str, stop: Any, said: Any) -> None:
    """Ask whether the server lives, and look how much memory it holds; says the worst of both."""
    slowest_s = memory = 0.0
    looked_s = -math.inf
    with suppress(KeyboardInterrupt):
        while not stop.wait(HEALTH_EVERY_S):
            start, fine = time.perf_counter(), False
            with suppress(httpx.TransportError):
                fine = httpx.get(
                    f"{url}/healthz", timeout=TIMEOUT_S
                ).is_success  # on a connection of its own, as probes
            slowest_s = max(slowest_s, time.perf_counter() - start if fine else math.inf)
            if start - looked_s > MEMORY_EVERY_S:
                memory, looked_s = max(memory, server_memory_mib(url)), start
    said.put(Watched(slowest_s, memory))


def server_memory_mib(url: str) -> float:
    """What the processes of the server's session hold together."""
    port, pages = str(urlsplit(url).port), 0
    groups = {}
    for file in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError, ValueError):
            fields = file.read_text(encoding="utf-8", errors="replace").rsplit(")", 1)[1].split()
            groups[int(file.parent.name)] = (int(fields[3]), int(fields[21]))  # its session and its pages
    for pid in groups:
        with suppress(OSError):
            command = Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")
            if b"serve" in command and port.encode() in command:
                pages = sum(held for session, held in groups.values() if session == pid)
    return pages * resource.getpagesize() / 2**20


if __name__ == "__main__":
    sys.exit(main())
