"""``rholoc map info``: a page for people, the most important first."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from kept_queries import keep_queries
from rholoc.geometry import Camera
from rholoc.library.maps import MapLibrary
from rholoc.mapping.learn import from_queries
from rholoc.maps import Map, load_map, save_map
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


@pytest.fixture
def maps(tmp_path: Path, point_room: Any) -> Path:
    """A folder with two maps that overlap."""
    walk = point_room.walk(80)
    save_map(point_room.map_of(walk[:45:2], "first"), tmp_path / "west.rho")
    save_map(point_room.map_of(walk[25:65:2], "second"), tmp_path / "east.rho")
    return tmp_path


def test_maps_are_merged_and_a_recording_is_forgotten(rholoc: Run, maps: Path) -> None:
    before = load_map(maps / "west.rho")
    status, out, err = rholoc("merge", maps / "west.rho", maps / "east.rho", "-o", maps / "both.rho", "--json")
    assert (status, err) == (0, "")
    figures = json.loads(out)
    assert [source["name"] for source in figures["sources"]] == ["first", "second"]
    assert figures["report"]["learned"][0]["features_in_both"] > 50
    status, out, err = rholoc("forget", maps / "both.rho", "second", "--json")
    assert (status, err, json.loads(out)["version"]) == (0, "", 3)
    np.testing.assert_allclose(
        load_map(maps / "both.rho").landmarks.positions, before.landmarks.positions, rtol=0, atol=1e-6
    )


def test_refusals_are_one_line_and_leave_the_map(rholoc: Run, maps: Path) -> None:
    walk = maps / "walk"
    walk.mkdir()
    for number in range(8):
        noise = np.random.default_rng(number).integers(0, 256, (480, 640), dtype=np.uint8)
        cv2.imwrite(str(walk / f"{number:04d}.png"), noise)
    content = (maps / "west.rho").read_bytes()
    for arguments, said in (
        (("forget", maps / "west.rho", "attic"), "It contains: first (first-id)"),
        (("update", maps / "west.rho", walk), "0 of 8 frames were found"),
        (("update", maps / "west.rho", maps / "nowhere.mp4"), "nowhere.mp4"),
        (("merge", maps / "west.rho", maps / "west.rho", "-o", maps / "new.rho"), "nothing to merge"),
    ):
        status, out, err = rholoc(*arguments)
        assert (status, out) == (1, ""), err
        assert said in err
        assert err.count("\n") == 1
    assert (maps / "west.rho").read_bytes() == content
    assert not (maps / "new.rho").exists()


@pytest.mark.slow
def test_a_map_learns_from_its_users_and_the_one_before_is_kept(
    rholoc: Run, maps: Path, point_room: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(from_queries, "_ROUNDS", 0)  # how much is learned is beside the point
    west, data = maps / "west.rho", maps / "data"
    kept = keep_queries(data, load_map(west), point_room, 1.8e9)
    assert kept >= 30
    status, out, err = rholoc("queries", west, "--data", data, "--json")
    assert (status, err, json.loads(out)["queries"]) == (0, "", kept)
    status, out, err = rholoc("learn", west, "--data", data, "--json")
    assert (status, err) == (0, "")
    figures = json.loads(out)
    assert figures["version"] == 2
    assert figures["report"]["learned"][0]["queries"]["kept"] == kept
    before = MapLibrary(maps).previous("west")
    assert before.version == 1
    status, out, _ = rholoc("queries", west, "--data", data, "--delete")
    assert (status, "deleted" in out) == (0, True)
    status, out, err = rholoc("learn", west, "--data", data)
    assert (status, out) == (1, "")
    assert "0 queries are kept for the map; it learns from 30 at least." in err
    assert load_map(west).info.version == 2


MAPS = Path(__file__).parents[3] / "maps"
MAP, QUERIES = MAPS / "testsite.rho", MAPS / "queries"


@pytest.fixture
def succeed(command: Run) -> Callable[..., str]:
    """Runs the command in this process; arguments → standard output. It must succeed."""

    def run(*arguments: object) -> str:
        status, printed, errors = command(*arguments)
        assert status == 0, errors
        return printed

    return run


def test_the_shipped_map_is_small_and_says_what_it_is(succeed: Callable[..., str]) -> None:
    assert MAP.stat().st_size <= 500_000
    figures = json.loads(succeed("map", "info", MAP, "--json"))
    assert figures["metric"]
    assert figures["upright"]
    assert figures["bytes"] == MAP.stat().st_size
    assert figures["report"]["held_out"]["frames"] > 0


def test_the_shipped_pictures_are_localized_to_centimetres(succeed: Callable[..., str], tmp_path: Path) -> None:
    found = tmp_path / "found.csv"
    summary = json.loads(succeed("localize", MAP, QUERIES, "-o", found, "--json"))
    assert (summary["frames"], summary["localized"]) == (3, 3)
    ours = "frame,roll,qx,qy,qz,qw,confidence,inliers,map_trusted,expected_error_m"
    assert found.read_text().startswith(f"timestamp,x,y,z,hx,hy,hz,{ours}\n")
    figures = json.loads(succeed("evaluate", found, QUERIES / "poses.txt", "--json"))
    assert figures["n"] == 3
    assert figures["recall_5cm_5deg"] == 1


def test_a_choice_of_frames_is_a_choice_of_pictures(succeed: Callable[..., str], tmp_path: Path) -> None:
    found = tmp_path / "found.csv"
    assert json.loads(succeed("localize", MAP, QUERIES, "--frames", "2:3", "-o", found, "--json"))["frames"] == 1
    assert len(found.read_text().splitlines()) == 2


@pytest.mark.parametrize(("form", "start"), [("ply", b"ply\n"), ("vtp", b"<?xml"), ("png", b"\x89PNG")])
def test_the_shipped_map_can_be_exported(succeed: Callable[..., str], tmp_path: Path, form: str, start: bytes) -> None:
    succeed("map", "export", MAP, "--to", form, "-o", tmp_path / f"map.{form}")
    assert (tmp_path / f"map.{form}").read_bytes().startswith(start)
