"""What looking at maps costs the robots: the time of a request for a pose, alone and while 26 pictures are asked for.

    python benchmarks/robots_beside_previews.py [--rounds 3] [--json]

Starts a service of its own with 26 maps on this machine, asks for poses one after the other, then again beside 26
requests for pictures at once, each of a map that was not drawn before. Prints the ratio of the medians of each round,
and that of the slowest request to the median alone. Times depend on the machine and its load; their ratio less so.
"""

from __future__ import annotations

import argparse
import json
import shutil
import socket
import statistics
import tempfile
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import httpx
import uvicorn

from rholoc.service import Settings, create_app

MAPS = Path(__file__).parents[1] / "maps"
PREVIEWS = 26
ALONE = 20
TIMEOUT_S = 300


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    rounds = [measure() for _ in range(options.rounds)]
    if options.json:
        print(json.dumps(rounds, indent=2))
        return
    print("alone, ms   beside 26 pictures, ms   ratio of medians   slowest / median alone   pictures took, s")
    for one in rounds:
        print(
            f"{one['alone_ms']:9.0f}   {one['beside_ms']:22.0f}   {one['ratio']:16.2f}   {one['slowest_ratio']:22.1f}"
            f"   {one['pictures_s']:16.1f}"
        )


def measure() -> dict[str, float]:
    """One round on a fresh service."""
    folder = Path(tempfile.mkdtemp())
    (folder / "maps").mkdir()
    for number in range(PREVIEWS):
        shutil.copy(MAPS / "testsite.rho", folder / "maps" / f"map{number}.rho")
    listener = socket.create_server(("127.0.0.1", 0))
    settings = Settings(maps_dir=folder / "maps", data_dir=folder / "data", worker=False)
    server = uvicorn.Server(uvicorn.Config(create_app(settings), log_level="error"))
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]}, daemon=True)
    thread.start()
    url = f"http://127.0.0.1:{listener.getsockname()[1]}"
    try:
        httpx.get(f"{url}/healthz", timeout=TIMEOUT_S)
        return compare(url, next((MAPS / "queries").glob("*.jpg")).read_bytes())
    finally:
        server.should_exit = True
        thread.join(10)
        shutil.rmtree(folder)


def compare(url: str, picture: bytes) -> dict[str, float]:
    """Milliseconds alone and beside the pictures, and their ratios."""
    with httpx.Client(timeout=TIMEOUT_S) as robot, ThreadPoolExecutor(PREVIEWS) as lookers:

        def ask() -> float:
            start = time.perf_counter()
            headers = {"Content-Type": "image/jpeg"}
            robot.post(f"{url}/v1/maps/map0/localize", content=picture, headers=headers).raise_for_status()
            return 1000 * (time.perf_counter() - start)

        for _ in range(3):
            ask()
        alone = [ask() for _ in range(ALONE)]
        start = time.perf_counter()
        pictures = [
            lookers.submit(httpx.get, f"{url}/v1/maps/map{number}/preview.png", timeout=TIMEOUT_S)
            for number in range(PREVIEWS)
        ]
        beside = []
        while not all(one.done() for one in pictures):
            beside.append(ask())
        pictures_s = time.perf_counter() - start
        for one in pictures:
            one.result().raise_for_status()
    median = statistics.median(alone)
    return {
        "alone_ms": median,
        "beside_ms": statistics.median(beside),
        "ratio": statistics.median(beside) / median,
        "slowest_ratio": max(beside) / median,
        "pictures_s": pictures_s,
    }


if __name__ == "__main__":
    main()
