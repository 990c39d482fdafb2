"""Two processes on the loopback's DDS: the node in one, in the other a robot that also evaluates what comes back."""

import json
import os
import subprocess
import sys
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import played_robot as robot
import pytest
import ros_stand_in
from ros_messages import STORE, converted, from_dds, to_dds

pytest.importorskip("cyclonedds", reason="cyclonedds is absent: nothing is sent over DDS")

POSE = "visual_localization/pose"
POSE_KIND = "geometry_msgs/msg/PoseWithCovarianceStamped"
DRIVEN_S, RATE_HZ = 2.5, 20
TYPES = {
    "tf": "tf2_msgs/msg/TFMessage",
    POSE: POSE_KIND,
    "diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
}


@pytest.fixture
def service_url():
    """A service of HTTP that answers with the truth."""

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self):
            sent = self.rfile.read(int(self.headers["Content-Length"]))  # the picture, with fields around it
            picture = sent[sent.index(b"\x89PNG") : sent.index(b"IEND") + 8]
            body = json.dumps(robot.answer(picture)).encode()
            self.send_response(200)
            self.send_header("Content-Type", "application/json")
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_):
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()


@pytest.mark.slow
def test_a_robot_is_localized_over_dds(service_url, monkeypatch):
    from wire import LOOPBACK, Peer

    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    monkeypatch.setenv("ROS_DOMAIN_ID", str(1 + os.getpid() % 200))
    monkeypatch.setattr(robot, "ORIGIN_S", time.time())
    parameters = {"url": service_url, "map_name": "room", "compressed": True, "publish_map_to_odom_tf": True}
    parameters["wait_s"] = 10.0  # the machine may be busy
    folder = Path(__file__).parent
    path = os.pathsep.join([str(folder), str(folder.parents[1] / "ros")])
    command = [sys.executable, str(folder / "wire_node.py"), json.dumps(parameters)]
    node = subprocess.Popen(command, stdin=subprocess.PIPE, env={**os.environ, "PYTHONPATH": path})
    peer = Peer()
    for topic, kind in TYPES.items():
        peer.listen(kind, topic)
    try:
        wait_until_heard(peer, node)
        poses, transforms, statuses = play(peer)
    finally:
        node.stdin.close()
        assert node.wait(20) == 0
    assert len(poses) > DRIVEN_S * RATE_HZ / 3
    sent = {pose.header.stamp.sec * 10**9 + pose.header.stamp.nanosec: pose for pose in poses}
    for stamp_ns, pose in sent.items():
        expected = robot.T_map_base(stamp_ns * 1e-9)
        np.testing.assert_allclose(robot.pose_matrix(pose.pose.pose)[:3, 3], expected[:3, 3], atol=0.03)
    tree = ros_stand_in.Buffer()
    for message in transforms:
        for one in message.transforms:
            if one.header.frame_id == "map":
                assert one.child_frame_id == "odom"
                tree.add(message, False)
    first_ns, last_ns = (tree.of["odom"][1][i][0] for i in (0, -1))
    for stamp_ns in [one for one in sent if first_ns + 5e8 < one < last_ns]:
        T_map_base = tree.up("map", "odom", stamp_ns) @ robot.T_odom_base(stamp_ns * 1e-9)
        np.testing.assert_allclose(T_map_base[:3, 3], robot.T_map_base(stamp_ns * 1e-9)[:3, 3], atol=0.05)
    assert "Localized." in [one.status[0].message for one in statuses]


def wait_until_heard(peer, node):
    """Send the mounting, and wait until the node has found all that is sent and everything it sends is found."""
    peer.write("tf_static", robot.mounting())
    peer.writer("sensor_msgs/msg/CompressedImage", "image/compressed")
    peer.writer("sensor_msgs/msg/CameraInfo", "camera_info")
    peer.writer("tf2_msgs/msg/TFMessage", "tf")
    deadline = time.monotonic() + 30
    while not all(writer.get_matched_subscriptions() for writer in peer.writers.values()) or not all(
        reader.get_matched_publications() for _, reader in peer.readers.values()
    ):
        assert node.poll() is None
        assert time.monotonic() < deadline, "the node is not found"
        time.sleep(0.02)


def play(peer):
    """Drive; what came back: poses, transforms and diagnostics."""
    came = {topic: [] for topic in TYPES}
    for _ in range(round(DRIVEN_S * RATE_HZ)):
        time_s = time.time()
        peer.write("camera_info", robot.camera_info(time_s))
        peer.write("image/compressed", robot.picture(time_s))
        time.sleep(0.01)
        peer.write("tf", robot.odometry(time_s))
        time.sleep(1 / RATE_HZ - 0.01)
        for topic, message in peer.take():
            came[topic].append(message)
    return tuple(came[topic] for topic in (POSE, "tf", "diagnostics"))


@pytest.mark.parametrize(
    "message",
    [robot.odometry(1234.5), robot.camera_info(1234.5), robot.picture(1234.5), robot.stamped(POSE_KIND, 1234.5, "map")],
    ids=lambda message: message.kind,
)
def test_messages_have_the_bytes_that_rosbags_gives_them(message):
    """cyclonedds and rosbags write CDR independently of each other; each reads what the other wrote."""

    def made(name, values):
        arrays = {key: np.array(value) if is_numeric(value) else value for key, value in values.items()}
        if name == "sensor_msgs/msg/CompressedImage":
            arrays["data"] = np.array(values["data"], np.uint8)
        return STORE.types[name](**arrays)

    sample = to_dds(message)
    theirs = bytes(STORE.serialize_cdr(converted(message, message.kind, made), message.kind))
    ours = sample.serialize()
    assert ours.rstrip(b"\0") == theirs.rstrip(b"\0")
    assert vars(from_dds(type(sample).deserialize(theirs), message.kind)).keys() == vars(message).keys()


def is_numeric(value):
    return isinstance(value, list) and bool(value) and isinstance(value[0], int | float)
