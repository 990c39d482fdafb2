"""Recordings as phones and cameras made them."""

from pathlib import Path

import numpy as np
import pytest

from rholoc.recordings import read_recording

pytestmark = pytest.mark.real


def test_the_kitchen_with_its_poses(real_data: Path) -> None:
    kitchen = real_data / "redkitchen"
    recording = read_recording(kitchen, camera="525.505,525.505,320,240", frames="400:1000")
    table = np.loadtxt(kitchen / "poses.txt")
    table = table[(table[:, 0] >= 400) & (table[:, 0] < 1000)]
    assert recording.poses.known.all()
    np.testing.assert_array_equal(recording.frames.numbers, table[:, 0])
    np.testing.assert_array_equal(recording.poses.T_map_camera[:, :3, 3], table[:, 1:4])
    assert not recording.frames.timed
    assert recording.frames.size == (640, 480)
    assert next(recording.frames.images([599])).shape == (480, 640, 3)


def test_the_kitchen_as_a_bare_folder_of_images(real_data: Path) -> None:
    recording = read_recording(real_data / "redkitchen" / "frames", frames="100:200")
    assert recording.frames.numbers.tolist() == list(range(100, 200))
    assert recording.poses is None


def test_waypoints_by_frame_in_the_kitchen(real_data: Path, tmp_path: Path) -> None:
    kitchen = real_data / "redkitchen"
    rows = [line.split() for line in (kitchen / "poses.txt").read_text().splitlines() if not line.startswith("#")]
    chosen = [row for row in rows if row[0] in {"400", "600", "800", "990"}]
    lines = [f"W{row[0]},{','.join(row[:4])}" for row in chosen]
    (tmp_path / "waypoints.csv").write_text("name,frame,x,y,z\n" + "\n".join(lines))
    recording = read_recording(kitchen / "frames", frames="400:1000", waypoints=tmp_path / "waypoints.csv")
    np.testing.assert_array_equal([w.time for w in recording.waypoints], np.array([400, 600, 800, 990]) - 400)


def test_a_phones_video(real_data: Path) -> None:
    frames = read_recording(real_data / "android_livingroom" / "video.mp4").frames
    assert len(frames.times) == 608
    np.testing.assert_allclose(np.diff(frames.times), 1 / 30, atol=1e-4)
    first, last = frames.images([0, 607])
    assert first.shape == last.shape == (480, 640, 3)
    assert not np.array_equal(first, last)
