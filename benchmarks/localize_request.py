"""How long one /localize request takes on one core, stage by stage.

    python benchmarks/localize_request.py MAP.rho FRAMES --camera fx,fy,cx,cy --frames 200:400

Starts the service, pinned to one core, on 127.0.0.1, posts the frames as they are one after another, and prints what a
request costs it in CPU, and the median and the 90th percentile of each stage on the clock. Ends by
itself.
"""

from __future__ import annotations

import argparse
import os
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
import numpy as np

from rholoc.recordings import read_recording

START_SECONDS = 60


def free_port() -> int:
    """A port that is free now."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return int(listener.getsockname()[1])


def start(folder: Path, port: int) -> subprocess.Popen[bytes]:
    """The service on one core, serving ``folder``."""
    core = min(os.sched_getaffinity(0))
    command = [
        sys.executable,
        "-c",
        "from rholoc.cli import main; main()",
        "serve",
        "--port",
        str(port),
        "--maps",
        str(folder / "maps"),
    ]
    command += ["--data", str(folder / "data"), "--no-worker"]
    single = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    service = subprocess.Popen(
        command, env={**os.environ, **single}, preexec_fn=lambda: os.sched_setaffinity(0, {core}),
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    deadline = time.monotonic() + START_SECONDS
    while time.monotonic() < deadline and service.poll() is None:
        try:
            if httpx.get(f"http://127.0.0.1:{port}/readyz").status_code == 200:
                return service
        except httpx.TransportError:
            time.sleep(0.1)
    service.kill()
    raise SystemExit("The service did not start.")


@dataclass
class Answers:
    """What a run of requests was answered: CPU milliseconds a request, milliseconds by stage, and the poses."""

    cpu_ms: float = 0.0
    spent: dict[str, list[float]] = field(default_factory=dict)
    poses: list[dict[str, Any] | None] = field(default_factory=list)


def cpu_seconds(pid: int) -> float:
    """What a process has used so far, all its threads."""
    ticks = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[11:13]
    return sum(map(int, ticks)) / os.sysconf("SC_CLK_TCK")


def post_frames(
    port: int,
    pid: int,
    files: list[Path],
    fields: dict[str, str],
) -> Answers:
    """One request a frame; ``round trip`` is what the caller sees."""
    answers = Answers()
    before_s = cpu_seconds(pid)
    with httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=30) as client:
        for file in files:
            content = file.read_bytes()
            begun = time.perf_counter()
            answer = client.post(
                "/v1/maps/bench/localize", params=fields, content=content, headers={"Content-Type": "image/jpeg"}
            )
            elapsed_ms = 1e3 * (time.perf_counter() - begun)
            answer.raise_for_status()
            body = answer.json()
            answers.poses.append(body["pose"])
            for stage, value in {**body["timings_ms"], "round trip": elapsed_ms}.items():
                answers.spent.setdefault(stage, []).append(value)
    answers.cpu_ms = 1e3 * (cpu_seconds(pid) - before_s) / len(files)
    return answers


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("map", type=Path)
    parser.add_argument("frames_folder", type=Path)
    parser.add_argument("--camera", required=True)
    parser.add_argument("--frames")
    parser.add_argument("--dof", default="auto")
    parser.add_argument("--every", type=int, default=4)
    args = parser.parse_args()
    recording = read_recording(args.frames_folder, frames=args.frames)
    by_number = {int("".join(c for c in p.stem if c.isdigit())): p for p in args.frames_folder.glob("*.jpg")}
    files = [by_number[int(number)] for number in recording.frames.numbers[:: args.every]]
    fields = dict(zip(("fx", "fy", "cx", "cy"), args.camera.split(","), strict=True)) | {"dof": args.dof}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "maps").mkdir()
        shutil.copy(args.map, folder / "maps" / "bench.rho")
        port = free_port()
        service = start(folder, port)
        try:
            post_frames(port, service.pid, files[:2], fields)  # the first request builds the map's index
            answers = post_frames(port, service.pid, files, fields)
        finally:
            service.terminate()
            service.wait(20)
    print(f"{len(files)} requests, one core; {sum(p is not None for p in answers.poses)} localized")
    print(f"  CPU of the service: {answers.cpu_ms:.1f} ms a request")
    print(f"{'stage':12}{'median ms':>12}{'90 % ms':>12}")
    for stage, values in answers.spent.items():
        print(f"{stage:12}{np.median(values):12.1f}{np.percentile(values, 90):12.1f}")


if __name__ == "__main__":
    main()
