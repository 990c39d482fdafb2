"""A walk with a phone → its published map: how many seconds each stage takes, and the most memory that was held.

    python benchmarks/mapping_stages.py [--seconds 30 | --recording PATH] [--poses visual-inertial] [--json]

What a worker does for a job, in this process, with a simulated walk or a recording: wall clock seconds, so leave the
machine alone meanwhile. Memory is that of all processes together, beside what the worker would have expected.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import threading
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rholoc.jobs import JobOptions, MappingPipeline, MappingTask
from rholoc.jobs.capacity import memory_for
from rholoc.maps import MapLibrary
from rholoc.processes.tree import group_memory_bytes
from rholoc.progress import Stage
from rholoc.recordings import read_recording
from rholoc.reports import report_to_json
from rholoc.simulation import simulate_recording
from rholoc.trajectory import PoseMethod

WATCH_EVERY_S = 0.2


class StageClock:
    """A progress listener that adds up the seconds of each stage."""

    def __init__(self) -> None:
        self.seconds: dict[Stage, float] = defaultdict(float)
        self._stage, self._since_s = Stage.READ, time.monotonic()

    def __call__(self, stage: Stage, fraction: float, message: str = "") -> None:
        now_s = time.monotonic()
        self.seconds[self._stage] += now_s - self._since_s
        self._stage, self._since_s = stage, now_s


@contextmanager
def memory_watched() -> Iterator[list[int]]:
    """What the processes of this one's group held, in bytes, again and again."""
    held, stopping = [0], threading.Event()

    def watch() -> None:
        while not stopping.wait(WATCH_EVERY_S):
            held.append(group_memory_bytes(os.getpgrp()))

    watcher = threading.Thread(target=watch)
    watcher.start()
    try:
        yield held
    finally:
        stopping.set()
        watcher.join()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--recording", type=Path, help="instead of a simulated walk")
    parser.add_argument("--poses", type=PoseMethod, choices=list(PoseMethod), default=PoseMethod.VISUAL_INERTIAL)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        recording = arguments.recording or folder / "walk"
        if arguments.recording is None:
            simulate_recording(recording, seconds=arguments.seconds)
        read = read_recording(recording)
        options = JobOptions(poses=arguments.poses)
        task = MappingTask(recording, folder / "map.rho", folder / "maps", "walk", options)
        clock = StageClock()
        with memory_watched() as held:
            MappingPipeline().build(task, clock)
        clock(Stage.PUBLISHED, 0.0)
        warnings = MappingPipeline().publish(task, MapLibrary(task.maps_dir))
        clock(Stage.PUBLISHED, 1.0)
        report = MapLibrary(folder / "maps").get("walk").info.report
    figures = {
        "recording_s": round(float(read.frames.times[-1] - read.frames.times[0]), 1),
        "frame_px": list(read.frames.size),
        "cores": len(os.sched_getaffinity(0)),
        "stages_s": {str(stage): round(clock.seconds[stage], 1) for stage in Stage if clock.seconds[stage]},
        "total_s": round(sum(clock.seconds.values()), 1),
        "peak_memory_gb": round(max(held) / 1e9, 2),
        "expected_memory_gb": round(memory_for(read) / 1e9, 2),
        "held_out": report_to_json(report.held_out),
        "warnings": list(warnings),
    }
    print(json.dumps(figures) if arguments.json else "\n".join(f"{name:12} {value}" for name, value in figures.items()))


if __name__ == "__main__":
    main()
