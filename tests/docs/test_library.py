"""What the library's page shows, runs; what it offers is there; the site builds without a warning."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rholoc
from rholoc.maps import read_trajectory_csv
from rholoc.simulation import simulate_recording

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "library.md").read_text(encoding="utf-8")
REFERENCE = (ROOT / "docs" / "site" / "content" / "reference.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
OF_A_WALK = next(number for number, block in enumerate(BLOCKS) if "read_recording" in block)


@pytest.fixture
def beside_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the files that the page names, as the working directory."""
    shutil.copy(ROOT / "maps" / "testsite.rho", tmp_path)
    shutil.copy(ROOT / "maps" / "queries" / "1.jpg", tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_pages_examples_run(beside_files: Path) -> None:
    names: dict[str, Any] = {}
    for block in BLOCKS[:OF_A_WALK]:
        exec(compile(block, "docs/library.md", "exec"), names)
    assert names["answer"].localized
    assert names["figures"].n == 2


@pytest.mark.slow
def test_the_examples_of_a_walk_run(beside_files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    walk = beside_files / "walk"
    simulate_recording(walk, seconds=8.0, fps=6)
    truth = read_trajectory_csv(walk / "truth.csv")
    rows = np.column_stack([truth.frames, truth.positions, truth.quaternions_xyzw])
    np.savetxt(walk / "poses.txt", rows, fmt=["%d", *["%.6f"] * 7])
    names: dict[str, Any] = {"rholoc": rholoc, "Path": Path}
    for block in BLOCKS[OF_A_WALK:]:
        exec(compile(block, "docs/library.md", "exec"), names)
    assert (beside_files / "kitchen.rho").is_file()
    assert "already learned" in capsys.readouterr().out


@pytest.mark.parametrize("name", rholoc.__all__)
def test_every_name_is_there_shown_and_in_the_reference(name: str) -> None:
    assert getattr(rholoc, name).__name__ == name
    assert f"rholoc.{name}(" in PAGE or f"rholoc.{name}." in PAGE
    assert re.search(rf"^::: rholoc\.\w+\.{name}$", REFERENCE, re.MULTILINE)


def test_importing_it_loads_nothing_heavy() -> None:
    code = "import sys, rholoc; assert 'numpy' not in sys.modules; assert 'build_map' in dir(rholoc); rholoc.nothing"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False)
    assert "has no attribute 'nothing'" in done.stderr
