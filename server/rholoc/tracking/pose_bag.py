"""Poses as a bag of ROS 2: an ``.mcap`` that Foxglove and ``ros2 bag`` open.

::

    visual_localization/pose        PoseWithCovarianceStamped: base_link in map
    visual_localization/recognized  Float64: probability 0 to 1 that an answer is of the right place
    visual_localization/confidence  Float64: probability 0 to 1 that it is within 10 cm and 5° of the truth
    visual_localization/status      String: searching, tracking, lost
    tf                              map → odom → base_link; map → base_link where nothing measures motion
    tf_static                       base_link → camera_optical_frame

Frames are those of REP 103 and REP 105: base_link has x forward, y left and z up.
"""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np

from rholoc.disk import reporting_full_disk, temporary_folder
from rholoc.geometry import FloatArray, rows_from_poses
from rholoc_client.tracking.rigid import carried, inverse

if TYPE_CHECKING:
    from rosbags.rosbag2 import Writer

MAP, ODOM, BASE, OPTICAL = "map", "odom", "base_link", "camera_optical_frame"
_S_NS = 1_000_000_000
_TOPICS = {
    "/visual_localization/pose": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "/visual_localization/recognized": "std_msgs/msg/Float64",
    "/visual_localization/confidence": "std_msgs/msg/Float64",
    "/visual_localization/status": "std_msgs/msg/String",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/tf_static": "tf2_msgs/msg/TFMessage",
}


class PoseBag:
    """A bag that is being written; the file appears when the block ends, unless it fails before the first message.

    Args:
        path: of the ``.mcap`` file; an existing one is replaced.
        T_base_camera: (4, 4) the camera's mounting on the robot.
    """

    def __init__(self, path: Path, T_base_camera: FloatArray) -> None:
        self._path, self._T_base_camera = path, T_base_camera
        self._stack = ExitStack()
        self._is_begun = self._has_messages = False

    def __enter__(self) -> PoseBag:
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore

        self._store = get_typestore(Stores.ROS2_JAZZY)
        folder = self._stack.enter_context(temporary_folder(self._path.parent))
        self._bag = folder / self._path.stem
        self._writer: Writer = Writer(self._bag, version=9, storage_plugin=StoragePlugin.MCAP)
        self._writer.open()
        self._connections = {
            topic: self._writer.add_connection(
                topic, kind, typestore=self._store, offered_qos_profiles=[_latched()] if topic == "/tf_static" else []
            )
            for topic, kind in _TOPICS.items()
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
            written.replace(self._path)

    def pose(
        self,
        time_s: float,
        T_map_camera: FloatArray,
        covariance: FloatArray | None,
        T_map_odom: FloatArray | None = None,
    ) -> None:
        """Write a pose and its transforms.

        Args:
            time_s: of the frame.
            T_map_camera: (4, 4).
            covariance: (6, 6) of the camera's position [m] and rotation [rad], map frame; None if unknown.
            T_map_odom: (4, 4) if there is odometry.
        """
        T_map_base = T_map_camera @ inverse(self._T_base_camera)
        known = np.zeros((6, 6)) if covariance is None else covariance
        values = np.asarray(carried(known, T_map_base[:3, 3] - T_map_camera[:3, 3]), dtype=np.float64)
        pose = self._make("PoseWithCovariance", pose=self._pose(T_map_base), covariance=values.ravel())
        self._write(
            "/visual_localization/pose",
            time_s,
            self._make("PoseWithCovarianceStamped", header=self._header(time_s, MAP), pose=pose),
        )
        if T_map_odom is None:
            self._transforms("/tf", time_s, (MAP, BASE, T_map_base))
        else:
            T_odom_base = inverse(T_map_odom) @ T_map_base
            self._transforms("/tf", time_s, (MAP, ODOM, T_map_odom), (ODOM, BASE, T_odom_base))
        if not self._is_begun:
            self._transforms("/tf_static", time_s, (BASE, OPTICAL, self._T_base_camera))
            self._is_begun = True

    def belief(self, time_s: float, recognized: float, confidence: float) -> None:
        """Write the probabilities of an answer, see :class:`rholoc.localization.Belief`."""
        for name, value in (("recognized", recognized), ("confidence", confidence)):
            self._write(f"/visual_localization/{name}", time_s, self._store.types["std_msgs/msg/Float64"](data=value))

    def status(self, time_s: float, status: str) -> None:
        """Write the state of a track."""
        self._write("/visual_localization/status", time_s, self._store.types["std_msgs/msg/String"](data=status))

    def _write(self, topic: str, time_s: float, message: Any) -> None:
        data = self._store.serialize_cdr(message, _TOPICS[topic])
        with reporting_full_disk():
            self._writer.write(self._connections[topic], round(time_s * _S_NS), bytes(data))
        self._has_messages = True

    def _transforms(self, topic: str, time_s: float, *transforms: tuple[str, str, FloatArray]) -> None:
        messages = []
        for frame, child, T_frame_child in transforms:
            pose = self._pose(T_frame_child)
            p = pose.position
            translation = self._make("Vector3", x=p.x, y=p.y, z=p.z)
            transform = self._make("Transform", translation=translation, rotation=pose.orientation)
            header = self._header(time_s, frame)
            messages.append(self._make("TransformStamped", header=header, child_frame_id=child, transform=transform))
        self._write(topic, time_s, self._store.types["tf2_msgs/msg/TFMessage"](transforms=messages))

    def _pose(self, T: FloatArray) -> Any:
        ((px, py, pz, x, y, z, w),) = rows_from_poses(T[None]).tolist()
        position, orientation = self._make("Point", x=px, y=py, z=pz), self._make("Quaternion", x=x, y=y, z=z, w=w)
        return self._make("Pose", position=position, orientation=orientation)

    def _header(self, time_s: float, frame: str) -> Any:
        seconds, rest = divmod(round(time_s * _S_NS), _S_NS)
        stamp = self._store.types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=rest)
        return self._store.types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)

    def _make(self, kind: str, **fields: Any) -> Any:
        return self._store.types[f"geometry_msgs/msg/{kind}"](**fields)


def _latched() -> Any:
    """The quality of service of ``tf_static``: late subscribers get the last message too."""
    from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

    never = QosTime(2_147_483_647, 4_294_967_295)
    return Qos(
        QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL, never, never,
        QosLiveliness.SYSTEM_DEFAULT, never, False,
    )  # fmt: skip
