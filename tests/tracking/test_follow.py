"""A camera is followed in a map on this machine: poses from the first recognized frame, answers whenever they come."""

import contextlib
import threading
from dataclasses import replace

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation

from bag_messages import bag_messages
from rholoc.errors import InvalidInput, StorageFull
from rholoc.geometry import R_FORWARD_OPTICAL, pose_distances, pose_matrix
from rholoc.localization import Localizer
from rholoc.recordings import GivenPoses, PoseKind, Recording
from rholoc.recordings.frames.memory_frames import MemoryFrames
from rholoc.recordings.recording import Odometry
from rholoc.tracking.follow import AtOnce, InBackground, follow
from rholoc.tracking.moments import Motion, film_times, odometry_of, paced, recorded_moments
from rholoc.tracking.pose_bag import PoseBag
from rholoc.tracking.users import TableOfTrack, Tally
from rholoc_client.tracking import TrackStatus

FRAMES = 12


@pytest.fixture(scope="module")
def localizer(picture_world):
    return Localizer(picture_world.map_)


@pytest.fixture(scope="module")
def still(picture_world):
    """A camera at rest."""
    frames = MemoryFrames([picture_world.image] * FRAMES, frames_per_second=10.0)
    return Recording(frames, "still", None, camera=picture_world.camera)


def steps(localizer, recording, motion=Motion.PICTURES, odometry=None, answering=None):
    moments = recorded_moments(recording, motion, odometry)
    return list(follow(localizer, recording.camera, motion, moments, answering))


def test_every_frame_from_the_second_answer_on_has_a_pose(localizer, still, picture_world):
    found = steps(localizer, still)
    assert [step.moment.number for step in found] == list(range(FRAMES))
    placed = [step for step in found if step.tracked.status is TrackStatus.TRACKING]
    assert len(placed) >= FRAMES - 5
    for step in placed:
        off_m, _ = pose_distances(np.array(step.tracked.pose.T_map_camera), picture_world.pose.T_map_camera)
        assert off_m < 0.02
        assert step.sigma_m < 0.1
    assert found[0].answer.localization.localized
    assert all((step.answer is not None) == step.asked for step in found)  # at once


def test_the_same_recording_gives_the_same_poses(localizer, still):
    tables = []
    for _ in range(2):
        table = TableOfTrack()
        for step in steps(localizer, still):
            table.take(step)
        tables.append(table.table())
    np.testing.assert_array_equal(tables[0].T_map_camera, tables[1].T_map_camera)
    assert len(tables[0]) == len(tables[0].frames) > 0


def test_an_answer_from_the_background_counts_when_it_comes(localizer, still):
    released = threading.Event()

    class Slow(InBackground):
        def ask(self, time_s, answer):
            super().ask(time_s, lambda: released.wait(60) and answer())

    answering, found = Slow(), []
    for step in follow(localizer, still.camera, Motion.PICTURES, recorded_moments(still, Motion.PICTURES), answering):
        found.append(step)
        if step.moment.number == 3:
            released.set()
            answering._pending[1].exception(60)  # it has come
    assert found[0].asked
    assert not any(step.asked for step in found[1:4])  # one question at a time
    assert found[4].answer.time_s == found[0].moment.time_s


def test_a_strange_picture_has_no_pose(localizer, still, picture_world):
    noise = np.random.default_rng(0).integers(0, 255, picture_world.image.shape).astype(np.uint8)
    strange = replace(still, frames=MemoryFrames([noise] * FRAMES, frames_per_second=10.0))
    tally, table = Tally(), TableOfTrack()
    for step in steps(localizer, strange):
        tally.take(step)
        table.take(step)
    assert tally.figures()["searching"] == FRAMES
    assert tally.figures()["answers_used"] == 0
    assert len(table.table()) == 0


def test_odometry_is_that_of_the_recording(localizer, still):
    T = pose_matrix(Rotation.from_rotvec([[0, 0, 0], [0, 0, 1.0]]).as_matrix(), np.array([[0, 0, 0], [1.0, 0, 0]]))
    ends = np.array([0.0, 1.0])
    with_odometry = replace(still, odometry=Odometry(ends, T, np.full(2, 0.01), np.full(2, 0.01)))
    poses = odometry_of(with_odometry)
    np.testing.assert_allclose(poses[5, :3, 3], [0.5, 0, 0], atol=1e-12)
    np.testing.assert_allclose(Rotation.from_matrix(poses[5, :3, :3]).as_rotvec(), [0, 0, 0.5], atol=1e-12)
    assert np.isnan(poses[11]).all()  # after its last row
    given = GivenPoses(np.ones(FRAMES, dtype=bool), np.repeat(np.eye(4)[None], FRAMES, axis=0))
    assert odometry_of(replace(still, poses=given)) is None
    assert odometry_of(replace(still, poses=replace(given, kind=PoseKind.ODOMETRY))) is given.T_map_camera
    found = steps(localizer, still, Motion.ODOMETRY, given.T_map_camera)
    assert found[-1].tracked.T_map_odom is not None


def test_odometry_that_is_no_motion_is_refused(localizer, still):
    with pytest.raises(InvalidInput, match="odometry"):
        steps(localizer, still, Motion.ODOMETRY, np.full((FRAMES, 4, 4), 2.0), AtOnce())


def test_pictures_without_times_are_a_film(still):
    assert film_times(still)[1] == pytest.approx(0.1)

    class Untimed(MemoryFrames):
        @property
        def timed(self):
            return False

    untimed = replace(still, frames=Untimed(still.frames.pictures, frames_per_second=1.0))
    assert film_times(untimed)[6] == pytest.approx(0.2)


def test_a_recording_is_played_at_its_own_pace(still, monkeypatch):
    now_s, slept = [100.0], []
    monkeypatch.setattr("time.monotonic", lambda: now_s[0])
    monkeypatch.setattr("time.sleep", slept.append)
    played = []
    for moment in paced(recorded_moments(still, Motion.PICTURES)):
        played.append(moment.number)
        now_s[0] += 0.35 if moment.number == 2 else 0.1
    assert played == [0, 1, 2, 5, 6, 7, 8, 9, 10, 11]  # what is more than a tenth of a second late is left out
    assert max(slept) <= 0.1 + 1e-9


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
