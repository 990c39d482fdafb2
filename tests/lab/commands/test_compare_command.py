"""``rholoc compare``: what it prints and writes, and how it refuses."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest

from rholoc.features import extractor_names

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
