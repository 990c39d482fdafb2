"""A robot that drives an arc, and a service that answers with the truth; poses by SciPy, not by the client's code."""

import struct
from typing import Any

import cv2
import numpy as np
from ros_messages import message_class
from scipy.spatial.transform import Rotation

from rholoc_client.models import Camera, parse_localization

SIGMA_M, SIGMA_DEG = 0.01, 0.3
CAMERA = Camera(52.0, 52.0, 31.5, 23.5, width=64, height=48)
ORIGIN_S = 1000.0
_T_MAP_ODOM = np.array([3.0, -2.0, 0.0, 0.7])


def transform(xyz: Any, rotation: Rotation) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation.as_matrix(), xyz
    return T


# Optical axes in the base's (REP 103): z forward is x, x right is −y, y down is −z; the camera looks up by 10°.
T_BASE_CAMERA = transform(
    [0.2, 0.05, 0.4],
    Rotation.from_euler("y", -10, degrees=True) * Rotation.from_matrix(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])),
)
T_MAP_ODOM = transform([*_T_MAP_ODOM[:3]], Rotation.from_rotvec([0, 0, _T_MAP_ODOM[3]]))


def T_odom_base(time_s: float) -> np.ndarray:
    """By odometry that drifts: 2 % of the way, sideways."""
    T = np.linalg.inv(T_MAP_ODOM) @ T_map_base(time_s)
    T[1, 3] += 0.02 * 0.5 * (time_s - ORIGIN_S)
    return T


def T_map_base(time_s: float) -> np.ndarray:
    """On an arc of 2 m at 0.5 m/s."""
    turn = 0.25 * (time_s - ORIGIN_S)
    return transform([2 * np.sin(turn), 2 - 2 * np.cos(turn), 0.0], Rotation.from_rotvec([0, 0, turn]))


def png(time_s: float, room: int = 0) -> bytes:
    """A picture that says when and in which room it was taken."""
    pixels = np.zeros((48, 64), np.uint8)
    pixels[0, :9] = np.frombuffer(struct.pack("<dB", time_s, room), np.uint8)
    return cv2.imencode(".png", pixels)[1].tobytes()


def read(picture: bytes) -> tuple[float, int]:
    pixels = cv2.imdecode(np.frombuffer(picture, np.uint8), cv2.IMREAD_GRAYSCALE)
    return struct.unpack("<dB", pixels[0, :9].tobytes())


def answer(picture: bytes) -> dict[str, Any]:
    """The service's answer in JSON: the truth, or no pose in another room."""
    time_s, room = read(picture)
    T = T_map_base(time_s) @ T_BASE_CAMERA
    pose = {
        "position": T[:3, 3].tolist(),
        "heading": T[:3, 2].tolist(),
        "roll_deg": 0.0,
        "quaternion_xyzw": Rotation.from_matrix(T[:3, :3]).as_quat().tolist(),
        "T_map_camera": T.tolist(),
    }
    found = room == 0
    return {
        "localized": found,
        "reason": None if found else "Too few matches agree.",
        "pose": pose if found else None,
        "covariance": np.diag([SIGMA_M**2] * 3 + [SIGMA_DEG**2] * 3).tolist() if found else None,
        "recognized": 0.97 if found else 0.0,
        "confidence": 0.9 if found else 0.0,
        **{"matches": 100, "inliers": 80, "map": "room", "map_id": "0", "map_version": 1, "scale": "metric"},
        **{"timings_ms": {}, "alternatives": []},
    }


class PlayedService:
    """The client, answered at once. ``priors`` are those of its requests; ``error`` is raised if it is set."""

    def __init__(self) -> None:
        self.priors: list[Any] = []
        self.error: Exception | None = None

    def localize(self, maps: str, image: bytes, *, prior: Any = None, **_: Any) -> Any:
        self.priors.append(prior)
        if self.error is not None:
            raise self.error
        return parse_localization(answer(image))

    def close(self) -> None:
        pass


def stamped(kind: str, time_s: float, frame_id: str, **fields: Any) -> Any:
    """A message with a header; fields by their path: pose__pose."""
    message = message_class(kind)()
    nanoseconds = round(time_s * 1e9)
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(nanoseconds, 10**9)
    message.header.frame_id = frame_id
    vars(message).update(fields)
    return message


def place(vector: Any, quaternion: Any, T: np.ndarray) -> None:
    vector.x, vector.y, vector.z = T[:3, 3].tolist()
    quaternion.x, quaternion.y, quaternion.z, quaternion.w = Rotation.from_matrix(T[:3, :3]).as_quat().tolist()


def tf(time_s: float, frame: str, child: str, T: np.ndarray) -> Any:
    message = message_class("tf2_msgs/msg/TFMessage")()
    one = stamped("geometry_msgs/msg/TransformStamped", time_s, frame, child_frame_id=child)
    place(one.transform.translation, one.transform.rotation, T)
    message.transforms.append(one)
    return message


def mounting() -> Any:
    return tf(0.0, "base_link", "camera", T_BASE_CAMERA)


def odometry(time_s: float) -> Any:
    return tf(time_s, "odom", "base_link", T_odom_base(time_s))


def picture(time_s: float, room: int = 0) -> Any:
    kind = "sensor_msgs/msg/CompressedImage"
    return stamped(kind, time_s, "camera", format="png", data=png(time_s, room))


def camera_info(time_s: float) -> Any:
    k = [CAMERA.fx, 0.0, CAMERA.cx, 0.0, CAMERA.fy, CAMERA.cy, 0.0, 0.0, 1.0]
    size = {"width": CAMERA.width, "height": CAMERA.height}
    return stamped(
        "sensor_msgs/msg/CameraInfo", time_s, "camera", k=k, distortion_model="plumb_bob", d=[0.0] * 5, **size
    )


def pose_matrix(pose: Any) -> np.ndarray:
    p, q = pose.position, pose.orientation
    return transform([p.x, p.y, p.z], Rotation.from_quat([q.x, q.y, q.z, q.w]))
