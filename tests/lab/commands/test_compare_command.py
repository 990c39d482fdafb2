"""``rholoc compare``: what it prints and writes, and how it refuses."""

import json
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest

from rholoc.features import extractor_names
from rholoc.geometry import Pose
from rholoc.maps import TrajectoryTable, write_trajectory_csv

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def compare(command: Run) -> Run:
    """Runs ``rholoc compare`` in this process: arguments → (exit status, standard output, standard error)."""
    return partial(command, "compare")


@pytest.fixture
def scenes(tmp_path: Path) -> Path:
    """One scene, the same picture by both lights."""
    image = np.random.default_rng(1).integers(0, 256, (60, 80, 3), dtype=np.uint8)
    folder = tmp_path / "pairs" / "chair"
    folder.mkdir(parents=True)
    for name in ("right_default.png", "right_changed.png"):
        cv2.imwrite(str(folder / name), cv2.resize(image, (320, 240), interpolation=cv2.INTER_NEAREST))
    return folder.parent


def pictures(folder: Path, count: int, poses: bool = True) -> Path:
    """A folder of grey frames, with poses along x."""
    folder.mkdir()
    for number in range(count):
        cv2.imwrite(str(folder / f"frame-{number:03d}.png"), np.full((48, 64), 128, np.uint8))
    if poses:
        rows = [f"{number} {number / 10} 0 0 0 0 0 1" for number in range(count)]
        (folder / "poses.txt").write_text("\n".join(rows))
    return folder


@pytest.mark.slow
def test_lighting_pairs_print_a_table_and_write_figures_and_a_plot(compare: Run, scenes: Path, tmp_path: Path) -> None:
    status, out, _ = compare("--lighting-pairs", scenes, "-o", tmp_path / "out")
    assert status == 0
    for name in extractor_names():
        assert re.search(rf"^chair +{name} +100 %", out, re.MULTILINE)
    figures = json.loads((tmp_path / "out" / "lighting-pairs.json").read_text())
    assert [one["features"] for one in figures] == extractor_names()
    assert cv2.imread(str(tmp_path / "out" / "lighting-pairs.png")) is not None


def test_json_is_all_that_is_printed(compare: Run, scenes: Path) -> None:
    status, out, err = compare("--lighting-pairs", scenes, "--features", "gray", "--json")
    assert (status, err) == (0, "")
    (figures,) = json.loads(out)
    assert (figures["scene"], figures["features"], figures["repeatability"]) == ("chair", "gray", 1)
    assert figures["stereo_precision"] is None


@pytest.mark.parametrize("arguments", [(), ("walk", "--lighting"), ("--lighting", "--lighting-pairs", "pairs")])
def test_one_thing_is_compared_at_a_time(compare: Run, arguments: tuple[str, ...]) -> None:
    assert compare(*arguments)[0] == 2


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("nowhere",), "nowhere"),
        (("--lighting-pairs", "nowhere"), "no lighting pairs"),
        (("bare",), "no poses"),
        (("bare", "--truth"), "truth.csv"),
        (("posed", "--map-frames", "0:5"), "--query-frames"),
        (("posed", "--map-frames", "0:5", "--query-frames", "90:99"), "90:99"),
        (("posed", "posed", "--map-frames", "0:5", "--query-frames", "5:9"), "single recording"),
        (("posed", "--features", "surf"), "surf"),
        (("posed",), "camera"),
    ],
)
def test_what_cannot_be_compared_is_one_line(
    compare: Run, arguments: tuple[str, ...], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pictures(tmp_path / "bare", 3, poses=False)
    pictures(tmp_path / "posed", 12)
    monkeypatch.chdir(tmp_path)
    status, out, err = compare(*arguments)
    assert (status, out) == (1, "")
    assert err.startswith("rholoc: ")
    assert err.count("\n") == 1
    assert said in err


Evaluate = Callable[..., tuple[int, str, str]]


@pytest.fixture
def evaluate(command: Evaluate) -> Evaluate:
    """Runs ``rholoc evaluate`` in this process: arguments → (exit status, standard output, standard error)."""
    return partial(command, "evaluate")


def walk(n: int, shift_m: float = 0.0) -> np.ndarray:
    """Poses along an arc, looking ahead."""
    angles = np.linspace(0, 2, n)
    places = np.column_stack([2 * np.cos(angles) + shift_m, 2 * np.sin(angles), np.full(n, 1.4)])
    headings = np.column_stack([-np.sin(angles), np.cos(angles), np.zeros(n)])
    return np.stack([Pose.from_heading(p, h).T_map_camera for p, h in zip(places, headings, strict=True)])


def write_table(path: Path, T: np.ndarray, frames: np.ndarray) -> Path:
    n = len(T)
    write_trajectory_csv(path, TrajectoryTable(frames / 30, frames, T, np.ones(n), np.full(n, 50)))
    return path


def write_poses(path: Path, T: np.ndarray, keys: np.ndarray) -> Path:
    rows = [[key, *Pose(pose).position, *Pose(pose).quaternion_xyzw] for key, pose in zip(keys, T, strict=True)]
    path.write_text("# frame tx ty tz qx qy qz qw\n" + "\n".join(" ".join(f"{v:.9g}" for v in row) for row in rows))
    return path


def test_failures_count_and_the_keys_are_those_promised(evaluate: Evaluate, tmp_path: Path) -> None:
    frames = np.arange(100, 120)
    truth = write_poses(tmp_path / "poses.txt", walk(20), frames)
    found = write_table(tmp_path / "found.csv", walk(20, shift_m=0.04)[:15], frames[:15])
    status, out, err = evaluate(found, truth, "--frames", "100:120", "--json")
    assert (status, err) == (0, "")
    figures = json.loads(out)
    assert figures["n"] == 20
    assert figures["localized"] == 15
    assert figures["median_cm"] == pytest.approx(4, abs=0.01)
    assert figures["median_deg"] == pytest.approx(0, abs=0.01)
    assert figures["recall_5cm_5deg"] == pytest.approx(0.75)
    assert figures["p90_cm"] is None


def test_frames_that_were_perhaps_never_asked_are_pointed_out(evaluate: Evaluate, tmp_path: Path) -> None:
    truth = write_poses(tmp_path / "poses.txt", walk(20), np.arange(20))
    found = write_table(tmp_path / "found.csv", walk(20)[5:15:2], np.arange(5, 15, 2))
    status, out, err = evaluate(found, truth, "--json")
    assert status == 0
    assert json.loads(out)["n"] == 20
    assert "11 of the 20 frames lie before the first or after the last pose" in err
    assert "--frames" in err
    status, out, err = evaluate(found, truth, "--frames", "5:15:2", "--json")
    assert (json.loads(out)["n"], err) == (5, "")


@pytest.mark.parametrize("key", ["frame", "time", "table 6"])
def test_every_format_of_truth_is_read(evaluate: Evaluate, tmp_path: Path, key: str) -> None:
    frames = np.arange(10)
    found = write_table(tmp_path / "found.csv", walk(10), frames)
    match key:
        case "frame":
            truth = write_poses(tmp_path / "poses.txt", walk(10), frames)
        case "time":
            truth = write_poses(tmp_path / "poses.txt", walk(10), frames / 30)
        case _:
            truth = write_table(tmp_path / "truth.csv", walk(10), frames)
    status, out, err = evaluate(found, truth, "--json")
    assert status == 0
    assert json.loads(out)["n"] == 10
    assert json.loads(out)["recall_5cm_5deg"] == 1
    assert ("times" in err) == (key == "time")


def test_alignment_is_asked_for(evaluate: Evaluate, tmp_path: Path) -> None:
    frames = np.arange(10)
    found = write_table(tmp_path / "found.csv", walk(10, shift_m=1.0), frames)
    truth = write_table(tmp_path / "truth.csv", walk(10), frames)
    assert json.loads(evaluate(found, truth, "--json")[1])["recall_25cm_10deg"] == 0
    assert json.loads(evaluate(found, truth, "--json", "--align")[1])["recall_5cm_5deg"] == 1


def test_people_get_a_table_with_units(evaluate: Evaluate, tmp_path: Path) -> None:
    found = write_table(tmp_path / "found.csv", walk(10), np.arange(10))
    _, out, _ = evaluate(found, found)
    assert "0.00 cm, 0.00°" in out
    assert "100.0 %" in out


@pytest.mark.parametrize(
    ("content", "expected"),
    [("timestamp,x\n1,2\n", "column"), ("1 2 3\n", "eight"), ("", "no poses")],
)
def test_a_broken_file_is_named(evaluate: Evaluate, tmp_path: Path, content: str, expected: str) -> None:
    found = write_table(tmp_path / "found.csv", walk(3), np.arange(3))
    broken = tmp_path / "broken.txt"
    broken.write_text(content)
    status, out, err = evaluate(found, broken)
    assert (status, out) == (1, "")
    assert "broken.txt" in err
    assert expected in err
    assert err.count("\n") == 1
