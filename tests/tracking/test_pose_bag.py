"""Bags of poses, read by programs of others: mcap's own reader, and rosbags."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation

from bag_messages import bag_messages
from rholoc.errors import StorageFull
from rholoc.geometry import R_FORWARD_OPTICAL, pose_matrix
from rholoc.tracking import PoseBag

START_S = 1_700_000_000.25


def random_pose(seed):
    rng = np.random.default_rng(seed)
    return pose_matrix(Rotation.random(rng=rng).as_matrix(), rng.normal(size=3))


T_BASE_CAMERA, T_MAP_ODOM = random_pose(100), random_pose(101)
POSES = [random_pose(seed) for seed in range(5)]


@pytest.fixture
def bag(tmp_path):
    path = tmp_path / "track.mcap"
    with PoseBag(path, T_BASE_CAMERA) as bag:
        bag.status(START_S, "searching")
        for number, T_map_camera in enumerate(POSES):
            time_s = START_S + number / 10
            bag.belief(time_s, 0.9, 0.8)
            bag.pose(time_s, T_map_camera, np.diag([1e-4] * 3 + [1e-6] * 3), T_MAP_ODOM if number else None)
    return path


def matrix(position, rotation):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat([rotation.x, rotation.y, rotation.z, rotation.w]).as_matrix()
    T[:3, 3] = position.x, position.y, position.z
    return T


def test_poses_and_transforms_agree_with_what_was_written(bag):
    poses, trees, static, statuses = [], [], [], []
    for topic, logged_ns, said in bag_messages(bag):
        if topic == "/visual_localization/pose":
            assert said.header.frame_id == "map"
            assert said.header.stamp.sec + said.header.stamp.nanosec * 1e-9 == pytest.approx(logged_ns * 1e-9)
            poses.append(matrix(said.pose.pose.position, said.pose.pose.orientation))
            covariance = np.reshape(said.pose.covariance, (6, 6))
            np.testing.assert_allclose(covariance, covariance.T)
            arm = np.linalg.norm(T_BASE_CAMERA[:3, 3])  # from camera to base; 1e-6 rad² about each axis
            assert np.trace(covariance[:3, :3]) == pytest.approx(3e-4 + 2e-6 * arm**2)
            assert np.trace(covariance[3:, 3:]) == pytest.approx(3e-6)
        elif topic == "/tf":
            trees.append({one.child_frame_id: one for one in said.transforms})
        elif topic == "/tf_static":
            static += said.transforms
        elif topic == "/visual_localization/status":
            statuses.append(said.data)
    assert statuses == ["searching"]
    (camera,) = static
    assert (camera.header.frame_id, camera.child_frame_id) == ("base_link", "camera_optical_frame")
    T_base_camera = matrix(camera.transform.translation, camera.transform.rotation)
    for number, (T_map_camera, T_map_base, tree) in enumerate(zip(POSES, poses, trees, strict=True)):
        np.testing.assert_allclose(T_map_base @ T_base_camera, T_map_camera, atol=1e-9)
        T, frame = np.eye(4), "base_link"  # up the tree
        while frame != "map":
            one = tree[frame]
            T = matrix(one.transform.translation, one.transform.rotation) @ T
            frame = one.header.frame_id
        np.testing.assert_allclose(T, T_map_base, atol=1e-9)
        assert ("odom" in tree) == (number > 0)


def test_it_is_a_bag_of_ros_2(bag):
    with bag.open("rb") as file:
        reader = make_reader(file)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
    assert {schema.encoding for schema in summary.schemas.values()} == {"ros2msg"}
    static = next(one for one in summary.channels.values() if one.topic == "/tf_static")
    assert "durability: transient_local" in static.metadata["offered_qos_profiles"]
    assert summary.statistics.message_start_time == round(START_S * 1e9)
    with AnyReader([bag]) as bags:
        count = {one.topic: one.msgcount for one in bags.connections}
        assert count["/visual_localization/pose"] == count["/visual_localization/recognized"] == len(POSES)
        for connection, _, raw in bags.messages():
            bags.deserialize(raw, connection.msgtype)


def test_a_bag_without_a_pose_can_be_read(tmp_path):
    with PoseBag(tmp_path / "none.mcap", T_BASE_CAMERA):
        pass
    assert list(bag_messages(tmp_path / "none.mcap")) == []


def test_nothing_else_is_left_and_what_was_there_is_replaced(bag):
    with PoseBag(bag, T_BASE_CAMERA) as other:
        other.status(1.0, "lost")
    assert [one.name for one in bag.parent.iterdir()] == ["track.mcap"]
    assert len(list(bag_messages(bag))) == 1


def test_what_was_tracked_is_kept_where_tracking_fails(tmp_path):
    with contextlib.suppress(RuntimeError), PoseBag(tmp_path / "track.mcap", T_BASE_CAMERA) as bag:
        bag.status(1.0, "tracking")
        raise RuntimeError("the camera was unplugged")
    assert len(list(bag_messages(tmp_path / "track.mcap"))) == 1


def test_a_full_disk_is_said(tmp_path, monkeypatch):
    from rosbags.rosbag2 import Writer

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Writer, "write", full)
    with pytest.raises(StorageFull), PoseBag(tmp_path / "track.mcap", T_BASE_CAMERA) as bag:
        bag.status(1.0, "tracking")


def test_a_camera_that_is_not_turned_looks_along_the_robots_x():
    np.testing.assert_array_equal(R_FORWARD_OPTICAL @ [0, 0, 1], [1, 0, 0])
    np.testing.assert_array_equal(R_FORWARD_OPTICAL @ [0, 1, 0], [0, 0, -1])
