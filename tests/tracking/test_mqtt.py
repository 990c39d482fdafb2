"""Poses by MQTT, through mosquitto: VDA 5050's fields, nothing while lost, and a last will."""

import getpass
import json
import os
import queue
import shutil
import socket
import subprocess

import numpy as np
import pytest
from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion
from scipy.spatial.transform import Rotation

from rholoc.errors import InvalidInput
from rholoc.geometry import R_FORWARD_OPTICAL, pose_matrix
from rholoc.tracking.mqtt import PASSWORD_VARIABLE, MqttSender

FORWARD = pose_matrix(R_FORWARD_OPTICAL, np.zeros(3))
USER, SECRET = "robot", "s3cret"


def program(name: str) -> str:
    """Where a program of mosquitto is; Debian keeps the broker off users' paths."""
    found = shutil.which(name, path=f"{os.environ['PATH']}:/usr/sbin")
    return found or pytest.skip("mosquitto is not installed")


@pytest.fixture(scope="module")
def broker(tmp_path_factory):
    """A mosquitto of the tests' own that asks for a password; its port."""
    folder = tmp_path_factory.mktemp("mosquitto")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    passwords = folder / "passwords"
    passwords.write_text(f"{USER}:{SECRET}\n")
    subprocess.run([program("mosquitto_passwd"), "-U", passwords], check=True, capture_output=True)
    settings = f"""
listener {port} 127.0.0.1
allow_anonymous false
password_file {passwords}
user {getpass.getuser()}
"""
    (folder / "mosquitto.conf").write_text(settings)
    running = subprocess.Popen([program("mosquitto"), "-c", folder / "mosquitto.conf"], stderr=subprocess.DEVNULL)
    while True:
        assert running.poll() is None, "mosquitto did not start"
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                break
    yield port
    running.terminate()
    running.wait(10)


@pytest.fixture
def heard(broker):
    """What is published, in order."""
    messages: queue.Queue = queue.Queue()
    subscribed = queue.Queue()
    client = Client(CallbackAPIVersion.VERSION2)
    client.username_pw_set(USER, SECRET)
    client.on_message = lambda _client, _data, message: messages.put((message.topic, json.loads(message.payload)))
    client.on_subscribe = lambda *_: subscribed.put(True)
    client.connect("127.0.0.1", broker)
    client.subscribe("#")
    client.loop_start()
    assert subscribed.get(timeout=20)
    yield messages
    client.disconnect()
    client.loop_stop()


def test_a_pose_has_the_fields_of_vda_5050(broker, heard, step):
    T = pose_matrix(Rotation.from_euler("z", 120, degrees=True).as_matrix(), np.array([2.0, 3.0, 0.5])) @ FORWARD
    with MqttSender(f"mqtt://{USER}:{SECRET}@127.0.0.1:{broker}", "room", FORWARD) as sender:
        sender.take(step(1_700_000_000.25))
        sender.take(step(1_700_000_000.26, T))  # too soon
        sender.take(step(1_700_000_001.25, T, resets=2, recognized=0.75))
    topic, searching = heard.get(timeout=20)
    assert topic == "rholoc/room"
    assert searching == {
        "headerId": 0,
        "timestamp": "2023-11-14T22:13:20.250Z",
        "status": "searching",
        "resetCounter": 0,
    }
    _, tracking = heard.get(timeout=20)
    position = tracking["agvPosition"]
    assert (position["x"], position["y"], position["theta"]) == pytest.approx((2.0, 3.0, np.radians(120)))
    assert (position["mapId"], position["positionInitialized"]) == ("room", True)
    assert position["localizationScore"] == 0.75
    assert position["deviationRange"] == pytest.approx(np.sqrt(6e-4))
    assert tracking["pose"]["position"] == pytest.approx([2.0, 3.0, 0.5])
    assert (tracking["headerId"], tracking["status"], tracking["resetCounter"]) == (1, "tracking", 2)
    assert heard.get(timeout=20) == ("rholoc/room", {"status": "offline"})
    assert heard.empty()


def test_the_topic_and_the_password_are_as_given(broker, heard, step, monkeypatch):
    monkeypatch.setenv(PASSWORD_VARIABLE, SECRET)
    with MqttSender(f"mqtt://{USER}@127.0.0.1:{broker}/plant/robot%201/pose", "room", FORWARD) as sender:
        sender.take(step(1.0))
    assert heard.get(timeout=20)[0] == "plant/robot 1/pose"


def test_a_wrong_password_is_said_without_it(broker):
    with (
        pytest.raises(InvalidInput, match="refuses: Not authorized") as refused,
        MqttSender(f"mqtt://{USER}:wrong1@127.0.0.1:{broker}", "room", FORWARD),
    ):
        pass
    assert "wrong1" not in str(refused.value)


@pytest.mark.parametrize(
    "url", ["", "broker", "http://broker", "mqtt://", "mqtt://host:port", "mqtt://127.0.0.1:99999"]
)
def test_what_is_no_broker_is_refused(url):
    with pytest.raises(InvalidInput, match="not the address"):
        MqttSender(url, "room", FORWARD)


def test_a_topic_is_no_pattern():
    with pytest.raises(InvalidInput, match=r"no \+ or #"):
        MqttSender("mqtt://127.0.0.1/plant/+/pose", "room", FORWARD)
    assert MqttSender("mqtt://127.0.0.1", "room+hall#2", FORWARD)._topic == "rholoc/room-hall-2"


def test_a_broker_that_is_gone_in_the_end_does_not_hide_the_tracks_result():
    MqttSender("mqtt://127.0.0.1:9", "room", FORWARD).__exit__(None, None, None)


def test_a_broker_that_does_not_answer_is_said():
    with pytest.raises(InvalidInput, match="does not answer"), MqttSender("mqtt://127.0.0.1:9", "room", FORWARD):
        pass
