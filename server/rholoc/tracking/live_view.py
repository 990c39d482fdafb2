"""A track as it is followed, in Foxglove: a WebSocket server with the topics of a bag, and the camera's pictures."""

from __future__ import annotations

import threading
from collections.abc import Callable
from types import TracebackType
from typing import TYPE_CHECKING

from rholoc.errors import InvalidInput, NotInstalled
from rholoc.geometry import FloatArray
from rholoc.tracking.pose_messages import LATCHED, PICTURE_TOPICS, TOPICS, PoseMessages

if TYPE_CHECKING:
    from foxglove import Schema
    from foxglove.websocket import ChannelView, Client, ServerListener

_PORT = 8765  # where Foxglove looks by default


class LiveView(PoseMessages):
    """Server for Foxglove, which opens it as ``ws://HOST:PORT``.

    Args:
        address: ``HOST`` or ``HOST:PORT`` to listen at; port 0 takes a free one.
        T_base_camera: (4, 4) the camera's mounting on the robot.

    Raises:
        NotInstalled: foxglove-sdk is missing.
        InvalidInput: the address is malformed, or cannot be listened at.
    """

    def __init__(self, address: str, T_base_camera: FloatArray) -> None:
        super().__init__(T_base_camera)
        try:
            import foxglove
        except ImportError as error:
            raise NotInstalled("--view needs foxglove-sdk.", "pip install 'rholoc[view]'.") from error
        host, _, port = address.rpartition(":") if ":" in address else (address, "", str(_PORT))
        if not host or not port.isdecimal() or int(port) > 65535:
            raise InvalidInput(f"'{address[:60]}' is not HOST:PORT.", f"Give --view localhost:{_PORT}.")
        self._context = context = foxglove.Context()  # channels end with it
        self._channels = {
            topic: foxglove.Channel(topic, schema=self._schema(kind), message_encoding="cdr", context=context)
            for topic, kind in {**TOPICS, **PICTURE_TOPICS}.items()
        }
        self._topics = {channel.id(): topic for topic, channel in self._channels.items()}
        self._last: dict[str, tuple[int, bytes]] = {}
        self._lock = threading.Lock()
        try:
            self._server = foxglove.start_server(
                name="rholoc track", host=host, port=int(port), context=context, server_listener=_calling(self.repeat)
            )
        except RuntimeError as error:
            raise InvalidInput(f"{address} cannot be listened at: {error}.", "Choose another port.") from error

    @property
    def port(self) -> int:
        """Number of the port that the server listens at."""
        return self._server.port

    def __enter__(self) -> LiveView:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._server.stop()

    def repeat(self, channel_id: int) -> None:
        """Send the last message of a latched topic again, for a late subscriber; nothing for others. Thread-safe."""
        topic = self._topics.get(channel_id)
        with self._lock:
            last = None if topic is None else self._last.get(topic)
        if topic is not None and last is not None:
            self._channels[topic].log(last[1], log_time=last[0])

    def _send(self, topic: str, stamp_ns: int, message: bytes) -> None:
        """Send a message, and keep it if its topic is latched."""
        if topic in LATCHED:
            with self._lock:
                self._last[topic] = stamp_ns, message
        self._channels[topic].log(message, log_time=stamp_ns)

    def _schema(self, kind: str) -> Schema:
        """Foxglove's schema of a ROS 2 message type, such as ``nav_msgs/msg/Path``."""
        from foxglove import Schema

        text, _ = self._store.generate_msgdef(kind, ros_version=2)
        return Schema(name=kind, encoding="ros2msg", data=text.encode())


def _calling(subscribed: Callable[[int], None]) -> ServerListener:
    """Listener that calls ``subscribed`` with the channel's id at each subscription."""
    from foxglove.websocket import ServerListener

    class Listener(ServerListener):
        def on_subscribe(self, client: Client, channel: ChannelView) -> None:
            subscribed(channel.id)

    return Listener()
