"""A client of Foxglove's WebSocket protocol, which decodes messages by the schemas that it is told."""

import json
import struct
from contextlib import suppress

from mcap_ros2._dynamic import generate_dynamic
from websockets.sync.client import connect

from rholoc.tracking.pose_messages import PICTURE_TOPICS, TOPICS

MESSAGE, PATIENCE_S = 1, 20.0


class Foxglove:
    """What the application does: it learns the channels, subscribes to all of them, and decodes their messages."""

    def __init__(self, port):
        self._connection = connect(f"ws://127.0.0.1:{port}", subprotocols=["foxglove.sdk.v1"])
        self.channels = {}

    def __enter__(self):
        self._socket = self._connection.__enter__()
        while len(self.channels) < len(TOPICS) + len(PICTURE_TOPICS):
            said = json.loads(self._socket.recv(PATIENCE_S))
            if said["op"] == "advertise":
                self.channels |= {one["id"]: one for one in said["channels"]}
        wanted = [{"id": number, "channelId": number} for number in self.channels]
        self._socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
        return self

    def __exit__(self, *error):
        self._connection.__exit__(*error)

    def messages(self, patience_s):
        """Topic and content of the messages that come, until none comes for a while."""
        with suppress(TimeoutError):
            while True:
                said = self._socket.recv(patience_s)
                if isinstance(said, bytes) and said[0] == MESSAGE:
                    number, _ = struct.unpack_from("<IQ", said, 1)
                    channel = self.channels[number]
                    decode = generate_dynamic(channel["schemaName"], channel["schema"])[channel["schemaName"]]
                    yield channel["topic"], decode(said[13:])
