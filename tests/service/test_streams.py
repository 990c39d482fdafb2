"""A stream of frames over a WebSocket: poses come back, bad input ends it with a clear error, and it has bounds."""

import json
from contextlib import contextmanager
from typing import Any

import httpx
import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from rholoc.service.access.keys import KeyStore, Scope
from rholoc.service.access.scopes import STREAM_KEY_PREFIX, STREAM_PROTOCOL

HERE = {"position": [0, 0, 0], "quaternion_xyzw": [0, 0, 0, 1]}
CAMERA = {"fx": 520, "fy": 520, "cx": 319.5, "cy": 239.5}


@contextmanager
def stream(service, name="room", **options):
    with connect(f"{service.url.replace('http', 'ws')}/v1/maps/{name}/track", open_timeout=30, **options) as socket:
        yield socket


def begun(socket: ClientConnection, **values: Any) -> dict[str, Any]:
    socket.send(json.dumps({"type": "begin", **values}))
    return heard(socket)


def heard(socket: ClientConnection) -> dict[str, Any]:
    return json.loads(socket.recv(timeout=30))


def frame(socket: ClientConnection, time_s: float, picture: bytes | None = None, **values: Any) -> dict[str, Any]:
    socket.send(json.dumps({"type": "frame", "time_s": time_s, "picture": picture is not None, **values}))
    if picture is not None:
        socket.send(picture)
    return heard(socket)


def test_odometry_is_placed_in_the_map_once_a_picture_was_answered(service, picture_world):
    with stream(service) as socket:
        start = begun(socket, camera=CAMERA)
        assert (start["type"], start["map"], start["scale"]) == ("begun", "room", "metric")
        first = frame(socket, 0.0, odometry=HERE)
        assert (first["status"], first["pose"], first["wants_picture"]) == ("searching", None, True)
        asked = frame(socket, 0.1, picture_world.png(), odometry=HERE)
        assert not asked["wants_picture"]
        answered = heard(socket)
        assert answered["answer"]["localized"]
        assert answered["answers"] == 1
        assert answered["status"] == "tracking"
        np.testing.assert_allclose(answered["pose"]["position"], picture_world.pose.position, atol=0.02)
        moved = frame(socket, 0.2, odometry={**HERE, "position": [0.1, 0, 0]})
        T = np.array(answered["pose"]["T_map_camera"])
        np.testing.assert_allclose(moved["pose"]["position"], T[:3, 3] + 0.1 * T[:3, 0], atol=0.02)
        np.testing.assert_allclose(moved["T_map_odom"], T, atol=0.02)
        assert np.array(moved["covariance"]).shape == np.array(moved["T_map_odom_covariance"]).shape == (6, 6)
        assert moved["reset_counter"] == 0


def test_pictures_alone_are_followed(service, picture_world):
    with stream(service) as socket:
        begun(socket, camera=CAMERA)
        time_s, said = 0.0, []
        while time_s < 60 and not (said and said[-1]["status"] == "tracking"):
            time_s += 0.1
            said.append(frame(socket, time_s, picture_world.png()))
        for _ in range(3):
            time_s += 0.1
            said.append(frame(socket, time_s, picture_world.png()))
        assert said[-1]["status"] == "tracking"
        assert said[-1]["T_map_odom"] is not None
        np.testing.assert_allclose(said[-1]["pose"]["position"], picture_world.pose.position, atol=0.02)


def test_imu_readings_come_with_frames(service, picture_world):
    with stream(service) as socket:
        begun(socket, camera=CAMERA)
        readings = [[i / 100, 0.0, -9.81, 0.0, 0.0, 0.0, 0.0] for i in range(5)]
        assert frame(socket, 0.1, imu=readings)["status"] == "searching"


BEGIN = '{"type": "begin"}'


def said(**values: Any) -> str:
    return json.dumps({"type": "frame", "time_s": 1, **values})


@pytest.mark.parametrize(
    ("messages", "code"),
    [
        (["not json"], "invalid_request"),
        ([said()], "invalid_request"),
        (['{"type": "begin", "odometry": {"drift": -1}}'], "invalid_request"),
        (['{"type": "begin", "camera": {"name": "nobodys"}}'], "unknown_camera"),
        (["[" * 40], "invalid_request"),
        (["x" * 70_000], "too_large"),
        ([BEGIN, b"\xff\xd8\xff"], "invalid_request"),
        ([BEGIN, said(picture=True), said(time_s=2)], "invalid_request"),
        ([BEGIN, said(picture=True), b"\xff\xd8"], "invalid_image"),
        (['{"type": "begin", "camera": {"fx": -1}}', said(picture=True), "THE PICTURE"], "invalid_camera"),
        ([BEGIN, said(), said()], "invalid_input"),
        ([BEGIN, said(), said(time_s=0.5)], "invalid_input"),
        ([BEGIN, said(time_s=float("nan"))], "invalid_request"),
        ([BEGIN, said(time_s="1")], "invalid_request"),
        ([BEGIN, said(odometry={**HERE, "quaternion_xyzw": [0, 0, 0, 0]})], "invalid_input"),
        ([BEGIN, said(odometry={**HERE, "position": [0, 0]})], "invalid_request"),
        ([BEGIN, said(imu=[[1, *[0.0] * 6], [0.5, *[0.0] * 6]])], "invalid_input"),
        ([BEGIN, said(imu=[[1, 2]])], "invalid_request"),
    ],
)
def test_what_cannot_be_used_ends_a_stream_with_its_error(service, picture_world, messages, code):
    with stream(service) as socket:
        for message in messages:
            socket.send(picture_world.png() if message == "THE PICTURE" else message)
        last = heard(socket)
        while last["type"] != "error":
            last = heard(socket)
        assert last["code"] == code, last
        assert last["message"]
        assert last["hint"]
        with pytest.raises(ConnectionClosed):
            socket.recv(timeout=30)
    assert httpx.get(service.url + "/healthz").status_code == 200


def test_an_unknown_map_is_said_over_the_stream(service):
    with stream(service, "attic") as socket:
        assert heard(socket)["code"] == "unknown_map"


def test_other_paths_take_no_stream(service):
    with pytest.raises(InvalidStatus) as refused, connect(service.url.replace("http", "ws") + "/v1/nowhere"):
        pass
    assert refused.value.response.status_code == 404
    assert json.loads(refused.value.response.body)["code"] == "unknown_route"


def test_a_page_of_another_site_opens_none(service):
    with pytest.raises(InvalidStatus) as refused, stream(service, origin="https://elsewhere.example"):
        pass
    assert refused.value.response.status_code == 403
    assert json.loads(refused.value.response.body)["code"] == "cross_site"


def test_a_message_too_long_ends_the_stream(service):
    with stream(service) as socket:
        begun(socket)
        with pytest.raises(ConnectionClosed):
            frame(socket, 0.0, bytes(9 * 2**20))
    assert httpx.get(service.url + "/healthz").status_code == 200


@pytest.fixture(scope="module")
def secret(locked):
    return KeyStore(locked.settings.data_dir).create("robot", Scope.LOCALIZE)


def test_a_stream_needs_a_key_that_may_localize(locked, secret):
    reader = KeyStore(locked.settings.data_dir).create("reader", Scope.READ)
    for key, status in ((None, 401), ("x", 401), (reader, 403)):
        headers = {} if key is None else {"Authorization": f"Bearer {key}"}
        with pytest.raises(InvalidStatus) as refused, stream(locked, additional_headers=headers):
            pass
        assert refused.value.response.status_code == status
    with stream(locked, additional_headers={"Authorization": f"Bearer {secret}"}) as socket:
        assert begun(socket)["type"] == "begun"


def test_a_browser_sends_its_key_as_a_subprotocol(locked, secret):
    offered = [STREAM_PROTOCOL, STREAM_KEY_PREFIX + secret]
    with stream(locked, subprotocols=offered) as socket:
        assert socket.subprotocol == STREAM_PROTOCOL
        assert begun(socket)["type"] == "begun"


def test_streams_are_limited_and_silent_ones_end(serve, picture_world):
    narrow = serve(max_streams=1, slow_client_timeout_s=4)
    (narrow.settings.maps_dir / "room.rho").write_bytes(picture_world.rho())
    with stream(narrow) as socket:
        begun(socket)
        with stream(narrow) as another:
            assert heard(another)["code"] == "busy"
        assert heard(socket)["code"] == "request_timeout"
    with stream(narrow) as socket:
        assert begun(socket)["type"] == "begun"
