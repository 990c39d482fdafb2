"""The thin node on a stand-in of rclpy's interface: what it publishes, and above all when it does not."""

import importlib

import numpy as np
import played_robot as robot
import pytest
import ros_stand_in
from played_robot import PlayedService
from ros_messages import message_class
from scipy.spatial.transform import Rotation

from rholoc_client import UnknownMap

POSE, TF = "visual_localization/pose", "tf"
TRIGGER, LOCALIZE = "visual_localization/trigger_localization", "visual_localization/localize_picture"
RATE_HZ = 10


def drive(bus, seconds, room=0, with_odometry=True, late_s=0.0):
    """Play a robot: pictures, each with odometry that comes a little later."""
    bus.deliver("tf_static", robot.mounting())
    for _ in range(round(seconds * RATE_HZ)):
        time_s = bus.now_ns * 1e-9
        bus.deliver("camera_info", robot.camera_info(time_s))
        bus.deliver("image/compressed", robot.picture(time_s, room))
        bus.sleep(late_s)
        if with_odometry:
            bus.deliver("tf", robot.odometry(time_s))
        bus.sleep(1 / RATE_HZ - late_s)


def stamp_s(message):
    return message.header.stamp.sec + message.header.stamp.nanosec * 1e-9


def broadcasts(bus):
    return [one for message in bus.sent[TF] for one in message.transforms]


def states(bus):
    return [message.status[0] for message in bus.sent["diagnostics"]]


def errors_m(bus):
    return [
        np.linalg.norm(robot.pose_matrix(one.pose.pose)[:3, 3] - robot.T_map_base(stamp_s(one))[:3, 3])
        for one in bus.sent[POSE]
    ]


def test_poses_are_of_the_base_at_the_pictures_own_stamps(bus, start):
    start(PlayedService())
    drive(bus, 3, late_s=0.03)
    assert len(bus.sent[POSE]) > 20
    for one in bus.sent[POSE]:
        expected, found = robot.T_map_base(stamp_s(one)), robot.pose_matrix(one.pose.pose)
        assert one.header.frame_id == "map"
        np.testing.assert_allclose(found[:3, 3], expected[:3, 3], atol=0.02)
        assert Rotation.from_matrix(found[:3, :3].T @ expected[:3, :3]).magnitude() < 0.01
        covariance = np.reshape(one.pose.covariance, (6, 6))
        assert 0.003 < np.sqrt(covariance[0, 0]) < 0.05
        assert 0.001 < np.sqrt(covariance[5, 5]) < 0.02
    assert stamp_s(bus.sent[POSE][0]) == pytest.approx(robot.ORIGIN_S + 0.1, abs=0.11)
    assert states(bus)[-1].message == "Localized."


def test_transforms_are_off_unless_they_are_asked_for(bus, start):
    start(PlayedService())
    drive(bus, 2)
    assert not bus.sent[TF]


def test_map_to_odom_with_odometry_is_the_robots_place(bus, start):
    """By SciPy's evaluation of what was broadcast; never map → base_link."""
    start(PlayedService(), publish_map_to_odom_tf=True, planar=True)
    drive(bus, 6)
    assert {(one.header.frame_id, one.child_frame_id) for one in broadcasts(bus)} == {("map", "odom")}
    tree = ros_stand_in.Buffer()
    for message in bus.sent[TF]:
        tree.add(message, False)
    first_s, last_s = stamp_s(broadcasts(bus)[0]), stamp_s(broadcasts(bus)[-1])
    assert last_s > bus.now_ns * 1e-9 + 0.2  # dated into the future
    for time_s in np.arange(first_s + 0.5, last_s - 0.4, 0.1):
        T_map_odom = tree.up("map", "odom", round(time_s * 1e9))
        found = T_map_odom @ robot.T_odom_base(time_s)
        np.testing.assert_allclose(found[:3, 3], robot.T_map_base(time_s)[:3, 3], atol=0.05)
        assert T_map_odom[2, 3] == 0


def test_corrections_never_exceed_the_bound(bus, start):
    start(PlayedService(), publish_map_to_odom_tf=True, correction_m_s=0.05, tf_rate_hz=20.0)
    drive(bus, 8)
    before = None
    for one in broadcasts(bus):
        t, q = one.transform.translation, one.transform.rotation
        T = robot.transform([t.x, t.y, t.z], Rotation.from_quat([q.x, q.y, q.z, q.w]))
        now_s = stamp_s(one)
        if before is not None:
            T_odom_base = robot.T_odom_base(now_s - 0.35)
            moved_m = np.linalg.norm((T @ T_odom_base - before[0] @ T_odom_base)[:3, 3])
            assert moved_m < 0.05 * (now_s - before[1]) + 0.002
        before = T, now_s


def test_it_is_silent_until_it_is_localized_and_again_when_lost(bus, start):
    start(PlayedService(), publish_map_to_odom_tf=True, lost_m=0.05)
    drive(bus, 3, room=1)
    assert not bus.sent[POSE]
    assert not bus.sent[TF]
    assert states(bus)[-1].message.startswith("Searching")
    drive(bus, 3)
    assert bus.sent[POSE]
    drive(bus, 8, room=1)  # odometry drifts, until the pose is no longer known
    poses, sent, lost_s = len(bus.sent[POSE]), len(bus.sent[TF]), stamp_s(bus.sent[POSE][-1])
    assert lost_s < bus.now_ns * 1e-9 - 1
    assert states(bus)[-1].message.startswith("Lost")
    drive(bus, 1, room=1)
    assert (len(bus.sent[POSE]), len(bus.sent[TF])) == (poses, sent)
    drive(bus, 4)
    assert len(bus.sent[POSE]) > poses
    assert max(errors_m(bus)) < 0.12


def test_it_is_silent_when_pictures_stop(bus, start):
    start(PlayedService(), publish_map_to_odom_tf=True)
    drive(bus, 2)
    bus.sleep(1.5)
    sent = len(bus.sent[TF])
    bus.sleep(1)
    assert len(bus.sent[TF]) == sent
    assert states(bus)[-1].message.startswith("No pictures")


def test_pictures_without_odometry_of_their_moment_are_dropped(bus, start):
    service = PlayedService()
    start(service)
    drive(bus, 2, with_odometry=False)
    assert not service.priors
    assert not bus.sent[POSE]
    assert states(bus)[-1].level == b"\2"
    assert "odometry" in states(bus)[-1].message


def test_odometry_may_be_a_topic(bus, start):
    start(PlayedService(), odometry="topic")
    bus.deliver("tf_static", robot.mounting())
    for _ in range(20):
        time_s = bus.now_ns * 1e-9
        bus.deliver("camera_info", robot.camera_info(time_s))
        for offset_s in (-0.02, 0.02):  # around the picture's stamp
            message = robot.stamped("nav_msgs/msg/Odometry", time_s + offset_s, "odom", child_frame_id="base_link")
            pose = message.pose.pose
            robot.place(pose.position, pose.orientation, robot.T_odom_base(time_s + offset_s))
            if offset_s > 0:
                bus.deliver("image/compressed", robot.picture(time_s))
                assert len(bus.sent[POSE]) == 0 or stamp_s(bus.sent[POSE][-1]) < time_s
            bus.deliver("odom", message)
        bus.sleep(0.1)
    assert len(bus.sent[POSE]) > 10
    assert max(errors_m(bus)) < 0.02


@pytest.mark.parametrize("topic", ["initialpose", TRIGGER])
def test_a_hint_is_a_prior_that_moves_with_odometry(bus, start, topic):
    service = PlayedService()
    start(service)
    hint = robot.stamped("geometry_msgs/msg/PoseWithCovarianceStamped", 0.0, "map")
    robot.place(hint.pose.pose.position, hint.pose.pose.orientation, robot.T_map_base(bus.now_ns * 1e-9))
    hint.pose.covariance = (np.diag([0.25, 0.25, 0, 0, 0, 0.07])).ravel().tolist()
    bus.deliver(topic, hint)
    drive(bus, 3, room=1)
    priors = [prior for prior in service.priors if prior is not None]
    assert len(priors) >= 3
    assert priors[0].radius_m == pytest.approx(1.5)
    expected = (robot.T_map_base(robot.ORIGIN_S) @ robot.T_BASE_CAMERA)[:3, 3]
    np.testing.assert_allclose(priors[0].position, expected, atol=1e-6)
    assert np.linalg.norm(np.subtract(priors[-1].position, expected)) > 0.5
    drive(bus, 12, room=1)
    assert service.priors[-1] is None  # a hint is not kept for ever
    drive(bus, 5)
    assert bus.sent[POSE]


@pytest.mark.parametrize(
    ("frame", "w", "sigma", "message"),
    [("odom", 1.0, 0.5, "not in the map"), ("map", 0.0, 0.5, "length 0"), ("map", 1.0, np.nan, "not finite")],
)
def test_a_hint_that_makes_no_sense_changes_nothing(bus, start, frame, w, sigma, message):
    start(PlayedService())
    drive(bus, 1)
    poses = len(bus.sent[POSE])
    hint = robot.stamped("geometry_msgs/msg/PoseWithCovarianceStamped", 0.0, frame)
    hint.pose.pose.orientation.w, hint.pose.covariance[0] = w, sigma
    bus.deliver("initialpose", hint)
    assert message in bus.log[-1]
    drive(bus, 1, room=1)
    assert len(bus.sent[POSE]) == poses + RATE_HZ  # the track goes on


def test_a_trigger_begins_anew(bus, start):
    start(PlayedService())
    drive(bus, 2)
    poses = len(bus.sent[POSE])
    response = bus.services[TRIGGER](None, message_class("std_msgs/msg/String")())
    assert response.success
    drive(bus, 1, room=1)
    assert len(bus.sent[POSE]) == poses
    drive(bus, 2)
    assert len(bus.sent[POSE]) > poses


def test_one_picture_is_localized_by_a_service(bus, start):
    start(PlayedService())
    call = bus.services[LOCALIZE]
    assert not call(None, message_class("std_msgs/msg/String")()).success
    drive(bus, 0.1)
    response = call(None, message_class("std_msgs/msg/String")())
    assert response.success, response.message
    (one,) = bus.sent["visual_localization/picture_pose"]
    np.testing.assert_allclose(robot.pose_matrix(one.pose.pose), robot.T_map_base(stamp_s(one)), atol=1e-9)
    drive(bus, 0.1, room=1)
    assert call(None, message_class("std_msgs/msg/String")()).message == "Too few matches agree."


def test_one_pose_for_each_answer(bus, start):
    service = PlayedService()
    start(service, pose_at_answers_only=True)
    drive(bus, 5)
    assert 3 <= len(bus.sent[POSE]) <= len(service.priors)


def test_an_error_of_the_service_is_diagnosed(bus, start):
    service = PlayedService()
    service.error = UnknownMap("There is no map 'room'.", "Name one of: hall.")
    start(service)
    drive(bus, 2)
    assert not bus.sent[POSE]
    assert any(state.level == b"\2" and "There is no map 'room'" in state.message for state in states(bus))


def test_a_clock_that_goes_back_begins_anew(bus, start):
    start(PlayedService(), publish_map_to_odom_tf=True)
    drive(bus, 2)
    bus.now_ns -= 60_000_000_000
    for timer in bus.timers:
        timer[2] = bus.now_ns
    poses = len(bus.sent[POSE])
    drive(bus, 2)
    assert len(bus.sent[POSE]) > poses + 10
    assert max(errors_m(bus)[poses:]) < 0.02


def spy(tracker, read, monkeypatch):
    """Note the readings that a tracker gets."""
    imu = tracker.imu
    monkeypatch.setattr(tracker, "imu", lambda *one: (read.append(one), imu(*one)))


def test_raw_pictures_and_an_imu_do_without_odometry(bus, start, monkeypatch):
    """At rest. Readings reach the tracker in the camera's axes, where gravity's reaction is along −y."""
    service, read = PlayedService(), []
    monkeypatch.setattr(robot, "read", lambda picture: (robot.ORIGIN_S, 0))
    node = start(service, odometry="none", compressed=False, use_imu=True)
    bus.deliver("tf_static", robot.mounting())
    for i in range(30):
        time_s = bus.now_ns * 1e-9
        bus.deliver("camera_info", robot.camera_info(time_s))
        size = {"width": 64, "height": 48, "step": 64, "encoding": "mono8", "data": bytes(64 * 48)}
        bus.deliver("image", robot.stamped("sensor_msgs/msg/Image", time_s, "camera", **size))
        if i == 0:
            spy(node._robot._tracker, read, monkeypatch)
        for k in range(10):
            message = robot.stamped("sensor_msgs/msg/Imu", time_s + k / 100, "base_link")
            message.linear_acceleration.z = 9.81
            bus.deliver("imu", message)
        bus.sleep(0.1)
    assert len(bus.sent[POSE]) > 10
    assert np.linalg.norm(robot.pose_matrix(bus.sent[POSE][-1].pose.pose)[:3, 3]) < 0.05
    np.testing.assert_allclose(read[-1][1], robot.T_BASE_CAMERA[:3, :3].T @ [0, 0, 9.81], atol=1e-9)
    assert read[-1][1][1] < -9
    assert not bus.sent[TF]


def test_deactivated_it_is_silent(bus, start):
    node = start(PlayedService(), publish_map_to_odom_tf=True)
    drive(bus, 2)
    node.on_deactivate(None)
    counts = {topic: len(messages) for topic, messages in bus.sent.items()}
    drive(bus, 1)
    assert {topic: len(messages) for topic, messages in bus.sent.items()} == counts
    assert not bus.services
    node.on_cleanup(None)
    assert node.on_configure(None) is ros_stand_in.SUCCESS
    node.on_activate(None)
    drive(bus, 2)
    assert len(bus.sent[POSE]) > counts[POSE]


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"map_name": ""}, "map_name is empty"),
        ({"odometry": "wheels"}, "use one of tf, topic, none"),
        ({"odom_frame": "map"}, "three different names"),
        ({"odometry": "none", "publish_map_to_odom_tf": True}, "no odom frame"),
        ({"wait_s": -1.0}, "positive"),
        ({"compressed": "false"}, "use that type"),
    ],
)
def test_parameters_that_make_no_sense_are_refused_in_one_line(bus, parameters, message):
    bus.overrides = {"map_name": "room", **parameters}
    assert (
        importlib.import_module("rholoc_ros.node").LocalizationNode().on_configure(None) is ros_stand_in.Return.FAILURE
    )
    (line,) = bus.log
    assert message in line
