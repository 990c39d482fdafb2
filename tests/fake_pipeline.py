"""A pipeline that is quick, can be held at any point, and notes what it did. Run as a script it is a real worker."""

import os
import re
import signal
import sys
import threading
import time
import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np

from rholoc.errors import InvalidRecording, UnknownMap
from rholoc.geometry import Camera
from rholoc.jobs import Capacity, JobKind, MoreMemoryNeeded
from rholoc.library.maps import MapLibrary
from rholoc.maps import (
    DensityKind,
    Map,
    MapDescriptors,
    MapInfo,
    MapLandmarks,
    MapObservations,
    MapViews,
    MapWaypoint,
    save_map,
)
from rholoc.progress import ProgressListener, Stage
from rholoc.reports import MapReport, TrajectoryReport
from rholoc.worker import Timing, WorkerSetup
from rholoc.worker.pipeline import MappingPipeline, MappingTask
from rholoc.worker.worker import run_worker

TIMING = Timing(poll_s=0.1, heartbeat_s=0.25, dead_after_s=1.5, cancel_grace_s=0.5)
_NOT_OF_BUILDS = (Stage.RECEIVED, Stage.LINKS, Stage.PUBLISHED)
BUILD_STAGES: tuple[Stage, ...] = tuple(stage for stage in Stage if stage not in _NOT_OF_BUILDS)
KILL_POINTS = (*BUILD_STAGES, "built", "publishing", "after-publishing")


@dataclass(frozen=True)
class Control:
    """What a test and a worker tell each other through files in a folder."""

    folder: Path

    def hold(self, point: str) -> None:
        """Let workers wait at the point."""
        (self.folder / f"hold-{point}").touch()

    def let_go(self, point: str) -> None:
        """Let workers go on."""
        (self.folder / f"hold-{point}").unlink()

    def held(self, point: str) -> bool:
        """Whether workers shall wait."""
        return (self.folder / f"hold-{point}").exists()

    def reach(self, point: str) -> None:
        """Note that a worker is at the point."""
        with (self.folder / "events").open("a", encoding="utf-8") as file:
            file.write(f"{point}\n")

    def count(self, point: str) -> int:
        """How often workers were at the point."""
        events = self.folder / "events"
        return events.read_text(encoding="utf-8").split("\n").count(point) if events.exists() else 0

    def processes(self) -> list[int]:
        """The processes that built."""
        events = (self.folder / "events").read_text(encoding="utf-8").split("\n")
        return [int(event.split()[1]) for event in events if event.startswith("process ")]


class FakePipeline(MappingPipeline):
    """Builds a map of one feature; publishes, and places the maps of sites, as the real pipeline does."""

    def __init__(self, control: Control) -> None:
        self.control = control

    def build(self, task: MappingTask, progress: ProgressListener) -> MoreMemoryNeeded | None:
        if task.built_file.exists():
            return None
        if task.options.kind is JobKind.PLACE:
            return super().build(task, self._held(progress))
        needed_gib = re.match(r"(\d+) GiB", task.recording.read_text())
        if needed_gib and int(needed_gib[1]) * 2**30 > task.memory_bytes:
            return MoreMemoryNeeded(int(needed_gib[1]) * 2**30)
        killed_gib = re.match(r"killed below (\d+) GiB", task.recording.read_text())
        if killed_gib and int(killed_gib[1]) * 2**30 > task.memory_bytes:
            os.kill(os.getpid(), signal.SIGKILL)  # as a system does that is short of memory
        self.control.reach(f"process {os.getpid()}")
        for stage in BUILD_STAGES:
            progress(stage, 0.5, f"at {stage}")
            self.control.reach(stage)
            while self.control.held(stage):
                progress(stage, 0.5, f"at {stage}")
                time.sleep(0.02)
            self._wait(f"deaf-{stage}")
            self._kill_once(task, stage, os.getppid())
            self._obey(task.recording.read_bytes(), stage)
        save_map(tiny_map(trusted=task.recording.read_bytes() != b"a doubtful walk"), task.built_file)
        self.control.reach("built")
        self._wait("built")
        self._kill_once(task, "built", os.getppid())
        return None

    def _held(self, progress: ProgressListener) -> ProgressListener:
        """Progress that is noted and may be held, like that of the stages of a build."""

        def note(stage: Stage, fraction: float, message: str = "") -> None:
            progress(stage, fraction, message)
            self.control.reach(stage)
            self.control.reach(message)
            while self.control.held(message):
                progress(stage, fraction, message)
                time.sleep(0.02)

        return note

    def publish(self, task: MappingTask, library: MapLibrary) -> tuple[str, ...]:
        self._wait("publishing")
        self._kill_once(task, "publishing", os.getpid())
        before = _signature(library, task.map_name)
        doubts = super().publish(task, library)
        if _signature(library, task.map_name) != before:
            self.control.reach("put")
            self.control.reach(f"put {task.map_name}")
        self._wait("after-publishing")
        self._kill_once(task, "after-publishing", os.getpid())
        return doubts

    def furnish(self, task: MappingTask, *_: object) -> None:
        """Draw nothing."""
        self._wait(f"furnish {task.map_name}")

    def _wait(self, point: str) -> None:
        if self.control.held(point):
            self.control.reach(point)
        while self.control.held(point):
            time.sleep(0.02)

    def _kill_once(self, task: MappingTask, point: str, worker: int) -> None:
        """Kill the worker where the recording says so, the first time."""
        killed = self.control.folder / f"killed-{task.map_name}-{point}"
        if f" {point}," in task.recording.read_text() and not killed.exists():
            killed.touch()
            os.kill(worker, signal.SIGKILL)
            time.sleep(60)  # a build is killed with its worker

    def _obey(self, recording: bytes, stage: Stage) -> None:
        if recording == f"unreadable at {stage}".encode():
            raise InvalidRecording("The video has no frames.", "Record it again.")
        if recording == f"bug at {stage}".encode():
            raise ZeroDivisionError("something\nwith lines")
        if recording == f"crash at {stage}".encode():
            os.kill(os.getpid(), signal.SIGKILL)
        if recording == f"disk full at {stage}".encode():
            raise OSError(28, "No space left on device")


def tiny_map(trusted: bool = True, waypoints: Mapping[str, Sequence[float]] = MappingProxyType({})) -> Map:
    """A valid map of one feature in one view, with waypoints at some positions."""
    info = MapInfo(
        id=uuid.uuid4().hex,
        version=1,
        density=DensityKind.RAY,
        features="gray",
        metric=True,
        upright=True,
        created="2025-01-01T00:00:00Z",
        camera=Camera(width=640, height=480, fx=500.0, fy=500.0, cx=320.0, cy=240.0),
        waypoints=tuple(MapWaypoint(name, (x, y, z)) for name, (x, y, z) in waypoints.items()),
        report=MapReport(
            trajectories=(TrajectoryReport("visual", 9, trusted=trusted, why="Two reconstructions disagree."),)
        ),
    )
    return Map(
        info=info,
        landmarks=MapLandmarks(
            channels=np.zeros(1, np.uint8),
            positions=np.ones((1, 3), np.float32),
            covariances=np.eye(3, dtype=np.float32)[None] * np.float32(1e-4),
        ),
        descriptors=MapDescriptors(values=np.zeros((1, 32), np.uint8), features=np.zeros(1, np.int32)),
        views=MapViews(times=np.zeros(1), T_map_camera=np.eye(4)[None]),
        observations=MapObservations(views=np.zeros(1, np.int32), features=np.zeros(1, np.int32)),
    )


def orphaned() -> threading.Event:
    """Set once the process that started this one is gone, however it ended."""
    parent, event = os.getppid(), threading.Event()

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(0.5)
        event.set()

    threading.Thread(target=watch, daemon=True).start()
    return event


def _signature(library: MapLibrary, name: str) -> tuple[int, int, int] | None:
    try:
        return library.stat(name).signature
    except UnknownMap:
        return None


if __name__ == "__main__":
    data_dir, maps_dir, control_dir = map(Path, sys.argv[1:4])
    jobs, memory_gib = int(sys.argv[4]), float(sys.argv[5])
    database_url, storage_url = sys.argv[6:] or (None, None)
    from fake_pipeline import FakePipeline as ImportablePipeline  # not of __main__, so that it can be pickled

    run_worker(
        WorkerSetup(data_dir, maps_dir, database_url, storage_url, Capacity(jobs, memory_gib * 2**30)),
        pipeline=ImportablePipeline(Control(control_dir)),
        timing=TIMING,
        stop=orphaned(),
    )
