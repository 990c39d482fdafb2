"""``rholoc recording info``."""

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest

Run = Callable[..., tuple[int, str, str]]
IMU_HEADER = "timestamp,ax,ay,az,gx,gy,gz"


@pytest.fixture
def walk(tmp_path: Path) -> Path:
    """Forty dark frames at 20 a second, an IMU in g with a gap, three waypoints, and no pause."""
    folder = tmp_path / "walk"
    (folder / "frames").mkdir(parents=True)
    for i in range(40):
        assert cv2.imwrite(str(folder / "frames" / f"{i:04d}.png"), np.full((48, 64, 3), 12, np.uint8))
    (folder / "camera.json").write_text('{"fps": 20}')
    times = [t for t in np.arange(200) / 100 if not 1.0 < t < 1.5]
    rows = [f"{t:.3f},0,{1 + 0.1 * np.sin(20 * t):.4f},0,{1.2 * np.cos(5 * t):.4f},0,0" for t in times]
    (folder / "imu.csv").write_text("\n".join([IMU_HEADER, *rows]) + "\n")
    (folder / "waypoints.csv").write_text("name,time,x,y,z\nA,0,0,0,1\nB,1,2,0,1\nC,1.9,2,3,1\n")
    return folder


@pytest.fixture
def info(command: Run) -> Run:
    """Runs ``rholoc recording info``: arguments → (exit status, standard output, standard error)."""
    return partial(command, "recording", "info")


def test_it_tells_all_of_a_recording(walk: Path, tmp_path: Path, info: Run) -> None:
    picture = tmp_path / "walk.png"
    status, printed, errors = info(walk, "--json", "-o", picture)
    assert status == 0, errors
    shown = json.loads(printed)
    assert shown["format"] == "rholoc"
    assert shown["frames"] | {"start_s": 0.0, "end_s": 1.95} == shown["frames"]
    assert (shown["frames"]["count"], shown["frames"]["width"], shown["frames"]["height"]) == (40, 64, 48)
    assert shown["frames"]["rate_hz"] == pytest.approx(20)
    assert shown["imu"]["rate_hz"] == pytest.approx(100)
    assert shown["imu"]["longest_interval_s"] == pytest.approx(0.5)
    assert shown["imu"]["force_median_m_s2"] == pytest.approx(9.8, abs=0.2)
    assert shown["imu"]["pauses_s"] == []
    assert [waypoint["name"] for waypoint in shown["waypoints"]] == ["A", "B", "C"]
    assert (shown["camera"], shown["poses"], shown["frame_intrinsics"], shown["readout_ms"]) == (None, None, None, None)
    assert {warning["kind"] for warning in shown["warnings"]} == {"acceleration_unit", "imu_gap"}
    expected = {"too_fast", "too_dark", "too_little_texture", "pauses_missing"}
    assert {advice["kind"] for advice in shown["advice"]} == expected
    assert str(picture) in errors
    drawn = cv2.imread(str(picture))
    assert drawn.shape == (1080, 1600, 3)
    assert (drawn < 128).any(axis=2).mean() > 0.01  # lines, not a white page


def test_a_stored_camera_is_named(
    walk: Path, info: Run, command: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("RHOLOC_MAPS_DIR", str(tmp_path / "maps"))
    assert command("camera", "add", "robot", "50,50,31.5,23.5", "--size", "64x48")[0] == 0
    status, printed, errors = info(walk, "--camera", "robot", "--json")
    assert status == 0, errors
    assert json.loads(printed)["camera"]["fx"] == 50


def test_people_read_the_same_in_words(walk: Path, info: Run) -> None:
    status, printed, errors = info(walk)
    assert status == 0, errors
    for words in (
        "40, 64×48",
        "at 20.0 Hz",
        "with gravity, mounting unknown",
        "A, B, C",
        "unknown: will be calibrated",
    ):
        assert words in " ".join(printed.split())
    assert printed.count("problem: ") == 2
    assert printed.count("next time: ") == 4


def test_what_is_no_recording_is_one_line(tmp_path: Path, info: Run) -> None:
    status, printed, errors = info(tmp_path / "nowhere")
    assert (status, printed) == (1, "")
    assert errors.count("\n") == 1
