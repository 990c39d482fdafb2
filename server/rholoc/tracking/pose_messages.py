"""A track as messages of ROS 2, for a bag and for Foxglove.

::

    visual_localization/pose         PoseWithCovarianceStamped: base_link in map
    visual_localization/path         Path: where it was, a pose each second
    visual_localization/uncertainty  Marker: ellipsoid that holds the position with 95 %
    visual_localization/recognized   Float64: probability 0 to 1 that an answer is of the right place
    visual_localization/confidence   Float64: probability 0 to 1 that it is within 10 cm and 5° of the truth
    visual_localization/status       String: searching, tracking, lost
    tf                               map → odom → base_link; map → base_link where nothing measures motion
    tf_static                        base_link → camera_optical_frame
    map/points                       PointCloud2: landmarks of the map
    camera/image/compressed          CompressedImage: small, five a second; live only
    camera/camera_info               CameraInfo: of those pictures

Frames are those of REP 103 and REP 105: base_link has x forward, y left and z up.
"""

from abc import ABC, abstractmethod
from collections import deque
from typing import Any

import cv2
import numpy as np

from rholoc.geometry import ByteArray, Camera, FloatArray, Lens, rows_from_poses
from rholoc_client.tracking.rigid import carried, inverse

MAP, ODOM, BASE, OPTICAL = "map", "odom", "base_link", "camera_optical_frame"
TOPICS = {
    "/visual_localization/pose": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "/visual_localization/path": "nav_msgs/msg/Path",
    "/visual_localization/uncertainty": "visualization_msgs/msg/Marker",
    "/visual_localization/recognized": "std_msgs/msg/Float64",
    "/visual_localization/confidence": "std_msgs/msg/Float64",
    "/visual_localization/status": "std_msgs/msg/String",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/map/points": "sensor_msgs/msg/PointCloud2",
}
PICTURE_TOPICS = {
    "/camera/image/compressed": "sensor_msgs/msg/CompressedImage",
    "/camera/camera_info": "sensor_msgs/msg/CameraInfo",
}
LATCHED = ("/tf_static", "/map/points")
"""Topics of which who comes late needs the last message."""

_S_NS = 1_000_000_000
_PATH_S, _PATH_POSES, _PATH_SHARE = 1.0, 600, 60.0  # between poses; most of them; seconds of path for one between paths
_PICTURE_S, _PICTURE_PX, _JPEG_QUALITY = 0.2, 480, 70
_MAX_POINTS = 100_000
_REGION_SIGMAS = 2.796  # √χ² of 95 % with three degrees of freedom
_MIN_DIAMETER_M = 0.002
_SPHERE, _FLOAT32 = 2, 7  # of Marker and of PointField


class PoseMessages(ABC):
    """Writer of a track's messages.

    Args:
        T_base_camera: (4, 4) the camera's mounting on the robot.
    """

    def __init__(self, T_base_camera: FloatArray) -> None:
        from rosbags.typesys import Stores, get_typestore

        self._T_base_camera = T_base_camera
        self._store = get_typestore(Stores.ROS2_JAZZY)
        self._is_begun = False
        self._path: deque[Any] = deque(maxlen=_PATH_POSES)
        self._next_path_s = self._next_pose_s = self._next_picture_s = -np.inf

    @abstractmethod
    def _send(self, topic: str, stamp_ns: int, message: bytes) -> None:
        """Send a serialized message (CDR) of a topic."""

    def pose(
        self,
        time_s: float,
        T_map_camera: FloatArray,
        covariance: FloatArray | None,
        T_map_odom: FloatArray | None = None,
    ) -> None:
        """Write the robot's pose, 95 % ellipsoid, path and transforms; the first call also the camera's mounting.

        Args:
            time_s: of the frame.
            T_map_camera: (4, 4).
            covariance: (6, 6) of the camera's position [m] and rotation [rad], map frame; None if unknown (written as
                0).
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
        self._uncertainty(time_s, T_map_base[:3, 3], values[:3, :3])
        self._path_to(time_s, T_map_base)
        if T_map_odom is None:
            self._transforms("/tf", time_s, (MAP, BASE, T_map_base))
        else:
            T_odom_base = inverse(T_map_odom) @ T_map_base
            self._transforms("/tf", time_s, (MAP, ODOM, T_map_odom), (ODOM, BASE, T_odom_base))
        if not self._is_begun:
            self._transforms("/tf_static", time_s, (BASE, OPTICAL, self._T_base_camera))
            self._is_begun = True

    def camera(self, time_s: float, name: str, T_map_camera: FloatArray) -> None:
        """Write the transform from the map to the frame ``name`` of one of several cameras; ``T_map_camera`` (4, 4)."""
        self._transforms("/tf", time_s, (MAP, name, T_map_camera))

    def belief(self, time_s: float, recognized: float, confidence: float) -> None:
        """Write the probabilities of an answer, see :class:`rholoc.localization.Belief`."""
        for name, value in (("recognized", recognized), ("confidence", confidence)):
            self._write(f"/visual_localization/{name}", time_s, self._store.types["std_msgs/msg/Float64"](data=value))

    def status(self, time_s: float, status: str) -> None:
        """Write the state of a track at a time [s] as a string message."""
        self._write("/visual_localization/status", time_s, self._store.types["std_msgs/msg/String"](data=status))

    def room(self, time_s: float, positions: FloatArray, colours: ByteArray) -> None:
        """Write points (N, 3) of the map [m] with colours (N, 3) red, green, blue; evenly thinned to 100,000."""
        chosen = slice(None, None, 1 + len(positions) // _MAX_POINTS)
        points = np.zeros(len(positions[chosen]), dtype=[("xyz", "<f4", 3), ("bgra", "u1", 4)])
        points["xyz"], points["bgra"][:, :3] = positions[chosen], colours[chosen][:, ::-1]
        points["bgra"][:, 3] = 255
        fields = [
            self._make("PointField", "sensor_msgs", name=name, offset=4 * i, datatype=_FLOAT32, count=1)
            for i, name in enumerate(("x", "y", "z", "rgba"))
        ]
        data = points.view(np.uint8).ravel()
        cloud = self._make(
            "PointCloud2", "sensor_msgs", header=self._header(time_s, MAP), height=1, width=len(points), fields=fields,
            is_bigendian=False, point_step=16, row_step=len(data), data=data, is_dense=True,
        )  # fmt: skip
        self._write("/map/points", time_s, cloud)

    def picture(self, time_s: float, image: ByteArray, camera: Camera) -> None:
        """Write a picture (H, W, 3) BGR or (H, W), at most 480 px wide or high, and its intrinsics; five a second at
        most.
        """
        if time_s < self._next_picture_s:
            return
        self._next_picture_s = time_s + _PICTURE_S
        height, width = image.shape[:2]
        share = min(1.0, _PICTURE_PX / max(height, width))
        small = cv2.resize(image, None, fx=share, fy=share, interpolation=cv2.INTER_AREA)
        jpeg = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1]
        header = self._header(time_s, OPTICAL)
        sent = self._make("CompressedImage", "sensor_msgs", header=header, format="jpeg", data=jpeg.ravel())
        self._write("/camera/image/compressed", time_s, sent)
        if camera.lens is Lens.EQUIRECTANGULAR:  # which the message has no model for
            return
        self._write("/camera/camera_info", time_s, self._camera_info(header, camera, share, small.shape[1::-1]))

    def _camera_info(self, header: Any, camera: Camera, share: float, size: tuple[int, int]) -> Any:
        """CameraInfo of pictures of ``camera`` that are shrunk by the factor ``share`` to ``size`` (width, height)."""
        fx, fy = share * camera.fx, share * camera.fy
        cx, cy = (share * (value + 0.5) - 0.5 for value in (camera.cx, camera.cy))
        model, count = _lens_model(camera)
        d = (*camera.distortion, *[0.0] * count)[:count]
        no_region = self._make(
            "RegionOfInterest", "sensor_msgs", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
        )
        return self._make(
            "CameraInfo", "sensor_msgs", header=header, width=size[0], height=size[1],
            distortion_model=model,
            d=np.array(d), k=np.array([fx, 0, cx, 0, fy, cy, 0, 0, 1.0]), r=np.eye(3).ravel(),
            p=np.array([fx, 0, cx, 0, 0, fy, cy, 0, 0, 0, 1.0, 0]), binning_x=0, binning_y=0, roi=no_region,
        )  # fmt: skip

    def _uncertainty(self, time_s: float, position: FloatArray, covariance: FloatArray) -> None:
        """Write the 95 % confidence ellipsoid of a position (3,) [m] with a covariance (3, 3) [m²] as a Marker."""
        variances, axes = np.linalg.eigh(covariance)
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = axes * np.sign(np.linalg.det(axes)), position
        x, y, z = np.maximum(2 * _REGION_SIGMAS * np.sqrt(np.maximum(variances, 0.0)), _MIN_DIAMETER_M).tolist()
        no_time = self._store.types["builtin_interfaces/msg/Duration"](sec=0, nanosec=0)
        green = self._make("ColorRGBA", "std_msgs", r=0.1, g=0.7, b=0.3, a=0.4)
        no_file = self._make("MeshFile", "visualization_msgs", filename="", data=np.zeros(0, np.uint8))
        no_texture = self._make(
            "CompressedImage", "sensor_msgs", header=self._header(0.0, ""), format="", data=np.zeros(0, np.uint8)
        )
        marker = self._make(
            "Marker", "visualization_msgs", header=self._header(time_s, MAP), ns="uncertainty", id=0, type=_SPHERE,
            action=0, pose=self._pose(T), scale=self._make("Vector3", x=x, y=y, z=z), color=green, lifetime=no_time,
            frame_locked=False, points=[], colors=[], texture_resource="", texture=no_texture, uv_coordinates=[],
            text="", mesh_resource="", mesh_file=no_file, mesh_use_embedded_materials=False,
        )  # fmt: skip
        self._write("/visual_localization/uncertainty", time_s, marker)

    def _path_to(self, time_s: float, T_map_base: FloatArray) -> None:
        """Add a pose to the path, at most one a second (the last 600 stay), and write the path from time to time.

        A path of n poses is written every n / 60 s, at most once a second.
        """
        if time_s >= self._next_pose_s:
            self._next_pose_s = time_s + _PATH_S
            self._path.append(self._make("PoseStamped", header=self._header(time_s, MAP), pose=self._pose(T_map_base)))
        if time_s >= self._next_path_s:
            self._next_path_s = time_s + max(_PATH_S, len(self._path) / _PATH_SHARE)
            path = self._make("Path", "nav_msgs", header=self._header(time_s, MAP), poses=list(self._path))
            self._write("/visual_localization/path", time_s, path)

    def _write(self, topic: str, time_s: float, message: Any) -> None:
        """Serialize a message of a topic, and send it with the time ``time_s``."""
        data = self._store.serialize_cdr(message, {**TOPICS, **PICTURE_TOPICS}[topic])
        self._send(topic, round(time_s * _S_NS), bytes(data))

    def _transforms(self, topic: str, time_s: float, *transforms: tuple[str, str, FloatArray]) -> None:
        """Write one message of transforms, each of frame, child and T_frame_child (4, 4)."""
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
        """Message ``Pose`` of T (4, 4)."""
        ((px, py, pz, x, y, z, w),) = rows_from_poses(T[None]).tolist()
        position, orientation = self._make("Point", x=px, y=py, z=pz), self._make("Quaternion", x=x, y=y, z=z, w=w)
        return self._make("Pose", position=position, orientation=orientation)

    def _header(self, time_s: float, frame: str) -> Any:
        """Message ``Header`` of a time [s] and a coordinate frame."""
        seconds, rest = divmod(round(time_s * _S_NS), _S_NS)
        stamp = self._store.types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=rest)
        return self._store.types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)

    def _make(self, kind: str, package: str = "geometry_msgs", **fields: Any) -> Any:
        """Message of the type ``package/msg/kind`` with these fields."""
        return self._store.types[f"{package}/msg/{kind}"](**fields)


def _lens_model(camera: Camera) -> tuple[str, int]:
    """Name of the distortion model in CameraInfo, and its number of coefficients."""
    if camera.lens is Lens.FISHEYE:
        return "equidistant", 4
    return ("rational_polynomial", 8) if len(camera.distortion) == 8 else ("plumb_bob", 5)
