"""How long one /localize request takes on one core, stage by stage.

    python benchmarks/localize_request.py MAP.rho FRAMES --camera fx,fy,cx,cy --frames 200:400 --dof 6

Starts the service, pinned to one core, on 127.0.0.1, posts the frames as they are one after another, and prints the
median and the 90th percentile of each stage. Ends by itself.
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
from pathlib import Path

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


def post_frames(port: int, files: list[Path], fields: dict[str, str]) -> dict[str, list[float]]:
    """Milliseconds by stage of each request; ``round trip`` is what the caller sees."""
    spent: dict[str, list[float]] = {}
    with httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=30) as client:
        for file in files:
            content = file.read_bytes()
            begun = time.perf_counter()
            answer = client.post(
                "/v1/maps/bench/localize", params=fields, content=content, headers={"Content-Type": "image/jpeg"}
            )
            elapsed_ms = 1e3 * (time.perf_counter() - begun)
            answer.raise_for_status()
            for stage, value in {**answer.json()["timings_ms"], "round trip": elapsed_ms}.items():
                spent.setdefault(stage, []).append(value)
    return spent


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("map", type=Path)
    parser.add_argument("frames_folder", type=Path)
    parser.add_argument("--camera", required=True)
    parser.add_argument("--frames")
    parser.add_argument("--dof", default="6")
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
            post_frames(port, files[:2], fields)  # the first request builds the map's index
            spent = post_frames(port, files, fields)
        finally:
            service.terminate()
            service.wait(20)
    print(f"{len(files)} requests, one core")
    print(f"{'stage':12}{'median ms':>12}{'90 % ms':>12}")
    for stage, values in spent.items():
        print(f"{stage:12}{np.median(values):12.1f}{np.percentile(values, 90):12.1f}")


if __name__ == "__main__":
    main()
