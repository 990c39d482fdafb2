"""``rholoc demo`` as a process, and what it says of a map."""

import os
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

import pytest

from rholoc.cli.demo import DemoFigures
from rholoc.evaluation import Evaluation
from rholoc.simulation import PHONE_CAMERA, simulate_recording
from rholoc_client import Camera, MapSummary
from waiting import BREAKS_WORKERS

_MARK = "RHOLOC_TEST_MARK"
_ENDS_WITHIN_S = (
    30.0  # two seconds for the server, and what a busy machine takes; left alone it would go on for minutes
)
_KILLED_ENDS_WITHIN_S = 10.0
_STARTS_WITHIN_S = 200.0
_REPORTED_WITHIN_S = 30.0

# The demo, but for its first walk, which is there already: rendering it takes longest.
_DEMO = """
import shutil, sys
import rholoc.simulation
from rholoc.cli import main
walk, out = sys.argv[1:]
if walk:
    rholoc.simulation.simulate_recording = lambda folder, **_: shutil.copytree(walk, folder)
sys.argv = ["rholoc", "demo", "--out", out]
main()
"""


class Demo:
    """A running demo; every process that it starts inherits a mark in its environment."""

    def __init__(self, folder: Path, walk: Path | None, environment: Mapping[str, str] = MappingProxyType({})) -> None:
        self._mark = f"{_MARK}={uuid.uuid4().hex}"
        self._errors = folder / "errors.txt"
        name, _, value = self._mark.partition("=")
        with self._errors.open("wb") as errors:
            self.process = subprocess.Popen(
                [sys.executable, "-c", _DEMO, str(walk or ""), str(folder / "demo")],
                env={**os.environ, **environment, name: value},
                stdout=subprocess.DEVNULL,
                stderr=errors,
                start_new_session=True,
            )
        self.walk = folder / "demo" / "recordings" / "walk-1"

    @property
    def said(self) -> str:
        """What it has said so far."""
        return self._errors.read_text()

    def processes(self) -> set[int]:
        """The processes that carry the mark and have not ended."""
        found = set()
        for file in Path("/proc").glob("[0-9]*/environ"):
            try:
                if self._mark.encode() in file.read_bytes().split(b"\0"):
                    found.add(int(file.parent.name))
            except OSError:  # another user's, or it has ended
                continue
        return found

    def reach(self, stage: str) -> None:
        """Wait until the demo is in a stage."""
        deadline = time.monotonic() + _STARTS_WITHIN_S
        while not self._is_in(stage):
            assert time.monotonic() < deadline, self.said
            assert self.process.poll() is None, self.said
            time.sleep(0.1)

    def leaves_nothing(self) -> None:
        """Wait until its last process is gone: one that was killed takes a moment to end."""
        deadline = time.monotonic() + _KILLED_ENDS_WITHIN_S
        while left := self.processes():
            assert time.monotonic() < deadline, left
            time.sleep(0.1)

    def _is_in(self, stage: str) -> bool:
        return self.walk.exists() if stage == "simulating" else stage in self.said


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short walk, quickly drawn."""
    folder = tmp_path_factory.mktemp("walk") / "walk"
    simulate_recording(folder, seconds=8.0, fps=6.0, camera=PHONE_CAMERA.resized(320, 240))
    return folder


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="processes are found by way of /proc")
@pytest.mark.parametrize(
    ("stage", "number"),
    [("simulating", signal.SIGINT), ("features", signal.SIGTERM)],
)
def test_a_demo_that_is_stopped_leaves_no_process_behind(
    stage: str, number: signal.Signals, walk: Path, tmp_path: Path
) -> None:
    demo = Demo(tmp_path, None if stage == "simulating" else walk)
    try:
        demo.reach(stage)
        assert demo.process.pid in demo.processes()
        demo.process.send_signal(number)
        assert demo.process.wait(_ENDS_WITHIN_S) == 130
        demo.leaves_nothing()
        assert "Traceback" not in demo.said
    finally:
        for pid in demo.processes():
            os.kill(pid, signal.SIGKILL)
        demo.process.wait()


@pytest.mark.slow
def test_a_demo_whose_worker_dies_again_and_again_ends_with_why(walk: Path, tmp_path: Path) -> None:
    (tmp_path / "sitecustomize.py").write_text(BREAKS_WORKERS)
    demo = Demo(tmp_path, walk, {"PYTHONPATH": str(tmp_path)})
    try:
        demo.reach("simulated walk-1")
        assert demo.process.wait(_STARTS_WITHIN_S + _REPORTED_WITHIN_S) == 1
    finally:
        for pid in demo.processes():
            os.kill(pid, signal.SIGKILL)
        demo.process.wait()
    (line,) = [line for line in demo.said.splitlines() if line.startswith("rholoc: ")]
    assert "the worker died" in line
    assert "its library is broken" in line


def test_the_demo_says_what_the_map_expects_and_whether_it_is_trusted() -> None:
    camera = Camera(640, 480, 500.0, 500.0, 319.5, 239.5)
    described = ("testsite", "0" * 32, 1, "ray", "lab3", "metric", True, "2026-01-01T00:00:00Z", 900, 60, 400_000)
    summary = MapSummary(*described, camera, trusted=False, trust_reason="START is missed.", expected_error_m=0.0123)
    evaluation = Evaluation(300, 300, 2.5, 0.5, 5.0, 1.0, 0.84, 0.9, 1.0)
    figures = DemoFigures(evaluation, summary, ("The frame poses are not trusted: ...",), 30.0, 60.0, 99.0)
    rows = figures.rows()
    assert rows["median error"] == "2.50 cm, 0.50°"
    assert rows["the map's expected error"] == "1.23 cm (rms)"
    assert rows["trusted"] == "no. START is missed."
    assert figures.as_dict()["trusted"] is False
    assert figures.as_dict()["warnings"] == ["The frame poses are not trusted: ..."]
