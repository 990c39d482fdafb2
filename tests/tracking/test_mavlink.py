"""MAVLink messages, decoded by pymavlink: frames, covariance, resets, origin, and silence while lost."""

import math
import socket
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common
from scipy.spatial.transform import Rotation

from rholoc.errors import InvalidInput
from rholoc.geometry import R_FORWARD_OPTICAL, pose_matrix
from rholoc.maps import SiteOnEarth
from rholoc.tracking.mavlink import Encoder, MavlinkSender
from rholoc_client.tracking import TrackStatus

FORWARD = pose_matrix(R_FORWARD_OPTICAL, np.zeros(3))
NORTH_EAST = SiteOnEarth(52.52, 13.405, 74.0, 90.0)  # y points east, x south


def decoded(data):
    return common.MAVLink(None).parse_buffer(data) or []


class Listener:
    """A flight controller's side of the socket."""

    def __init__(self):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(20)
        self.address = f"127.0.0.1:{self.socket.getsockname()[1]}"
        self.parser = common.MAVLink(None)

    def messages(self):
        while True:
            yield from self.parser.parse_buffer(self.socket.recv(1000)) or []

    def next(self, kind):
        return next(one for one in self.messages() if one.get_type() == kind)


@pytest.fixture
def listener():
    listener = Listener()
    yield listener
    listener.socket.close()


@given(st.tuples(*[st.floats(-1000, 1000)] * 3), st.tuples(*[st.floats(-3, 3)] * 3), st.integers(0, 300))
def test_an_odometry_message_is_what_pymavlink_reads(position, turn, resets):
    rotation = Rotation.from_rotvec(turn)
    covariance = np.arange(36.0).reshape(6, 6)
    covariance += covariance.T
    T = pose_matrix(rotation.as_matrix(), np.array(position))
    (said,) = decoded(Encoder().odometry(1_700_000_000.5, T, covariance, resets, 0.876))
    assert said.get_type() == "ODOMETRY"
    assert (said.time_usec, said.frame_id, said.child_frame_id) == (1_700_000_000_500_000, 20, 12)
    assert [said.x, said.y, said.z] == pytest.approx(position, rel=1e-6)
    w, x, y, z = said.q  # w first
    assert (Rotation.from_quat([x, y, z, w]).inv() * rotation).magnitude() < 1e-6
    np.testing.assert_allclose(said.pose_covariance, covariance[np.triu_indices(6)])
    assert (said.reset_counter, said.quality, said.estimator_type) == (
        resets % 256,
        88,
        common.MAV_ESTIMATOR_TYPE_VISION,
    )
    assert math.isnan(said.vx)
    assert math.isnan(said.velocity_covariance[0])


def test_messages_are_numbered_and_the_others_are_read_too():
    encoder = Encoder()
    numbers = [decoded(encoder.heartbeat())[0].get_seq() for _ in range(258)]
    assert numbers == [*range(256), 0, 1]
    (heartbeat,) = decoded(encoder.heartbeat())
    assert (heartbeat.type, heartbeat.get_srcSystem(), heartbeat.get_srcComponent()) == (18, 1, 197)
    (origin,) = decoded(encoder.origin(NORTH_EAST, 1.0))
    assert (origin.latitude, origin.longitude, origin.altitude) == (525200000, 134050000, 74000)
    assert origin.target_system == 1


def test_a_robot_that_drives_forward_and_left_goes_forward_and_left(listener, step):
    """Map: x forward, y left, z up. The robot is at (2, 3, 1) and looks to its left by 90°."""
    T = pose_matrix(Rotation.from_euler("z", 90, degrees=True).as_matrix(), np.array([2.0, 3.0, 1.0])) @ FORWARD
    with MavlinkSender(listener.address, FORWARD, None) as sender:
        sender.take(step(10.0, T, resets=3))
        said = listener.next("ODOMETRY")
    assert (said.x, said.y, said.z) == pytest.approx((2.0, -3.0, -1.0))
    w, x, y, z = said.q
    assert Rotation.from_quat([x, y, z, w]).as_euler("ZYX", degrees=True) == pytest.approx((-90, 0, 0), abs=1e-4)
    assert said.reset_counter == 3
    assert said.quality == 90
    variances = np.array(said.pose_covariance)[[0, 6, 11, 15, 18, 20]]
    np.testing.assert_allclose(variances[:3], [1e-4, 2e-4, 3e-4], rtol=1e-5)
    np.testing.assert_allclose(variances[3:], np.radians([1, np.sqrt(2), np.sqrt(3)]) ** 2, rtol=1e-5)


def test_a_map_on_earth_is_sent_as_north_east_down_with_its_origin(listener, step):
    T = pose_matrix(np.eye(3), np.array([2.0, 3.0, 1.0])) @ FORWARD  # along x, which is south
    with MavlinkSender(listener.address, FORWARD, NORTH_EAST) as sender:
        sender.take(step(10.0, T))
        origin, said = None, None
        for message in listener.messages():
            origin = message if message.get_type() == "SET_GPS_GLOBAL_ORIGIN" else origin
            said = message if message.get_type() == "ODOMETRY" else said
            sender.take(step(10.0, T))
            if origin is not None and said is not None:
                break
    assert origin.latitude == 525200000
    assert (said.x, said.y, said.z) == pytest.approx((-2.0, 3.0, -1.0))
    w, x, y, z = said.q
    assert abs(Rotation.from_quat([x, y, z, w]).as_euler("ZYX", degrees=True)[0]) == pytest.approx(180, abs=1e-4)


def test_poses_between_frames_are_at_constant_velocity_unless_the_track_jumped(listener, step, monkeypatch):
    now_s = [100.0]
    sender = MavlinkSender(listener.address, FORWARD, None)
    monkeypatch.setattr(time, "monotonic", lambda: now_s[0])

    def at(x):
        return pose_matrix(np.eye(3), np.array([x, 0.0, 0.0])) @ FORWARD

    sender.take(step(1.0, at(0.0)))
    now_s[0] += 0.1
    sender.take(step(1.1, at(0.05)))
    time_s, T = sender._known.at(now_s[0] + 0.02)
    assert time_s == pytest.approx(1.12)
    assert T[0, 3] == pytest.approx(0.06)
    now_s[0] += 0.1
    sender.take(step(1.2, at(5.0), resets=1))
    assert sender._known.at(now_s[0] + 0.02)[1][0, 3] == pytest.approx(5.0)
    sender._socket.close()


def test_it_is_silent_until_the_place_is_known_and_when_it_is_lost(listener, step):
    T = FORWARD
    with MavlinkSender(listener.address, FORWARD, None) as sender:
        for said in (step(1.0), step(1.0, T, status=TrackStatus.LOST)):
            sender.take(said)
            assert sender._known is None
        assert listener.next("HEARTBEAT")
        sender.take(step(2.0, T))
        assert listener.next("ODOMETRY")


@pytest.mark.parametrize(
    "address", ["", "14550", ":14550", "host:", "127.0.0.1:0", "127.0.0.1:99999", "no.such.invalid:1", "a..b:14550"]
)
def test_what_is_no_address_is_refused(address):
    with pytest.raises(InvalidInput):
        MavlinkSender(address, FORWARD, None)
