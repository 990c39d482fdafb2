"""imu.csv, frames.csv, camera.json, poses.txt: what is written is read back, and what is broken is reported."""

import json
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from rholoc.errors import InvalidCamera, InvalidRecording, InvalidTrajectory
from rholoc.geometry import Camera, Pose
from rholoc.recordings import (
    CameraFile,
    Imu,
    read_camera_json,
    read_frames_csv,
    read_imu_csv,
    read_pose_table,
    write_camera_json,
    write_frames_csv,
    write_imu_csv,
)
from rholoc.recordings.frames.memory_frames import MissingImages
from rholoc.recordings.tables.logged_table import read_logged_table
from rholoc.recordings.tables.pose_table import PoseTable, match_poses, poses_from_rows

IMU_HEADER = "timestamp,ax,ay,az,gx,gy,gz"
_SHARED_FOLDER = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)


def test_the_line_that_is_named_counts_blank_lines_and_comments(tmp_path: Path) -> None:
    (tmp_path / "gyro.csv").write_text("t,x\n0.0,1\n\n# a pause\n0.1,wide\n")
    with pytest.raises(InvalidRecording, match="row 5"):
        read_logged_table(tmp_path / "gyro.csv").named("x")


def test_an_imu_table_comes_back(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    imu = Imu(100 + np.arange(50) / 200, rng.normal(size=(50, 3)) * 10, rng.normal(size=(50, 3)), True, None)
    write_imu_csv(tmp_path / "imu.csv", imu)
    assert (tmp_path / "imu.csv").read_text().splitlines()[0] == IMU_HEADER
    back = read_imu_csv(tmp_path / "imu.csv", includes_gravity=False, R_camera_imu=np.eye(3))
    np.testing.assert_allclose(back.times, imu.times, atol=1e-6)
    np.testing.assert_allclose(back.acceleration, imu.acceleration, rtol=1e-8)
    np.testing.assert_allclose(back.angular_velocity, imu.angular_velocity, rtol=1e-8)
    assert not back.includes_gravity
    assert back.R_camera_imu is not None


def test_an_imu_table_may_have_the_papers_header_of_two_rows(tmp_path: Path) -> None:
    groups = '"The Time Mark, N","Linear acceleration, m/s2",,,"Angular acceleration, rad/s2",,'
    path = tmp_path / "imu.csv"
    path.write_text(f"{groups}\n,X,Y,Z,X,Y,Z\n0,1,2,3,4,5,6\n0.1,7,8,9,10,11,12\n", encoding="utf-8")
    imu = read_imu_csv(path)
    assert imu.times.tolist() == [0, 0.1]
    assert imu.acceleration.tolist() == [[1, 2, 3], [7, 8, 9]]
    assert imu.angular_velocity.tolist() == [[4, 5, 6], [10, 11, 12]]
    path.write_text(f"{groups}\n,X,Y,W,X,Y,Z\n0,1,2,3,4,5,6\n", encoding="utf-8")
    with pytest.raises(InvalidRecording, match="'w' under 'linear acceleration, m/s2' is not known"):
        read_imu_csv(path)


def test_columns_may_come_in_another_order_with_others_between_and_a_byte_order_mark(tmp_path: Path) -> None:
    text = "\ufeffgz,note,timestamp,ax,ay,az,gx,gy\r\n6,hi,0.5,1,2,3,4,5\r\n\r\n"
    (tmp_path / "imu.csv").write_text(text, encoding="utf-8")
    imu = read_imu_csv(tmp_path / "imu.csv")
    assert imu.times.tolist() == [0.5]
    assert imu.acceleration.tolist() == [[1, 2, 3]]
    assert imu.angular_velocity.tolist() == [[4, 5, 6]]


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "empty"),
        (f"{IMU_HEADER}\n", "no rows"),
        ("time,ax,ay,az,gx,gy,gz\n0,0,0,0,0,0,0\n", "no column timestamp"),
        (f"{IMU_HEADER.replace(',', ';')}\n0;0;0;0;0;0;0\n", "no column"),
        (f"{IMU_HEADER}\n0,0,0,0,0,0\n", "row 2: 6 values"),
        (f"{IMU_HEADER}\n0,0,0,0,0,0,x\n", "'x' under gz"),
        (f"{IMU_HEADER}\n0,0,0,0,0,0,nan\n", "row 2: 'nan'"),
        (f"{IMU_HEADER}\n0,0,0,inf,0,0,0\n", "'inf' under az"),
        (f"{IMU_HEADER}\n1,0,0,0,0,0,0\n0.5,0,0,0,0,0,0\n", "row 3: time 0.5"),
        (f"{IMU_HEADER}\n1,0,0,0,0,0,0\n1,0,0,0,0,0,0\n", "does not come after"),
    ],
)
def test_a_broken_imu_table_is_reported(tmp_path: Path, text: str, complaint: str) -> None:
    (tmp_path / "imu.csv").write_text(text)
    with pytest.raises(InvalidRecording, match=complaint) as caught:
        read_imu_csv(tmp_path / "imu.csv")
    assert "imu.csv" in caught.value.message


def test_a_table_that_is_not_text_is_reported(tmp_path: Path) -> None:
    (tmp_path / "imu.csv").write_bytes(b"\x89PNG\xff\xfe")
    with pytest.raises(InvalidRecording, match="not a text file"):
        read_imu_csv(tmp_path / "imu.csv")


@_SHARED_FOLDER
@given(tail=st.text(st.characters(exclude_categories=["Cs"]), max_size=60))
def test_whatever_follows_a_header_gives_a_table_or_our_error(tmp_path: Path, tail: str) -> None:
    path = tmp_path / "frames.csv"
    path.write_text("frame,timestamp\n" + tail, encoding="utf-8")
    with suppress(InvalidRecording):
        numbers, times = read_frames_csv(path)
        assert len(numbers) == len(times) > 0
    with suppress(InvalidTrajectory):
        assert np.isfinite(read_pose_table(path).T_map_camera).all()


def test_a_frame_table_comes_back(tmp_path: Path) -> None:
    numbers, times = np.array([0, 1, 5]), np.array([0.0, 0.0333, 0.1667])
    write_frames_csv(tmp_path / "frames.csv", numbers, times)
    back_numbers, back_times = read_frames_csv(tmp_path / "frames.csv")
    np.testing.assert_array_equal(back_numbers, numbers)
    np.testing.assert_allclose(back_times, times)


@pytest.mark.parametrize("rows", ["0,0\n0,1\n", "1,0\n0,1\n", "0.5,0\n", "0,1\n1,1\n", "0,1\n1,0.5\n", "1e30,0\n"])
def test_a_broken_frame_table_is_reported(tmp_path: Path, rows: str) -> None:
    (tmp_path / "frames.csv").write_text("frame,timestamp\n" + rows)
    with pytest.raises(InvalidRecording):
        read_frames_csv(tmp_path / "frames.csv")


@pytest.mark.parametrize(
    "description",
    [
        CameraFile(),
        CameraFile(fps=25.0, gravity_included=False, readout_s=0.015),
        CameraFile(Camera(640, 480, 500, 501, 320, 240, (0.1, 0.2, 0, 0, 0.3)), R_camera_imu=np.eye(3)[[1, 2, 0]]),
    ],
)
def test_a_camera_file_comes_back(tmp_path: Path, description: CameraFile) -> None:
    write_camera_json(tmp_path / "camera.json", description)
    back = read_camera_json(tmp_path / "camera.json")
    assert (back.camera, back.fps, back.gravity_included, back.readout_s) == (
        description.camera,
        description.fps,
        description.gravity_included,
        description.readout_s,
    )
    np.testing.assert_array_equal(back.R_camera_imu, description.R_camera_imu)


WHOLE = {"width": 640, "height": 480, "fx": 500, "fy": 500, "cx": 320, "cy": 240}


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "{",
        json.dumps({"fx": 500}),
        json.dumps(WHOLE | {"fx": "wide"}),
        json.dumps(WHOLE | {"fx": -1}),
        json.dumps(WHOLE | {"fx": 10**400}),
        json.dumps(WHOLE | {"fx": float("nan")}),
        json.dumps(WHOLE | {"width": float("inf")}),
        json.dumps(WHOLE | {"distortion": [1, 2]}),
        json.dumps(WHOLE | {"distortion": 3}),
        json.dumps({"R_camera_imu": [[1, 0], [0, 1]]}),
        json.dumps({"R_camera_imu": [[1, 0, 0], [0, 1, 0], [0, 0, -1]]}),
        json.dumps({"R_camera_imu": "identity"}),
        json.dumps({"gravity_included": "yes"}),
        json.dumps({"readout_s": "fast"}),
        json.dumps({"readout_s": 15}),
        json.dumps({"readout_s": float("nan")}),
        json.dumps({"fps": 0}),
        json.dumps({"fps": "30"}),
    ],
)
def test_a_broken_camera_file_is_reported(tmp_path: Path, text: str) -> None:
    (tmp_path / "camera.json").write_text(text)
    with pytest.raises(InvalidCamera):
        read_camera_json(tmp_path / "camera.json")


@pytest.mark.parametrize("name", ["model", "camera_model", "distortion_model"])
def test_a_lens_that_is_named_otherwise_is_not_taken_for_a_pinhole(tmp_path: Path, name: str) -> None:
    """A fisheye's file had "model" in place of "lens": its pictures were said to contradict each other."""
    path = tmp_path / "camera.json"
    path.write_text(json.dumps(WHOLE | {name: "OPENCV_FISHEYE"}))
    with pytest.raises(InvalidCamera, match=f"{name} is 'OPENCV_FISHEYE'") as refused:
        read_camera_json(path)
    assert "fisheye" in refused.value.hint
    for named in ({name: "OPENCV"}, {name: "Phone 7"}, {name: "OPENCV_FISHEYE", "lens": "fisheye"}):
        path.write_text(json.dumps(WHOLE | named))
        assert read_camera_json(path).camera is not None


def pose_rows(separator: str) -> tuple[str, np.ndarray]:
    rng = np.random.default_rng(3)
    quaternions, positions = Rotation.random(4, rng=rng).as_quat(), rng.normal(size=(4, 3))
    rows = [
        separator.join(f"{value:.9f}" for value in (0.5 * i, *p, *q))
        for i, (p, q) in enumerate(zip(positions, quaternions, strict=True))
    ]
    T = np.array([Pose.from_quaternion(p, q).T_map_camera for p, q in zip(positions, quaternions, strict=True)])
    return "\n".join(rows) + "\n", T


@pytest.mark.parametrize("separator", [" ", ",", ", ", "\t"])
@pytest.mark.parametrize("head", ["", "# frame tx ty tz\n\n", "timestamp,tx,ty,tz,qx,qy,qz,qw\n"])
def test_a_pose_table_is_read_with_blanks_or_commas_comments_or_a_header(
    tmp_path: Path, separator: str, head: str
) -> None:
    rows, T = pose_rows(separator)
    (tmp_path / "poses.txt").write_text(head + rows)
    table = read_pose_table(tmp_path / "poses.txt")
    np.testing.assert_allclose(table.keys, [0, 0.5, 1, 1.5])
    np.testing.assert_allclose(table.T_map_camera, T, atol=1e-7)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "# nothing\n",
        "0 1 2 3\n",
        "0 0 0 0 0 0 0 1 9\n",
        "0 0 0 0 0 0 0 nan\n",
        "0 0 0 0 0 0 0 0\n",
        "0 0 0 0 0 0 0 2\n",
        "0 0 0 0 0 0 0 1\n0 0 0 0 0 0 0 1\n",
        "0 0 0 0 0 0 0 1\nx 0 0 0 0 0 0 1\n",
    ],
)
def test_a_broken_pose_table_is_reported(tmp_path: Path, text: str) -> None:
    (tmp_path / "poses.txt").write_text(text)
    with pytest.raises(InvalidTrajectory):
        read_pose_table(tmp_path / "poses.txt")


@pytest.mark.parametrize("column", range(7))
def test_poses_that_are_no_numbers_are_refused(column: int) -> None:
    rows = np.array([[0.0, 0, 0, 0, 0, 0, 1]])
    rows[0, column] = np.nan
    with pytest.raises(InvalidTrajectory):
        poses_from_rows(rows, "images.txt")


def turning_walk(times: np.ndarray) -> np.ndarray:
    """Poses (N, 4, 4) of a walk at 2 m/s that turns at 1 rad/s."""
    T = np.tile(np.eye(4), (len(times), 1, 1))
    T[:, :3, :3] = Rotation.from_rotvec(np.outer(times, [0, 0, 1])).as_matrix()
    T[:, 0, 3] = 2 * times
    return T


def test_poses_by_time_are_interpolated_to_the_frames() -> None:
    keys = np.arange(0, 1.0, 0.01)
    frames = MissingImages(0.0133 + np.arange(25) / 30, np.arange(25))
    poses = match_poses(PoseTable(keys, turning_walk(keys)), frames)
    assert poses.known.all()
    np.testing.assert_allclose(poses.T_map_camera, turning_walk(frames.times), atol=1e-9)


def test_poses_are_not_interpolated_across_gaps_nor_beyond_the_ends() -> None:
    keys = np.array([0.01, 0.5, 0.5, 0.99])
    frames = MissingImages(np.arange(11) / 10, np.arange(11))
    poses = match_poses(PoseTable(keys, turning_walk(keys)), frames)
    assert np.flatnonzero(poses.known).tolist() == [0, 5, 10]
    np.testing.assert_allclose(poses.T_map_camera[poses.known], turning_walk(np.array([0.01, 0.5, 0.99])), atol=1e-12)
