"""A simulated walk with a phone → its published map: how many seconds each stage takes.

    python benchmarks/mapping_stages.py [--seconds 30] [--poses visual-inertial] [--json]

What a worker does for a job, in this process: wall clock seconds, so leave the machine alone meanwhile.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from collections import defaultdict
from pathlib import Path

from rholoc.jobs import JobOptions, MappingPipeline, MappingTask
from rholoc.maps import MapLibrary
from rholoc.progress import Stage
from rholoc.reports import report_to_json
from rholoc.simulation import simulate_recording
from rholoc.trajectory import PoseMethod


class StageClock:
    """A progress listener that adds up the seconds of each stage."""

    def __init__(self) -> None:
        self.seconds: dict[Stage, float] = defaultdict(float)
        self._stage, self._since_s = Stage.READ, time.monotonic()

    def __call__(self, stage: Stage, fraction: float, message: str = "") -> None:
        now_s = time.monotonic()
        self.seconds[self._stage] += now_s - self._since_s
        self._stage, self._since_s = stage, now_s


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--poses", type=PoseMethod, choices=list(PoseMethod), default=PoseMethod.VISUAL_INERTIAL)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        simulate_recording(folder / "walk", seconds=arguments.seconds)
        options = JobOptions(poses=arguments.poses)
        task = MappingTask(folder / "walk", folder / "map.rho", folder / "maps", "walk", options)
        clock = StageClock()
        MappingPipeline().build(task, clock)
        clock(Stage.PUBLISHED, 0.0)
        warnings = MappingPipeline().publish(task, MapLibrary(task.maps_dir))
        clock(Stage.PUBLISHED, 1.0)
        report = MapLibrary(folder / "maps").get("walk").info.report
    figures = {
        "recording_s": arguments.seconds,
        "cores": len(os.sched_getaffinity(0)),
        "stages_s": {str(stage): round(clock.seconds[stage], 1) for stage in Stage if clock.seconds[stage]},
        "total_s": round(sum(clock.seconds.values()), 1),
        "held_out": report_to_json(report.held_out),
        "warnings": list(warnings),
    }
    print(json.dumps(figures) if arguments.json else "\n".join(f"{name:12} {value}" for name, value in figures.items()))


if __name__ == "__main__":
    main()
