"""Measured distances between places of the camera, in a table or as text."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from rholoc.errors import InvalidRecording
from rholoc.recordings import KnownLength, read_recording


@pytest.fixture
def walk(tmp_path: Path) -> Path:
    """Pictures 10 to 14."""
    for number in range(10, 15):
        assert cv2.imwrite(str(tmp_path / f"{number}.png"), np.zeros((40, 60, 3), np.uint8))
    return tmp_path


def test_lengths_come_from_the_table_or_the_caller(walk: Path) -> None:
    assert read_recording(walk).lengths == ()
    (walk / "lengths.csv").write_text("first,second,length\n10,14,2.4\n11,12,0.6\n")
    recording = read_recording(walk)
    assert recording.lengths == (KnownLength(10, 14, 2.4), KnownLength(11, 12, 0.6))
    assert recording.warnings == ()
    assert read_recording(walk, lengths=["13,10, 1.5"]).lengths == (KnownLength(13, 10, 1.5),)
    assert read_recording(walk, frames="11:14").lengths == (KnownLength(11, 12, 0.6),)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("10,14", r"'10,14' is not a length"),
        ("10,14,far", r"not a length.*12,340,2\.40"),
        ("10,15,2.4", r"names the frame 15.*10 to 14"),
        ("10,10.5,2.4", r"names the frame 10\.5"),
        ("10,nan,2.4", r"names the frame nan"),
        ("12,12,2.4", r"between the frame 12 and itself"),
        ("10,14,0", r"of 0 m cannot be used.*0\.05 to 1000 m"),
        ("10,14,nan", r"of nan m cannot be used"),
    ],
)
def test_what_is_no_length_is_refused(walk: Path, text: str, said: str) -> None:
    with pytest.raises(InvalidRecording) as caught:
        read_recording(walk, lengths=[text])
    assert caught.match(said)


def test_a_broken_table_of_lengths_is_refused(walk: Path) -> None:
    (walk / "lengths.csv").write_text("first,second,length\n10,99,2.4\n")
    with pytest.raises(InvalidRecording, match=r"lengths\.csv names the frame 99"):
        read_recording(walk)
