"""Files of a recording that nothing reads are named."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from rholoc.recordings import Recording, WarningKind, read_recording, write_frames_csv


def _unused(recording: Recording) -> list[str]:
    return [warning.text for warning in recording.warnings if warning.kind is WarningKind.NOT_USED]


@pytest.fixture
def walk(tmp_path: Path) -> Path:
    """A folder of pictures in which everything is used."""
    folder = tmp_path / "walk"
    (folder / "frames").mkdir(parents=True)
    for number in range(4):
        assert cv2.imwrite(str(folder / "frames" / f"{number}.png"), np.zeros((40, 60, 3), np.uint8))
    write_frames_csv(folder / "frames.csv", np.arange(4), np.arange(4.0))
    for name in ("README.md", ".DS_Store", "camera.json"):
        (folder / name).write_text("{}")
    return folder


def test_a_folder_in_which_everything_is_used_has_no_warning(walk: Path) -> None:
    assert _unused(read_recording(walk)) == []


def test_unknown_files_are_named_and_folders_counted(walk: Path) -> None:
    for name in ("scan.obj", "notes.txt", "audio/a.wav", "audio/b.wav", "depth/0.exr"):
        (walk / name).parent.mkdir(exist_ok=True)
        (walk / name).write_bytes(b"?")
    (text,) = _unused(read_recording(walk))
    assert text.endswith(": audio/ (2 files), depth/0.exr, notes.txt, scan.obj.")


def test_of_many_unknown_files_some_are_named(walk: Path) -> None:
    for number in range(9):
        (walk / f"page{number}.pdf").write_bytes(b"?")
    (text,) = _unused(read_recording(walk))
    assert text.endswith(": page0.pdf, page1.pdf, page2.pdf, page3.pdf and 5 more.")


def test_pictures_that_another_folder_hides_are_named(walk: Path) -> None:
    assert cv2.imwrite(str(walk / "7.png"), np.zeros((40, 60, 3), np.uint8))
    (walk / "frames.csv").unlink()
    (text,) = _unused(read_recording(walk))
    assert text.endswith(": frames/ (4 files).")


def test_a_chosen_part_of_a_recording_names_no_frames_as_unused(walk: Path) -> None:
    assert _unused(read_recording(walk, frames="1:3")) == []
