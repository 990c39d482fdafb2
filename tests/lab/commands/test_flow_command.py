"""``rholoc recording flow``: what moves by known pixels is found to."""

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import typer.main

from rholoc.cli import app
from rholoc.geometry import ByteArray
from rholoc.maps import read_trajectory_csv
from rholoc.recordings import write_frames_csv
from rholoc.simulation import simulate_recording
from rholoc_lab.evaluation.dense_flow import DenseMethod, dense_flow, off_tracks
from rholoc_lab.pictures.flow import dense_png

Run = Callable[..., tuple[int, str, str]]


def _texture() -> np.ndarray:
    rng = np.random.default_rng(4)
    layers = [cv2.resize(rng.random((30 * k, 40 * k)), (420, 320), interpolation=cv2.INTER_CUBIC) for k in (1, 2, 4)]
    return np.uint8(np.clip(255 * np.mean(layers, axis=0), 0, 255))


def _moved() -> tuple[ByteArray, ByteArray]:
    """A texture, and the same three pixels further right and two up."""
    wall = cv2.GaussianBlur(np.random.default_rng(0).integers(0, 255, (160, 220, 3), dtype=np.uint8), (0, 0), 2)
    return wall[20:140, 20:200].copy(), wall[22:142, 17:197].copy()


@pytest.mark.parametrize("method", list(DenseMethod))
@pytest.mark.parametrize("grey", [False, True])
def test_every_pixel_moves_with_the_picture(method: DenseMethod, grey: bool) -> None:
    before, after = _moved()
    if grey:
        before, after = (cv2.cvtColor(one, cv2.COLOR_BGR2GRAY) for one in (before, after))
    field = dense_flow(before, after, method)
    assert field.shape == (120, 180, 2)
    inside = field[20:-20, 20:-20].reshape(-1, 2)
    np.testing.assert_allclose(np.median(inside, axis=0), [3, -2], atol=0.2)
    assert np.percentile(np.abs(inside - [3, -2]), 90) < 0.5


def test_it_is_held_against_the_ways_of_corners() -> None:
    """At the pixel nearest to where a corner was; outside of the picture, at its edge."""
    field = np.zeros((10, 20, 2))
    field[4, 7] = [1.0, 2.0]
    field[9, 19] = [0.0, -3.0]
    field[0, 0] = [5.0, 0.0]
    before = np.array([[7.4, 3.6], [25.0, 30.0], [-4.0, -0.6], [7.6, 4.0]])
    off = off_tracks(field, before, np.add(before, [[1.0, 2.0], [0.0, 1.0], [2.0, 4.0], [3.0, 4.0]]))
    np.testing.assert_allclose(off, [0.0, 4.0, 5.0, 5.0], atol=1e-12)


def test_red_is_to_the_right() -> None:
    flow = np.zeros((8, 8, 2))
    flow[:, :, 0] = 3.0
    picture = cv2.imdecode(np.frombuffer(dense_png(flow), np.uint8), cv2.IMREAD_COLOR)
    assert picture[4, 4].tolist() == [0, 0, 255]


def test_tracks_and_fields_are_written(tmp_path: Path, command: Run) -> None:
    wide, folder, out = _texture(), tmp_path / "walk", tmp_path / "flow"
    folder.mkdir()
    for frame in range(6):
        cv2.imwrite(str(folder / f"frame-{frame:06d}.png"), wide[20:260, 60 - 4 * frame : 380 - 4 * frame])
    write_frames_csv(folder / "frames.csv", np.arange(6), np.arange(6) / 30)
    status, printed, errors = command("recording", "flow", folder, "-o", out, "--pictures", "2", "--fields", "--json")
    assert status == 0, errors
    figures = json.loads(printed)
    assert figures["odometry"] is None
    assert "No odometry: The camera hardly moves" in errors
    assert figures["frames"] == 6
    assert figures["motion_a_frame_px"] == pytest.approx(4, abs=0.5)
    assert figures["dis_off_tracks_px"] < 0.5
    assert figures["farneback_off_tracks_px"] < 0.5
    status, printed, errors = command("recording", "flow", folder, "-o", tmp_path / "without", "--pictures", "0")
    assert status == 0, errors
    assert "None" not in printed
    table = np.loadtxt(out / "tracks.csv", delimiter=",", skiprows=1)
    longest = table[table[:, 1] == np.bincount(table[:, 1].astype(int)).argmax()]
    assert np.allclose(np.diff(longest[:, 2]), 4, atol=0.5)
    assert sorted(path.name for path in out.glob("*.png")) == [
        f"{kind}-{frame:06d}.png" for kind in ("dis", "farneback", "tracks") for frame in (1, 5)
    ]
    field = cv2.readOpticalFlow(str(out / "farneback-000005.flo"))
    assert np.allclose(np.median(field, axis=(0, 1)), (4, 0), atol=0.3)
    dense = (out / "dense.csv").read_text().splitlines()
    assert dense[0] == "frame,method,motion_px,off_tracks_px,off_tracks_p90_px"
    assert [line.split(",")[:2] for line in dense[1:]] == [
        [frame, method] for frame in ("1", "5") for method in ("farneback", "dis")
    ]


@pytest.mark.slow
def test_odometry_stands_beside_the_truth(tmp_path: Path, command: Run) -> None:
    walk, out = tmp_path / "walk", tmp_path / "flow"
    simulate_recording(walk, seconds=9.0, fps=15)
    status, printed, errors = command("recording", "flow", walk, "-o", out, "--pictures", "0", "--json")
    assert status == 0, errors
    found = json.loads(printed)["odometry"]
    assert found["scale"] == "metric"
    assert found["upright"]
    assert found["true_size"] == pytest.approx(1, abs=0.05)
    assert found["rms_m"] < 0.05
    assert found["median_deg"] < 1.5
    assert found["drift_percent"] < 5
    assert (out / "odometry.png").stat().st_size > 10_000
    table = read_trajectory_csv(out / "odometry.csv")
    assert len(table) == found["keyframes"] > 10


@pytest.mark.parametrize("name", ["compare", "evaluate", "paper", "simulate", "evaluate-track"])
def test_commands_of_the_lab_are_offered(name: str) -> None:
    assert name in typer.main.get_command(app).commands


@pytest.mark.parametrize(
    "words", [("evaluate", "a.csv", "b.csv"), ("paper",), ("map", "density", "a.rho"), ("recording", "flow", "walk")]
)
def test_without_it_they_say_how_to_install_it(
    command: Run, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...]
) -> None:
    monkeypatch.setattr("typer.core.TyperGroup.get_command", _without_the_lab)
    status, printed, errors = command(*words)
    assert (status, printed) == (1, "")
    assert "rholoc-lab, which is not installed. pip install rholoc-lab" in errors
    assert errors.count("\n") == 1


def _without_the_lab(group, context, name):
    of_lab = group.commands.get(name)
    return None if of_lab is None or name in ("evaluate", "paper", "density", "flow") else of_lab
