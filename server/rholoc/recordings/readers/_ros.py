"""Cameras, transforms, times and poses from ROS 1 or 2 messages."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rholoc.geometry import Camera, FloatArray, Lens
from rholoc.recordings.readers._camera_models import unsupported
from rholoc.recordings.tables.pose_table import poses_from_rows
from rholoc.reports import RecordingWarning

_LENSES = {  # distortion model of a CameraInfo → lens and numbers of coefficients
    "": (Lens.PINHOLE, (0, 5)),
    "plumb_bob": (Lens.PINHOLE, (4, 5)),
    "rational_polynomial": (Lens.PINHOLE, (8,)),
    **dict.fromkeys(("equidistant", "fisheye", "kannala_brandt", "kannala_brandt4"), (Lens.FISHEYE, (4,))),
}


def stamp_ns(message: Any, logged_ns: int) -> int:
    """A message's own stamp [ns], or its log time if it has none."""
    stamp = message.header.stamp
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec) or logged_ns


def vector(value: Any) -> tuple[float, float, float]:
    """x, y and z of a message's vector."""
    return value.x, value.y, value.z


def camera_of_info(
    info: Any, size: tuple[int, int], is_rectified: bool
) -> tuple[Camera | None, tuple[RecordingWarning, ...]]:
    """The camera of a CameraInfo message of ROS 1 or 2, fitted to ``size``, and warnings.

    None if it is not calibrated, or (with a warning) its lens is not known.

    Args:
        info: the message.
        size: of the pictures, width and height.
        is_rectified: whether the pictures are without distortion: then the projection matrix P holds.

    Raises:
        InvalidCamera: its values are impossible, or of another aspect ratio.
    """
    K, P, D = (np.asarray(getattr(info, name, getattr(info, name.upper(), ()))).ravel() for name in "kpd")
    if is_rectified:
        K, D = P.reshape(3, 4)[:, :3].ravel(), np.zeros(0)
    model = str(info.distortion_model)
    if len(K) != 9 or not K[0] > 0:
        return None, ()
    if not is_rectified and model not in _LENSES:
        return None, (unsupported(model[:40]),)
    lens, counts = (Lens.PINHOLE, (0,)) if is_rectified else _LENSES[model]
    count = next((count for count in reversed(counts) if count <= len(D)), 0)
    if D[count:].any():
        return None, (unsupported(f"{model[:40]} with {len(D)} coefficients"),)
    coefficients = tuple(D[:count].tolist()) if D[:count].any() else ()
    width, height = int(info.width) or size[0], int(info.height) or size[1]
    camera = Camera(width, height, float(K[0]), float(K[4]), float(K[2]), float(K[5]), coefficients, lens)
    region = info.roi
    if region.width and region.height and (region.width, region.height) != (width, height):
        camera = replace(
            camera,
            width=int(region.width),
            height=int(region.height),
            cx=camera.cx - float(region.x_offset),
            cy=camera.cy - float(region.y_offset),
        )
    return camera.fitted(*size), ()


@dataclass(frozen=True, eq=False)
class Mounting:
    """Tree of coordinate frames: child → parent and T_parent_child (4, 4)."""

    parents: dict[str, tuple[str, FloatArray]]

    @classmethod
    def of(cls, messages: Iterable[Any]) -> Mounting:
        """Tree of the static transforms in some messages. Raises InvalidTrajectory for an invalid one."""
        parents: dict[str, tuple[str, FloatArray]] = {}
        for one in (transform for message in messages for transform in message.transforms):
            child, parent = (str(name).lstrip("/") for name in (one.child_frame_id, one.header.frame_id))
            parents[child] = parent, _pose(one.transform.translation, one.transform.rotation, "tf_static")
        return cls(parents)

    def between(self, target: str, source: str) -> FloatArray | None:
        """T_target_source (4, 4); None if the frames are not connected."""
        if target.lstrip("/") == source.lstrip("/"):
            return np.eye(4)
        up_target, up_source = self._above(target.lstrip("/")), self._above(source.lstrip("/"))
        common = next((frame for frame in up_target if frame in up_source), None)
        return None if common is None else np.linalg.inv(up_target[common]) @ up_source[common]

    def _above(self, frame: str) -> dict[str, FloatArray]:
        """T_ancestor_frame (4, 4) by ancestor, the frame itself first."""
        T: FloatArray = np.eye(4)
        above = {frame: T}
        while frame in self.parents and self.parents[frame][0] not in above:
            frame, T_parent_child = self.parents[frame]
            T = T_parent_child @ T
            above[frame] = T
        return above


def pose_of(message: Any, topic: str) -> FloatArray:
    """Pose (4, 4) in a message with a transform or a pose. Raises InvalidTrajectory, naming ``topic``."""
    if hasattr(message, "transform"):
        return _pose(message.transform.translation, message.transform.rotation, topic)
    pose = message.pose.pose if hasattr(message.pose, "pose") else message.pose
    return _pose(pose.position, pose.orientation, topic)


def _pose(position: Any, q: Any, source: str) -> FloatArray:
    """Pose (4, 4) from a message's position and quaternion. Raises InvalidTrajectory, naming ``source``."""
    row = np.array([[position.x, position.y, position.z, q.x, q.y, q.z, q.w]], dtype=np.float64)
    return np.asarray(poses_from_rows(row, source)[0])
