"""``rholoc paper``."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from rholoc.maps import load_map, observations_csv, read_trajectory_csv
from rholoc.paper.observation_table import observation_table
from rholoc.recordings import CameraFile, write_camera_json
from rholoc.simulation import Light, simulate_recording

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def rholoc(command: Run) -> Run:
    """Runs ``rholoc``: arguments → (exit status, standard output, standard error)."""
    return command


@pytest.fixture
def table(point_room: Any, tmp_path: Path) -> Path:
    path = tmp_path / "walk.csv"
    map_ = point_room.map_of(point_room.walk(60)[:12], "walk")
    path.write_text("".join(observations_csv(observation_table(map_))), encoding="ascii")
    return path


@pytest.mark.slow
def test_the_whole_flow_on_a_recording(rholoc: Run, tmp_path: Path) -> None:
    walk = tmp_path / "walk"
    simulate_recording(walk, light=Light.ARTIFICIAL, seconds=8.0, fps=6)
    (walk / "truth.csv").rename(walk / "poses.csv")
    truth = read_trajectory_csv(walk / "poses.csv")
    lines = [
        " ".join(f"{value:.6f}" for value in (*position, *quaternion))
        for position, quaternion in zip(truth.positions, truth.quaternions_xyzw, strict=True)
    ]
    text = "\n".join(f"{frame} {line}" for frame, line in zip(truth.frames, lines, strict=True))
    (walk / "poses.txt").write_text(text, encoding="utf-8")
    out = tmp_path / "walk.csv"
    status, printed, errors = rholoc(
        "paper", "observations", walk, "-o", out, "--poses", "given", "--features", "lab3", "--json"
    )
    assert status == 0, errors
    figures = json.loads(printed)
    assert out.read_text().startswith("timestamp,descriptor,u,v,x,y,z,hx,hy,hz,roll\n")
    assert {line.split(",")[1][:2] for line in out.read_text().splitlines()[1:]} == {"00", "01", "02"}
    assert figures["observations"] == len(out.read_text().splitlines()) - 1
    status, printed, errors = rholoc("paper", "fit", out, "-o", tmp_path / "walk.rho", "--no-report", "--json")
    assert status == 0, errors
    fit = json.loads(printed)
    assert fit["with_a_peak"] > 0.9
    assert load_map(tmp_path / "walk.rho").info.features == "lab3"
    trajectory = tmp_path / "trajectory.csv"
    arguments = ("paper", "localize", tmp_path / "walk.rho", walk, "-o", trajectory, "--follow", "--json")
    status, printed, errors = rholoc(*arguments)
    assert status == 0, errors
    assert json.loads(printed)["with_a_pose"] == len(read_trajectory_csv(trajectory)) > 10


def test_a_table_needs_its_camera(rholoc: Run, table: Path) -> None:
    out = table.with_name("map.rho")
    status, _, errors = rholoc("paper", "fit", table, "-o", out)
    assert status == 1
    assert "is not known" in errors
    status, _, errors = rholoc("paper", "fit", table, "-o", out, "--camera", "520,520,319.5,239.5", "--no-report")
    assert status == 0, errors
    assert (load_map(out).info.camera.width, load_map(out).info.camera.height) == (640, 480)
    arguments = ("--camera", "520,520,319.5,239.5", "--size", "huge")
    status, _, errors = rholoc("paper", "fit", table, "-o", out, *arguments)
    assert status == 1
    assert "'huge' is not an image size" in errors


def test_the_camera_may_stand_beside_the_table(rholoc: Run, table: Path, point_room: Any) -> None:
    write_camera_json(table.with_name("walk.camera.json"), CameraFile(point_room.camera))
    arguments = ("paper", "fit", table, "-o", table.with_name("map.rho"), "--seen-only", "--no-report", "--json")
    status, printed, errors = rholoc(*arguments)
    assert status == 0, errors
    assert json.loads(printed)["density"] == "observed"


def test_a_missing_table_is_one_line(rholoc: Run, tmp_path: Path) -> None:
    status, _, errors = rholoc("paper", "fit", tmp_path / "no.csv", "-o", tmp_path / "m.rho", "--camera", "5,5,3,3")
    assert status == 1
    assert "Traceback" not in errors
