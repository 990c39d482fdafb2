"""A track as a bag of ROS 2: an ``.mcap`` that Foxglove and ``ros2 bag`` open."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

from rholoc.disk import reporting_full_disk, temporary_folder
from rholoc.geometry import FloatArray
from rholoc.tracking.pose_messages import LATCHED, TOPICS, PoseMessages

if TYPE_CHECKING:
    from rosbags.rosbag2 import Writer


class PoseBag(PoseMessages):
    """A bag that is being written; the file appears when the block ends, unless it fails before the first message.

    Args:
        path: of the ``.mcap`` file; an existing one is replaced.
        T_base_camera: (4, 4) the camera's mounting on the robot.
    """

    def __init__(self, path: Path, T_base_camera: FloatArray) -> None:
        super().__init__(T_base_camera)
        self._target = path
        self._stack = ExitStack()
        self._has_messages = False

    def __enter__(self) -> PoseBag:
        from rosbags.rosbag2 import StoragePlugin, Writer

        folder = self._stack.enter_context(temporary_folder(self._target.parent))
        self._bag = folder / self._target.stem
        self._writer: Writer = Writer(self._bag, version=9, storage_plugin=StoragePlugin.MCAP)
        self._writer.open()
        self._connections = {
            topic: self._writer.add_connection(
                topic, kind, typestore=self._store, offered_qos_profiles=[_latched()] if topic in LATCHED else []
            )
            for topic, kind in TOPICS.items()
        }
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._stack, reporting_full_disk():
            self._writer.close()
            if error is not None and not self._has_messages:
                return  # what failed before it began replaces nothing
            (written,) = self._bag.glob("*.mcap")
            written.replace(self._target)

    def _send(self, topic: str, stamp_ns: int, message: bytes) -> None:
        with reporting_full_disk():
            self._writer.write(self._connections[topic], stamp_ns, message)
        self._has_messages = True


def _latched() -> Any:
    """Quality of service of ``LATCHED`` topics: late subscribers get the last message too."""
    from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

    never = QosTime(2_147_483_647, 4_294_967_295)
    return Qos(
        QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL, never, never,
        QosLiveliness.SYSTEM_DEFAULT, never, False,
    )  # fmt: skip
