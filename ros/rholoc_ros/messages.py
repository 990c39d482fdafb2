"""Fields of ROS messages ↔ transforms (4, 4). The messages are made by the caller, so nothing of ROS is imported."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np

from rholoc_client.tracking.rigid import FloatArray, from_quaternion, quaternion_of
from rholoc_ros.robot import Diagnosis, Estimate

_Message = TypeVar("_Message")
_S_NS = 1_000_000_000
HARDWARE = "rholoc"


def stamp_ns(stamp: Any) -> int:
    """A ``builtin_interfaces/Time`` in nanoseconds."""
    return int(stamp.sec) * _S_NS + int(stamp.nanosec)


def set_stamp(stamp: Any, nanoseconds: int) -> None:
    """Set a ``builtin_interfaces/Time``."""
    stamp.sec, stamp.nanosec = divmod(nanoseconds, _S_NS)


def vector_of(vector: Any) -> FloatArray:
    """A ``geometry_msgs/Vector3`` or ``Point`` as (3,)."""
    return np.array([vector.x, vector.y, vector.z])


def pose_of(pose: Any) -> FloatArray:
    """A ``geometry_msgs/Pose`` as (4, 4). Raises ValueError: not finite, or a quaternion of 0."""
    q = pose.orientation
    return from_quaternion(vector_of(pose.position).tolist(), (q.x, q.y, q.z, q.w))


def transform_of(transform: Any) -> FloatArray:
    """A ``geometry_msgs/Transform`` as (4, 4): T_frame_child. Raises ValueError as :func:`pose_of`."""
    q = transform.rotation
    return from_quaternion(vector_of(transform.translation).tolist(), (q.x, q.y, q.z, q.w))


def filled_pose(message: _Message, estimate: Estimate, map_frame: str) -> _Message:
    """A ``PoseWithCovarianceStamped``, filled."""
    target: Any = message
    set_stamp(target.header.stamp, estimate.stamp_ns)
    target.header.frame_id = map_frame
    _set(target.pose.pose.position, target.pose.pose.orientation, estimate.T_map_base)
    target.pose.covariance = estimate.covariance.ravel().tolist()
    return message


def filled_transform(
    message: _Message, T_frame_child: FloatArray, frame: str, child: str, nanoseconds: int
) -> _Message:
    """A ``TransformStamped``, filled."""
    target: Any = message
    set_stamp(target.header.stamp, nanoseconds)
    target.header.frame_id, target.child_frame_id = frame, child
    _set(target.transform.translation, target.transform.rotation, T_frame_child)
    return message


def filled_status(message: _Message, diagnosis: Diagnosis, key_value: Any) -> _Message:
    """A ``DiagnosticStatus``, filled; ``key_value`` is the class ``KeyValue``."""
    target: Any = message
    target.level = bytes([diagnosis.level])
    target.name, target.hardware_id, target.message = "rholoc: localization", HARDWARE, diagnosis.message
    for key, value in diagnosis.values.items():
        entry = key_value()
        entry.key, entry.value = key, value
        target.values.append(entry)
    return message


def _set(vector: Any, quaternion: Any, T: FloatArray) -> None:
    vector.x, vector.y, vector.z = T[:3, 3].tolist()
    quaternion.x, quaternion.y, quaternion.z, quaternion.w = quaternion_of(T[:3, :3])
