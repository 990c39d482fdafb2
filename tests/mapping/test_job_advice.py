"""What maps and failed jobs tell of their recordings."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from rholoc.errors import MappingFailed
from rholoc.geometry import Pose
from rholoc.mapping import build_map
from rholoc.mapping.build.job_advice import advice_line, coaching_report
from rholoc.recordings import Look, read_recording, write_frames_csv
from rholoc.reports import AdviceKind


@pytest.fixture
def dark(tmp_path: Path) -> Path:
    """Twenty frames of a dark wall."""
    folder = tmp_path / "dark"
    folder.mkdir()
    for i in range(20):
        assert cv2.imwrite(str(folder / f"{i:04d}.png"), np.full((48, 64, 3), 9, np.uint8))
    return folder


def test_a_section_holds_what_was_measured_and_advised(dark: Path) -> None:
    write_frames_csv(dark / "frames.csv", np.arange(20), np.arange(20) / 30)
    recording = read_recording(dark)
    straight = [Pose.from_heading(np.array([t, 0, 1.5]), np.array([1.0, 0, 0])).T_map_camera for t in range(20)]
    section = coaching_report(recording, [Look(120.0, 400)] * 20, recording.frames.times, np.array(straight))
    assert section.recording == "dark"
    assert section.warnings == ()
    assert section.figures.nearest_return == pytest.approx(1)
    assert [advice.kind for advice in section.advice] == [AdviceKind.NO_LOOP]
    assert advice_line([section]) == f"next time: {section.advice[0].text}"
    assert advice_line([replace(section, advice=())]) == ""


def test_a_walk_that_gives_no_map_says_what_it_lacked(dark: Path) -> None:
    rows = [f"{900 + t / 100},0,9.81,0,0,0,0" for t in range(50)]
    write_frames_csv(dark / "frames.csv", np.arange(20), np.arange(20) / 30)
    (dark / "imu.csv").write_text("\n".join(["timestamp,ax,ay,az,gx,gy,gz", *rows]))
    with pytest.raises(MappingFailed) as caught:
        build_map([read_recording(dark)])
    assert "Switch on more light: the mean grey is 9 of 255" in caught.value.hint
    assert "IMU and frames have no common time" in caught.value.hint
    assert "100% of the frames show hardly any corners" in caught.value.hint
    assert "\n" not in str(caught.value)
