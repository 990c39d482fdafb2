"""What is written once stays in one place: who needs it imports it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[2] / "server" / "rholoc"
OPENING_VIDEOS = {"recordings/frames/live_camera.py", "recordings/frames/video.py"}


@pytest.mark.parametrize(
    ("what", "pattern", "homes"),
    [
        ("angles between rotations", r"\.magnitude\(\)|\btrace\(.*- 1", {"geometry/vectors.py"}),
        ("alignments of points", r"align_vectors|def (kabsch|umeyama|align_poses)", {"geometry/alignment.py"}),
        ("cameras as text and JSON", r"\*distortion = |asdict\([\w.]*camera\)", {"geometry/camera.py"}),
        ("visual words", r"\bKmeans\b", {"features/picture_vectors.py"}),
        ("a full disk's errors", r"\bENOSPC\b|\bEDQUOT\b", {"disk.py"}),
        ("VTK's PolyData", r'VTKFile type="PolyData"', {"maps/formats/ply_and_vtp.py"}),
        ("VTK's ImageData", r'VTKFile type="ImageData"', {"maps/formats/vti.py"}),
        (
            "starting and killing processes",
            r"\bPopen\(|\bget_context\(|create_subprocess_|\bos\.(kill|killpg|fork)\(|subprocess\.run\(|psutil\.Process\(",
            {"processes/async_program.py", "processes/child.py", "processes/program.py", "processes/tree.py"},
        ),
        ("opening videos and cameras", r"\bcv2\.VideoCapture\(", OPENING_VIDEOS),
    ],
)
def test_it_has_one_home(what: str, pattern: str, homes: set[str]) -> None:
    found = {
        str(file.relative_to(PACKAGE))
        for file in PACKAGE.rglob("*.py")
        if any(re.search(pattern, line) for line in file.read_text(encoding="utf-8").splitlines())
    }
    assert found == homes, what


@pytest.mark.parametrize("folder", ["server", "client", "tests", "benchmarks"])
def test_no_angle_is_the_arccos_of_a_rounded_cosine(folder: str) -> None:
    """It is NaN just above 1 and off by 1e-8 rad just below it; :mod:`rholoc.geometry.vectors` uses atan2."""
    files = (file for file in (PACKAGE.parents[1] / folder).rglob("*.py") if file != Path(__file__))
    found = [str(file) for file in files if re.search(r"\ba(rc)?cos\(", file.read_text(encoding="utf-8"))]
    assert not found
