"""A track as MQTT messages: JSON with the position fields of VDA 5050."""

from __future__ import annotations

import json
import math
import os
import re
import threading
from contextlib import suppress
from datetime import UTC, datetime
from types import TracebackType
from typing import Any
from urllib.parse import unquote, urlsplit

import numpy as np

from rholoc.errors import InvalidInput, NotInstalled
from rholoc.geometry import FloatArray
from rholoc.tracking.follow import Step
from rholoc_client.tracking import Tracked, TrackStatus
from rholoc_client.tracking.rigid import inverse, quaternion_of

PASSWORD_VARIABLE = "RHOLOC_MQTT_PASSWORD"
_INTERVAL_S = 0.1  # VDA 5050 asks for its visualization at most this often
_PATIENCE_S = 5.0
_WILDCARDS = re.compile("[+#]")
_PORTS = {"mqtt": 1883, "mqtts": 8883}
_HINT = "Give --mqtt mqtt://USER@HOST:PORT/TOPIC, or mqtts:// for TLS."


class MqttSender:
    """Publishes a track's poses, at most ten a second. Its MQTT last will reports that it is offline.

    Args:
        url: ``mqtt://user:password@host:port/topic``, or ``mqtts://``; the topic is ``rholoc/MAP`` by default.
        map_name: the map, VDA 5050's ``mapId``.
        T_base_camera: (4, 4) the camera's mounting; base has x forward, y left, z up.

    Raises:
        NotInstalled: paho-mqtt is missing.
        InvalidInput: the URL is malformed, or the broker does not answer or refuses.
    """

    def __init__(self, url: str, map_name: str, T_base_camera: FloatArray) -> None:
        try:
            from paho.mqtt.client import Client
            from paho.mqtt.enums import CallbackAPIVersion
        except ImportError as error:
            raise NotInstalled("MQTT needs paho-mqtt.", "pip install 'rholoc[mqtt]'.") from error
        try:
            parts = urlsplit(url)
            port = parts.port
        except ValueError as error:
            raise InvalidInput("That is not the address of an MQTT broker.", _HINT) from error
        if parts.scheme not in _PORTS or not parts.hostname:
            raise InvalidInput("That is not the address of an MQTT broker.", _HINT)
        self._topic = unquote(parts.path).strip("/") or f"rholoc/{_WILDCARDS.sub('-', map_name)}"
        if _WILDCARDS.search(self._topic):
            raise InvalidInput("An MQTT topic to publish to has no + or #.", _HINT)
        self._map_name, self._T_camera_base = map_name, inverse(T_base_camera)
        self._score, self._count, self._last_s = 0.0, 0, -math.inf
        self._host, self._port = parts.hostname, port or _PORTS[parts.scheme]
        self._client = Client(CallbackAPIVersion.VERSION2)
        if parts.username:
            password = unquote(parts.password) if parts.password else os.environ.get(PASSWORD_VARIABLE)
            self._client.username_pw_set(unquote(parts.username), password)
        if parts.scheme == "mqtts":
            self._client.tls_set()
        self._client.will_set(self._topic, json.dumps({"status": "offline"}))
        self._answered = threading.Event()
        self._refusal = ""
        self._client.on_connect = self._connected

    def __enter__(self) -> MqttSender:
        where = f"The MQTT broker {self._host}:{self._port}"
        try:
            self._client.connect(self._host, self._port)
        except (OSError, ValueError) as error:
            raise InvalidInput(f"{where} does not answer.", "Check its address.") from error
        self._client.loop_start()  # connects again where the connection breaks
        if not self._answered.wait(_PATIENCE_S) or self._refusal:
            self._client.loop_stop()
            why = f"refuses: {self._refusal}" if self._refusal else "does not answer"
            raise InvalidInput(f"{where} {why}.", f"Check its address, the user, and {PASSWORD_VARIABLE}.")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with suppress(RuntimeError, ValueError):  # the broker is gone, or its queue is full: it sends the will instead
            self._client.publish(self._topic, json.dumps({"status": "offline"})).wait_for_publish(_PATIENCE_S)
        self._client.disconnect()
        self._client.loop_stop()

    def take(self, step: Step) -> None:
        """Publish the step unless the last published frame is less than 0.1 s older; a pose only while tracking."""
        if step.answer is not None and step.answer.localization is not None:
            self._score = step.answer.localization.recognized
        if step.moment.time_s - self._last_s >= _INTERVAL_S:
            self._last_s = step.moment.time_s
            self._client.publish(self._topic, json.dumps(self._message(step)))

    def _message(self, step: Step) -> dict[str, Any]:
        """Message of a step, for JSON; takes the next ``headerId``."""
        tracked = step.tracked
        timestamp = datetime.fromtimestamp(step.moment.time_s, UTC).isoformat(timespec="milliseconds")
        message: dict[str, Any] = {
            "headerId": self._count,
            "timestamp": timestamp.replace("+00:00", "Z"),
            "status": tracked.status.value,
            "resetCounter": tracked.reset_counter,
        }
        self._count += 1
        if tracked.status is TrackStatus.TRACKING and tracked.pose is not None:
            message |= self._placed(tracked, step.sigma_m)
        return message

    def _placed(self, tracked: Tracked, sigma_m: float) -> dict[str, Any]:
        """The pose of the robot's base as fields of VDA 5050, and as position and quaternion."""
        assert tracked.pose is not None
        T = np.array(tracked.pose.T_map_camera) @ self._T_camera_base
        x, y, z = T[:3, 3].tolist()
        return {
            "agvPosition": {
                "x": x,
                "y": y,
                "theta": math.atan2(float(T[1, 0]), float(T[0, 0])),
                "mapId": self._map_name,
                "positionInitialized": True,
                "localizationScore": self._score,
                "deviationRange": sigma_m,
            },
            "pose": {"position": [x, y, z], "quaternion_xyzw": list(quaternion_of(T[:3, :3]))},
        }

    def _connected(self, _client: Any, _data: Any, _flags: Any, reason: Any, _properties: Any) -> None:
        """Note the broker's answer, a refusal with its reason (paho's ``on_connect``)."""
        self._refusal = str(reason) if reason.is_failure else ""
        self._answered.set()
