"""``rholoc map list`` and ``rholoc job list``: what there is, and whether it is to be trusted."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from rholoc.jobs import Job, JobPriority, JobState
from rholoc.jobs.queue import JobQueue
from rholoc.library import RecordingStore
from rholoc.maps import Map, MapInfo, save_map
from rholoc.progress import Stage
from rholoc.reports import ExpectedError, MapReport, TrajectoryReport

Run = Callable[..., tuple[int, str, str]]


def with_report(map_: Map, report: MapReport) -> Map:
    info: MapInfo = replace(map_.info, report=report)
    return replace(map_, info=info)


def test_maps_are_listed_with_their_trust(point_room, tmp_path: Path, command: Run) -> None:
    map_ = point_room.map_of(point_room.walk(20), "walk")
    bent = TrajectoryReport(method="visual", trusted=False, why="Two reconstructions disagree.")
    known = ExpectedError(rms_m=0.021, worst_m=0.03, worst_time_s=1.0, views_m=(0.02, None))
    save_map(with_report(map_, MapReport()), tmp_path / "a.rho")
    save_map(with_report(map_, MapReport(trajectories=(bent,), expected_error=known)), tmp_path / "b.rho")
    (tmp_path / "c.rho").write_bytes(b"no map")
    _, printed, errors = command("map", "list", tmp_path)
    first, second = printed.splitlines()
    assert first.startswith("a: ")
    assert "expected error unknown, trusted: unknown" in first
    assert "expected error 2.1 cm, trusted: no. Two reconstructions disagree." in second
    assert "c" in errors
    rows = json.loads(command("map", "list", tmp_path, "--json")[1])
    found = [(row["name"], row["trusted"], row["expected_error_m"]) for row in rows]
    assert found == [("a", None, None), ("b", False, 0.021)]


def test_jobs_are_listed_with_their_trust(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: Run) -> None:
    def job(number: int, state: JobState, warnings: tuple[str, ...], error: str | None) -> Job:
        code = None if error is None else "mapping_failed"
        return Job(
            str(number) * 32, "r" * 32, f"map-{number}", state, Stage.POSES, 1.0, "", (), warnings,
            code, error, error and "", float(number), None, None, 1,
        )  # fmt: skip

    jobs = [
        job(1, JobState.PUBLISHED, (), None),
        job(2, JobState.PUBLISHED, ("The walk is bent.",), None),
        job(3, JobState.FAILED, (), "Too dark."),
        job(4, JobState.RUNNING, (), None),
    ]
    monkeypatch.setattr(JobQueue, "list", lambda _: jobs)
    lines = [line.partition(": ")[2] for line in command("job", "list", "--data", tmp_path)[1].splitlines()]
    assert lines == [
        "map-4, running, poses",
        "map-3, failed: Too dark.",
        "map-2, published, trusted: no. The walk is bent.",
        "map-1, published, trusted: yes",
    ]
    assert [row["trusted"] for row in json.loads(command("job", "list", "--data", tmp_path, "--json")[1])] == [
        None,
        None,
        False,
        True,
    ]


def test_a_job_that_waits_gets_another_priority(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: Run) -> None:
    recordings = RecordingStore(tmp_path)
    queue = JobQueue(recordings)
    job = queue.submit(recordings.create([("walk.mp4", [b"x"])]).id, "hall")
    assert command("job", "prioritize", job.id, "high", "--data", tmp_path)[0] == 0
    assert queue.get(job.id).priority is JobPriority.HIGH
    queue.close()
    assert "waiting for a worker: none is running" in command("job", "list", "--data", tmp_path)[1]


def test_a_database_that_cannot_be_used_is_one_line(command: Run, tmp_path: Path) -> None:
    (tmp_path / "jobs.sqlite").write_text("no database")
    for asked in (["list"], ["prioritize", "0" * 32, "high"]):
        status, _, said = command("job", *asked, "--data", tmp_path)
        assert (status, said.count("\n")) == (1, 1)
        assert "not a database of jobs" in said
