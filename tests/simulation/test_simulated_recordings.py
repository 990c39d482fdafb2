"""What is written reads back, and is the same each time."""

from __future__ import annotations

import csv
from pathlib import Path

import cv2
import numpy as np
import pytest

from rholoc.errors import Cancelled
from rholoc.geometry import Pose
from rholoc.recordings import read_recording
from rholoc.simulation import PHONE_CAMERA, Light, make_blank_wall, simulate_recording

CAMERA = PHONE_CAMERA.resized(160, 120)
SECONDS = 0.7


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("simulated") / "walk"
    simulate_recording(folder, seconds=SECONDS, camera=CAMERA)
    return folder


def test_a_simulated_recording_reads_back(folder: Path) -> None:
    recording = read_recording(folder)
    assert recording.poses is None  # the truth is not handed in
    assert recording.camera == CAMERA
    assert recording.frames.size == (160, 120)
    np.testing.assert_allclose(recording.frames.times, np.arange(21) / 30, atol=1e-6)
    assert recording.imu is not None
    assert recording.imu.includes_gravity
    np.testing.assert_allclose(np.diff(recording.imu.times), 0.01, atol=1e-6)
    assert recording.waypoints == ()  # fewer than three are reached
    images = list(recording.frames.images(range(21)))
    assert len(images) == 21
    assert images[0].std() > 20


def test_the_video_keeps_time_by_itself(folder: Path) -> None:
    capture = cv2.VideoCapture(str(folder / "video.mp4"))
    times = []
    while capture.read()[0]:
        times.append(capture.get(cv2.CAP_PROP_POS_MSEC) / 1000)
    np.testing.assert_allclose(times, np.arange(21) / 30, atol=1e-6)


def test_the_truth_is_table_6(folder: Path) -> None:
    with (folder / "truth.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0])[:7] == ["timestamp", "x", "y", "z", "hx", "hy", "hz"]
    assert [float(rows[0][key]) for key in "xyz"] == [0.0, 0.0, 0.0]
    last = {key: float(value) for key, value in rows[-1].items()}
    pose = Pose.from_quaternion(
        np.array([last["x"], last["y"], last["z"]]), np.array([last[k] for k in ("qx", "qy", "qz", "qw")])
    )
    np.testing.assert_allclose(pose.heading, [last["hx"], last["hy"], last["hz"]], atol=1e-5)
    assert last["frame"] == 20


def test_the_same_arguments_give_the_same_recording(folder: Path, tmp_path: Path) -> None:
    simulate_recording(tmp_path / "again", seconds=SECONDS, camera=CAMERA)
    for name in ("video.mp4", "frames.csv", "imu.csv", "camera.json", "truth.csv"):
        assert (tmp_path / "again" / name).read_bytes() == (folder / name).read_bytes(), name


def test_progress_is_reported_and_may_stop_the_work(tmp_path: Path) -> None:
    heard: list[float] = []

    def listen(fraction: float) -> None:
        heard.append(fraction)
        if fraction > 0.4:
            raise Cancelled("Enough.")

    with pytest.raises(Cancelled):
        simulate_recording(
            tmp_path / "walk", scene=make_blank_wall(), seconds=0.3, camera=CAMERA, light=Light.DIM, progress=listen
        )
    assert heard == sorted(heard)
    assert len(heard) == 4


def test_a_rolling_shutter_reads_one_row_after_the_other(tmp_path: Path) -> None:
    """The middle rows are what a global shutter sees; those above and below are as they were before, or are after."""
    readout_s = 0.03
    for name, shutter in (("rolling", readout_s), ("global", 0.0)):
        simulate_recording(tmp_path / name, seconds=3.4, fps=5.0, camera=CAMERA, readout_s=shutter)
    rolling, instant = (read_recording(tmp_path / name) for name in ("rolling", "global"))
    assert rolling.readout_s == pytest.approx(readout_s)
    assert instant.readout_s is None
    pictures = [np.array(list(recording.frames.images(range(7, 17))), np.int32) for recording in (rolling, instant)]
    apart = np.abs(pictures[0] - pictures[1]).mean(axis=(0, 2, 3))  # (120,), a row's, on the way
    assert apart[48:72].mean() < 0.7 * apart[:24].mean()
    assert apart[48:72].mean() < 0.7 * apart[96:].mean()
