"""The live view, read by a client of Foxglove's WebSocket protocol and the decoder of Foxglove's own library."""

import json
import re
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bag_messages import bag_messages
from foxglove_client import PATIENCE_S, Foxglove
from rholoc.errors import InvalidInput
from rholoc.geometry import Camera, Lens
from rholoc.tracking import pose_messages
from rholoc.tracking.live_view import LiveView
from rholoc.tracking.pose_bag import PoseBag
from rholoc.tracking.pose_messages import PICTURE_TOPICS, TOPICS
from rholoc.tracking.users import MessagesOfTrack

LAYOUT = Path(__file__).parents[2] / "docs" / "foxglove.json"
CAMERA = Camera(960, 720, 800.0, 810.0, 470.0, 350.0)
RATIONAL = (0.1, 0.2, 0.0, 0.0, 0.3, 0.4, 0.5, 0.6)


@pytest.fixture
def view():
    with LiveView("127.0.0.1:0", np.eye(4)) as view:
        yield view


def test_all_that_the_layout_shows_is_sent_as_it_happens(view, step, point_room):
    """And what is sent once reaches those who come later."""
    map_ = point_room.map_of(point_room.walk(10), "walk")
    user = MessagesOfTrack(view, map_, CAMERA)
    T = np.eye(4)
    T[:3, 3] = 1, 2, 3
    found, now_s = {}, 100.0
    with Foxglove(view.port) as foxglove:
        kinds = {one["topic"]: one["schemaName"] for one in foxglove.channels.values()}
        assert kinds == {**TOPICS, **PICTURE_TOPICS}
        assert {(one["encoding"], one["schemaEncoding"]) for one in foxglove.channels.values()} == {("cdr", "ros2msg")}
        deadline = time.monotonic() + PATIENCE_S
        while set(found) < set(kinds) and time.monotonic() < deadline:
            now_s += 1.25
            user.take(step(now_s, T, size=(720, 960)))
            found |= dict(foxglove.messages(0.2))
    assert set(found) == set(kinds)
    xyz = np.frombuffer(bytes(found["/map/points"].data), np.dtype([("xyz", "<f4", 3), ("bgra", "u1", 4)]))["xyz"]
    np.testing.assert_allclose(xyz, map_.landmarks.positions, atol=1e-5)
    named = [(one.name, one.offset) for one in found["/map/points"].fields]
    assert named == [("x", 0), ("y", 4), ("z", 8), ("rgba", 12)]
    picture = cv2.imdecode(np.frombuffer(bytes(found["/camera/image/compressed"].data), np.uint8), cv2.IMREAD_COLOR)
    info = found["/camera/camera_info"]
    assert picture.shape == (info.height, info.width, 3) == (360, 480, 3)
    ray = np.linalg.solve(np.reshape(info.k, (3, 3)), [(100 + 0.5) / 2 - 0.5, (60 + 0.5) / 2 - 0.5, 1])
    np.testing.assert_allclose(ray[:2], [(100 - CAMERA.cx) / CAMERA.fx, (60 - CAMERA.cy) / CAMERA.fy], atol=1e-9)
    p = found["/visual_localization/pose"].pose.pose.position
    assert (p.x, p.y, p.z) == (1, 2, 3)
    with Foxglove(view.port) as late:
        assert {topic for topic, _ in late.messages(1.0)} == {"/map/points", "/tf_static"}


@pytest.mark.parametrize(
    ("camera", "model", "coefficients"),
    [
        (replace(CAMERA, distortion=(0.1, 0.2, 0.0, 0.0)), "plumb_bob", (0.1, 0.2, 0, 0, 0)),
        (replace(CAMERA, distortion=RATIONAL), "rational_polynomial", RATIONAL),
        (replace(CAMERA, distortion=(0.1, 0.2, 0.3, 0.4), lens=Lens.FISHEYE), "equidistant", (0.1, 0.2, 0.3, 0.4)),
    ],
)
def test_camera_info_has_the_cameras_lens(view, step, point_room, camera, model, coefficients):
    user = MessagesOfTrack(view, point_room.map_of(point_room.walk(10), "walk"), camera)
    found, now_s = {}, 100.0
    with Foxglove(view.port) as foxglove:
        deadline = time.monotonic() + PATIENCE_S
        while "/camera/camera_info" not in found and time.monotonic() < deadline:
            now_s += 1.25
            user.take(step(now_s, np.eye(4), size=(720, 960)))
            found |= dict(foxglove.messages(0.2))
    info = found["/camera/camera_info"]
    assert (info.distortion_model, tuple(info.d)) == (model, coefficients)


def test_the_ellipsoid_holds_95_percent(tmp_path):
    R = Rotation.from_euler("xyz", [0.3, -0.4, 0.9]).as_matrix()
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = R @ np.diag([0.04, 0.01, 0.0025]) @ R.T
    T = np.eye(4)
    T[:3, 3] = 1, 2, 3
    with PoseBag(tmp_path / "one.mcap", np.eye(4)) as bag:
        bag.pose(1.0, T, covariance)
    (marker,) = [one for topic, _, one in bag_messages(tmp_path / "one.mcap") if topic.endswith("uncertainty")]
    q = marker.pose.orientation
    axes = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
    radii = np.array([marker.scale.x, marker.scale.y, marker.scale.z]) / 2
    drawn = np.random.default_rng(0).multivariate_normal([0, 0, 0], covariance[:3, :3], 20_000)
    assert np.mean(np.sum(np.square(drawn @ axes / radii), axis=1) <= 1) == pytest.approx(0.95, abs=0.01)


def test_a_path_grows_by_a_pose_a_second_and_is_bounded(tmp_path, monkeypatch):
    assert pose_messages._PATH_POSES == 600
    monkeypatch.setattr(pose_messages, "_PATH_POSES", 120)
    with PoseBag(tmp_path / "path.mcap", np.eye(4)) as bag:
        for number in range(1500):
            T = np.eye(4)
            T[0, 3] = number
            bag.pose(number / 10, T, None)
    paths = [one for topic, _, one in bag_messages(tmp_path / "path.mcap") if topic.endswith("path")]
    assert len(paths[-1].poses) == 120
    assert [round(one.pose.position.x) for one in paths[3].poses] == [0, 10, 20, 30]
    assert sum(len(one.poses) for one in paths) < 60 * 150


def test_the_layout_names_topics_that_are_written():
    layout = json.loads(LAYOUT.read_text())
    topics = {*layout["configById"]["3D!rholoc"]["topics"]}
    topics |= set(re.findall(r'"(/[\w/]+)(?:\.data)?"', LAYOUT.read_text()))
    assert topics <= {*TOPICS, *PICTURE_TOPICS}

    def panels(node):
        return {node} if isinstance(node, str) else panels(node["first"]) | panels(node["second"])

    assert panels(layout["layout"]) == set(layout["configById"])


@pytest.mark.parametrize("address", ["", ":1", "host:port", "127.0.0.1:99999"])
def test_an_address_that_is_none_is_refused(address):
    with pytest.raises(InvalidInput):
        LiveView(address, np.eye(4))


def test_a_port_that_is_taken_is_said(view):
    with pytest.raises(InvalidInput, match="cannot be listened at"):
        LiveView(f"127.0.0.1:{view.port}", np.eye(4))
