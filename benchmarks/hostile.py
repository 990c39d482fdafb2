"""What hostile clients cost the others: each attack in turn, on a server of its own on this machine.

    python benchmarks/hostile.py [--seconds 4] [--attackers 2] [--only NAME] [--json]

Starts `rholoc serve` on the shipped map, asks for poses one after the other and for /healthz twenty times a second,
alone and then beside each attack: a few clients that send the same thing again and again for the seconds given. Prints
for each the slowest /healthz, the ratio of the median times of honest frames beside the attack and alone, the most
memory that the server's processes held, how many requests the attack made, and what they were answered; the exit status
is 1 where an answer was `internal`, an honest frame was refused, or the server did not live to the end. Frames compete
with the attack for the same cores, and times depend on the machine's load, which the ratio takes out in part only.
"""

from __future__ import annotations

import argparse
import io
import json
import os
import random
import resource
import socket
import statistics
import struct
import sys
import tempfile
import threading
import time
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from urllib.parse import urlsplit

import httpx
import numpy as np
from PIL import Image

from rholoc.cli.server_process import running_server
from rholoc.service import Settings

MAPS = Path(__file__).parents[1] / "maps"
JPEG = {"Content-Type": "image/jpeg"}
JSON = {"Content-Type": "application/json"}
LOCALIZE = "/v1/maps/testsite/localize"
CAMERA = {"width": 640, "height": 480, "fx": 520.0, "fy": 520.0, "cx": 320.0, "cy": 240.0}
HEALTH_EVERY_S = 0.05
FRAMES_ALONE = 15
TIMEOUT_S = 60.0
DRIBBLERS = 50

Answer = httpx.Response | None
Attack = Callable[[httpx.Client], Answer]


@dataclass(frozen=True)
class Outcome:
    """What one attack cost the others.

    Attributes:
        attack: its name.
        requests: how many it made.
        answers: how many of them were answered so: by error code, else by status.
        frames: how many honest frames were answered meanwhile.
        frame_ratio: the median of their times to that alone; None where none was answered.
        frames_refused: how many of them were not answered with 200.
        health_worst_ms: the slowest answer to /healthz.
        memory_mib: the most that the server's processes held together.
    """

    attack: str
    requests: int
    answers: dict[str, int]
    frames: int
    frame_ratio: float | None
    frames_refused: int
    health_worst_ms: float
    memory_mib: float


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


def post(path: str, content: bytes | str, headers: dict[str, str]) -> Attack:
    """An attack that posts the same again and again."""
    return lambda client: client.post(path, content=content, headers=headers)


def attacks(url: str) -> dict[str, Attack]:
    """All attacks by name."""
    address = urlsplit(url)
    numbers = '{"features":{"pixels":[' + "1," * 4_000_000 + '1],"descriptors":"AA"}}'
    members = "{" + ",".join(f'"{number}":1' for number in range(60_000)) + "}"
    n = Settings().max_features
    valid = {
        "camera": CAMERA,
        "features": {"pixels": [[1.5, 2.5]] * n, "descriptors": ["00" * 32] * n, "channels": [0] * n},
    }
    scans, large = progressive_jpeg(8160, 6120, 1000), progressive_jpeg(4000, 3000, 20)
    noisy, text = noise(3000, 2500, "JPEG"), b"P3 3000 3000 255 " + b"9 " * 15_000_000
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
        "a full descriptor set": post(LOCALIZE, json.dumps(valid), JSON),
        "1000 scans": post(f"{LOCALIZE}?deadline_ms=500", scans, JPEG),
        "20 scans": post(f"{LOCALIZE}?deadline_ms=500", large, JPEG),
        "noise of 7.5 megapixels": post(f"{LOCALIZE}?deadline_ms=500", noisy, JPEG),
        "pixels as text": post(LOCALIZE, text, JPEG),
        "a deep camera": lambda client: client.put("/v1/cameras/deep", content=deep, headers=JSON),
        "a long camera": lambda client: client.put("/v1/cameras/long", content="[" + "1," * 2**22, headers=JSON),
        "half a character": post("/v1/maps/testsite/forget", '{"source":"\\ud800"}', JSON),
        "a map of nothing": lambda client: client.put("/v1/maps/nothing", content=rho_with({"waypoints": ["a"]})),
        "100 000 folders": zip_upload,
        "100 000 parts": post("/v1/recordings", parts, form),
        "connections that dribble": dribble,
        "exports given up": abandon,
        "made-up methods": methods,
        "maps replaced": replace,
    }


def main() -> int:
    """Measure and print; the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=4, help="how long each attack lasts")
    parser.add_argument("--attackers", type=int, default=2, help="how many clients attack at once")
    parser.add_argument("--only", help="the name of one attack")
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "maps").mkdir()
        (folder / "maps" / "testsite.rho").write_bytes((MAPS / "testsite.rho").read_bytes())
        with running_server(folder / "maps", folder / "data", folder / "log") as server:
            found = []
            for one in measured(server.url, options):
                found.append(one)
                if not options.json:
                    print(row(one), flush=True)
    if options.json:
        print(json.dumps([asdict(one) for one in found], indent=2))
    broken = any(one.answers.keys() & {"internal", "broken off"} or one.frames_refused for one in found)
    return 1 if broken else 0


def row(one: Outcome) -> str:
    """A line of the table."""
    ratio = "-" if one.frame_ratio is None else f"{one.frame_ratio:.1f}"
    answers = ", ".join(f"{code} {count}" for code, count in one.answers.items())
    costs = f"{one.frames:3} frames, {ratio:>5} ×, /healthz {one.health_worst_ms:5.0f} ms, {one.memory_mib:5.0f} MiB"
    return f"{one.attack:26} {costs}  {answers}"


def measured(url: str, options: argparse.Namespace) -> Iterator[Outcome]:
    """The outcome of each attack, as it is found; of none first."""
    picture = sorted((MAPS / "queries").glob("*.jpg"))[0].read_bytes()
    with httpx.Client(base_url=url, timeout=TIMEOUT_S) as honest:

        def frame() -> tuple[float, bool]:
            start = time.perf_counter()
            answer = honest.post(f"{LOCALIZE}?deadline_ms=30000", content=picture, headers=JPEG)
            return time.perf_counter() - start, answer.is_success

        frame()
        alone_s = statistics.median(frame()[0] for _ in range(FRAMES_ALONE))
        chosen = {name: one for name, one in attacks(url).items() if options.only in (None, name)}
        yield beside(url, "none", lambda _: None, frame, alone_s, options)
        for name, attack in chosen.items():
            yield beside(url, name, attack, frame, alone_s, options)
            alone_s = statistics.median(frame()[0] for _ in range(FRAMES_ALONE))  # the machine's load changes


def beside(
    url: str,
    name: str,
    attack: Attack,
    frame: Callable[[], tuple[float, bool]],
    alone_s: float,
    options: argparse.Namespace,
) -> Outcome:
    """The outcome of one attack."""
    stop = threading.Event()
    answers: Counter[str] = Counter()
    health_s: list[float] = []
    memory: list[float] = []

    def repeat() -> None:
        with httpx.Client(base_url=url, timeout=TIMEOUT_S) as client:
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

    def watch() -> None:
        with httpx.Client(base_url=url, timeout=TIMEOUT_S) as client:
            while not stop.wait(HEALTH_EVERY_S):
                start = time.perf_counter()
                client.get("/healthz").raise_for_status()
                health_s.append(time.perf_counter() - start)
                memory.append(server_memory_mib(url))

    threads = [threading.Thread(target=watch)]
    threads += [threading.Thread(target=repeat) for _ in range(0 if name == "none" else options.attackers)]
    for thread in threads:
        thread.start()
    frames: list[float] = []
    refused = 0
    last_s = time.monotonic() + options.seconds
    while time.monotonic() < last_s:
        took_s, fine = frame()
        frames.append(took_s)
        refused += not fine
    stop.set()
    for thread in threads:
        thread.join(2 * TIMEOUT_S)
    ratio = statistics.median(frames) / alone_s if frames else None
    worst_ms = 1000 * max(health_s, default=float("nan"))
    total = sum(answers.values())
    return Outcome(name, total, dict(answers), len(frames), ratio, refused, worst_ms, max(memory, default=0.0))


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
    os.nice(5)  # the honest clients' times are of the server, not of the attackers
    sys.exit(main())
