"""``rholoc map info``: a page for people, the most important first."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from rholoc.geometry import Camera
from rholoc.maps import Map, save_map
from rholoc.reports import Advice, CoachingReport, ExpectedError, MapReport, TrajectoryReport, WalkFigures

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def hall(point_room: Any) -> Map:
    """A map whose walk bent, and was too fast."""
    map_: Map = point_room.map_of(point_room.walk(20), "walk")
    bent = TrajectoryReport(method="visual", trusted=False, why="Two reconstructions disagree.")
    advice = Advice("too_fast", "Turn more slowly: 80°/s.", 80.0, 40.0)
    report = MapReport(
        trajectories=(bent,),
        expected_error=ExpectedError(rms_m=0.021),
        coaching=(CoachingReport("walk", WalkFigures(), advice=(advice,)),),
    )
    return replace(map_, info=replace(map_.info, report=report))


def test_trust_comes_first_then_the_room_and_advice_last(rholoc: Run, file: Path) -> None:
    status, printed, errors = rholoc("info", file)
    assert status == 0, errors
    lines = [" ".join(line.split()) for line in printed.splitlines()]
    assert lines[1] == "trusted no. Two reconstructions disagree."
    assert lines[2] == "expected error 2.1 cm (rms)"
    assert lines[3].startswith("room ")
    assert lines[-1] == "next time (walk): Turn more slowly: 80°/s."
    assert "report." not in printed


def test_the_camera_is_written_for_people(rholoc: Run, hall: Map, tmp_path: Path) -> None:
    camera = Camera(640, 480, 527.0473215906645, 527.0786450991611, 319.49999986565405, 239.5)
    save_map(replace(hall, info=replace(hall.info, camera=camera)), tmp_path / "hall.rho")
    printed = " ".join(rholoc("info", tmp_path / "hall.rho")[1].split())
    assert "camera pinhole, 640×480 px, focal length 527.1 px, centre 319.5, 239.5 px" in printed


def test_a_map_without_metres_says_so(rholoc: Run, hall: Map, tmp_path: Path) -> None:
    save_map(replace(hall, info=replace(hall.info, metric=False)), tmp_path / "bare.rho")
    assert "in a unit of unknown length" in rholoc("info", tmp_path / "bare.rho")[1]


def test_json_has_everything(rholoc: Run, file: Path, hall: Map) -> None:
    figures = json.loads(rholoc("info", file, "--json")[1])
    assert figures["landmarks"] == len(hall)
    assert figures["report"]["trajectories"][0]["trusted"] is False
