"""A tracker run over a recording: it keeps its pose by odometry, by pictures, and through an outage."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rholoc.errors import InvalidRecording
from rholoc.geometry import FloatArray, Similarity, pose_distances, pose_matrix
from rholoc.localization import Localizer
from rholoc.maps import save_map
from rholoc.recordings import GivenPoses, Imu, Recording
from rholoc.recordings.frames.memory_frames import MemoryFrames
from rholoc.tracking.moments import Motion
from rholoc_lab.evaluation.odometry import measure_odometry
from rholoc_lab.evaluation.tracking import Outage, drifting_odometry, run_tracker

FRAMES = 30


@pytest.fixture(scope="module")
def still(picture_world):
    """One picture again and again: a camera at rest."""
    images = [picture_world.image] * FRAMES
    frames = MemoryFrames(images, frames_per_second=10.0)
    poses = GivenPoses(np.ones(FRAMES, dtype=bool), np.repeat(picture_world.pose.T_map_camera[None], FRAMES, axis=0))
    return Recording(frames, "still", None, camera=picture_world.camera, poses=poses)


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


def _walk(count: int = 60) -> FloatArray:
    angle = np.linspace(0, 5, count)
    positions = np.column_stack([2 * np.cos(angle), np.sin(angle), 0.1 * angle])
    return pose_matrix(Rotation.from_euler("z", angle[:, None]).as_matrix(), positions)


def test_another_frame_and_size_are_no_drift() -> None:
    truth = _walk()
    moved = Similarity(0.5, Rotation.from_euler("xyz", [0.3, -0.2, 1.0]).as_matrix(), np.array([1.0, 2.0, 3.0]))
    found = measure_odometry(moved.poses(truth), truth, upright=False)
    assert found.scale == pytest.approx(2)
    assert found.rms_m == pytest.approx(0, abs=1e-9)
    assert found.drift == pytest.approx(0, abs=1e-9)
    np.testing.assert_allclose(found.aligned, truth, atol=1e-9)


def test_gravity_is_not_aligned_away() -> None:
    """Positions that bend upwards would be fitted best by a tilt, which then is off in every rotation."""
    truth = _walk()
    turned = Similarity(0.5, Rotation.from_euler("z", 1.0).as_matrix(), np.array([1.0, 2.0, 3.0]))
    bent = truth.copy()
    bent[:, 2, 3] += 0.1 * bent[:, 0, 3]
    free, upright = (measure_odometry(turned.poses(bent), truth, upright=upright) for upright in (False, True))
    assert free.median_deg > 2
    assert upright.median_deg == pytest.approx(0, abs=0.2)
    np.testing.assert_allclose(upright.aligned[:, 2, :3], truth[:, 2, :3], atol=1e-9)
    exact = measure_odometry(turned.poses(truth), truth, upright=True)
    assert (exact.scale, exact.rms_m) == (pytest.approx(2), pytest.approx(0, abs=1e-9))


def test_a_truth_that_is_not_upright_is_aligned_freely() -> None:
    moved = Similarity(1.0, Rotation.from_euler("x", np.pi / 2).as_matrix(), np.zeros(3))
    found = measure_odometry(_walk(), moved.poses(_walk()), upright=True)
    assert found.rms_m == pytest.approx(0, abs=1e-9)


def test_a_heading_that_turns_away_is_drift() -> None:
    """Straight on for 10 m, while the odometry turns by 0.01 rad a metre: the end of L metres is 0.005 L² aside."""
    way = np.linspace(0, 10, 101)
    truth = pose_matrix(np.tile(np.eye(3), (101, 1, 1)), np.column_stack([way, 0 * way, 0 * way]))
    bent = pose_matrix(
        Rotation.from_euler("z", 0.01 * way[:, None]).as_matrix(), np.column_stack([way, 0.005 * way**2, 0 * way])
    )
    found = measure_odometry(bent, truth, upright=False)
    assert found.path_m == pytest.approx(10)
    expected = np.mean([0.005 * length for length in (1.0, 2.0, 4.0)])
    assert found.drift == pytest.approx(expected, rel=0.2)


def test_a_camera_at_rest_has_no_odometry() -> None:
    assert measure_odometry(_walk(), np.tile(np.eye(4), (60, 1, 1)), upright=True) is None
    assert measure_odometry(_walk()[:3], _walk()[:3], upright=True) is None
