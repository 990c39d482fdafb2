"""A tracker run over a recording: it keeps its pose by odometry, by pictures, and through an outage."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from rholoc.errors import InvalidRecording
from rholoc.geometry import pose_distances
from rholoc.localization import Localizer
from rholoc.maps import save_map
from rholoc.recordings import GivenPoses, Imu, Recording
from rholoc.recordings.frames.memory_frames import MemoryFrames
from rholoc.tracking import Motion
from rholoc_lab.evaluation.tracking import Outage, drifting_odometry, run_tracker

FRAMES = 30


@pytest.fixture(scope="module")
def still(picture_world):
    """One picture again and again: a camera at rest."""
    images = [picture_world.image] * FRAMES
    frames = MemoryFrames(images, frames_per_second=10.0)
    poses = GivenPoses(np.ones(FRAMES, dtype=bool), np.repeat(picture_world.pose.T_map_camera[None], FRAMES, axis=0))
    return Recording("still", None, frames, camera=picture_world.camera, poses=poses)


@pytest.fixture(scope="module")
def localizer(picture_world):
    return Localizer(picture_world.map_)


def run(localizer, still, motion, **options):
    truth = still.poses.T_map_camera
    return run_tracker(localizer, still, still.camera, motion, truth=truth, latency_s=0.1, **options)


def test_odometry_drifts_by_as_much_as_it_is_reported():
    truth = np.repeat(np.eye(4)[None], 100, axis=0)
    truth[:, 0, 3] = np.arange(100) / 10
    found = drifting_odometry(truth, 0.02, seed=0)
    steps_m = [pose_distances(np.linalg.inv(a) @ b, np.linalg.inv(c) @ d)[0] for a, b, c, d in
               zip(found[:-1], found[1:], truth[:-1], truth[1:], strict=True)]  # fmt: skip
    np.testing.assert_allclose(steps_m, 0.002, atol=1e-6)
    assert np.array_equal(found, drifting_odometry(truth, 0.02, seed=0))
    assert not np.array_equal(found, drifting_odometry(truth, 0.02, seed=1))


@pytest.mark.parametrize("motion", [Motion.ODOMETRY, Motion.PICTURES])
def test_a_camera_at_rest_stays_where_it_is(localizer, still, motion):
    moves = drifting_odometry(still.poses.T_map_camera, 0.02, 0) if motion is Motion.ODOMETRY else None
    figures = run(localizer, still, motion, odometry=moves).figures()
    assert figures["searching"] < 20
    assert figures["worst_cm"] < 2
    assert figures["resets"] == 0
    assert figures["asked_per_s"] <= 2.5


def test_an_outage_is_gone_through(localizer, still):
    moves = drifting_odometry(still.poses.T_map_camera, 0.02, 0)
    whole = run(localizer, still, Motion.ODOMETRY, odometry=moves)
    cut = run(localizer, still, Motion.ODOMETRY, odometry=moves, outages=(Outage(0.0, 1.0),))
    assert cut.figures()["searching"] > whole.figures()["searching"]
    assert cut.tracked[-1].pose is not None


def test_an_imu_whose_axes_are_unknown_is_refused(localizer, still):
    with pytest.raises(InvalidRecording, match="no IMU"):
        run(localizer, still, Motion.IMU)
    readings = np.zeros((3, 3))
    unknown = Imu(np.arange(3.0), readings, readings, includes_gravity=True, R_camera_imu=None)
    with pytest.raises(InvalidRecording, match="axes"):
        run(localizer, replace(still, imu=unknown), Motion.IMU)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--drift", "2"], "true pose"),
        (["--motion", "odometry"], "no odometry"),
        (["--motion", "wheels"], "is not one of"),
        (["--outage", "5:2"], "START:STOP"),
        (["--motion", "imu"], "no IMU"),
    ],
)
def test_what_cannot_be_tracked_is_said(command, tmp_path, picture_world, options, words):
    save_map(picture_world.map_, tmp_path / "room.rho")
    (tmp_path / "frames").mkdir()
    for number in range(2):
        (tmp_path / "frames" / f"{number}.png").write_bytes(picture_world.png())
    status, _, errors = command("evaluate-track", tmp_path / "room.rho", tmp_path / "frames", *options)
    assert status
    assert words in errors


def test_the_command_prints_every_frame_and_draws(command, tmp_path, picture_world):
    save_map(picture_world.map_, tmp_path / "room.rho")
    (tmp_path / "frames").mkdir()
    for number in range(4):
        (tmp_path / "frames" / f"{number}.png").write_bytes(picture_world.png())
    asked = ["evaluate-track", tmp_path / "room.rho", tmp_path / "frames", "--latency", "10", "--json"]
    status, printed, errors = command(*asked, "--plot", tmp_path / "track.png", "-o", tmp_path / "track.csv")
    assert status == 0, errors
    figures = json.loads(printed)
    assert [row["frame"] for row in figures["each"]] == [0, 1, 2, 3]
    assert figures["motion"] == "pictures"
    assert (tmp_path / "track.png").stat().st_size > 1000
    assert (tmp_path / "track.csv").read_text().startswith("timestamp,")
