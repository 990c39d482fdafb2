"""ROS bags: a ``.bag`` of ROS 1, an ``.mcap`` or ``.db3``, or the folder that ``ros2 bag record`` makes.

::

    walk.bag | walk.mcap | walk.db3      or a folder with metadata.yaml and one of the latter
    camera.json                          intrinsics, where the bag has no camera_info; beside the bag
    sensors.txt                          the same as kapture writes them: its cameras in the order of the topics' names

Topics are found by their types: pictures (Image, CompressedImage), CameraInfo, Imu (also one topic each for gyroscope
and accelerometer), Odometry, poses (PoseStamped, PoseWithCovarianceStamped, TransformStamped) and ``tf_static``. Of
several of a kind, the one with most messages is used unless another is named. Times are those of the headers. Poses
are transformed to the camera by tf. If tf does not connect their frame with the camera's, they count as the camera's
own, with x forward and z up unless the frame's name ends in ``optical_frame`` (REP 103); the check against the
pictures shows whether that holds.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rholoc.errors import InvalidRecording, InvalidTrajectory
from rholoc.geometry import R_FORWARD_OPTICAL, Camera, pose_matrix
from rholoc.recordings.frames.bag import BAG_SUFFIXES, COMPRESSED_IMAGE, IMAGE, BagFrames, opened_bag, picture_size
from rholoc.recordings.imu_normalisation import ImuConvention, Samples, advancing_rows, normalise_imu
from rholoc.recordings.readers._camera_models import unsupported
from rholoc.recordings.readers._ros import Mounting, camera_of_info, pose_of, stamp_ns, vector
from rholoc.recordings.readers.models.kapture import UNKNOWN_MODEL, read_cameras
from rholoc.recordings.recording import GivenPoses, Imu, PoseKind, Recording, RecordingFormat
from rholoc.recordings.tables.pose_table import PoseTable, match_poses
from rholoc.reports import RecordingWarning, WarningKind

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader
    from rosbags.interfaces import Connection

TABLES = ("*.bag", "*.mcap", "*.db3", "metadata.yaml", "sensors.txt")

_CAMERA_INFO, _IMU = "sensor_msgs/msg/CameraInfo", "sensor_msgs/msg/Imu"
_ODOMETRY = "nav_msgs/msg/Odometry"
_POSES = (
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/TransformStamped",
)
_TF = "tf2_msgs/msg/TFMessage"
_DEPTH = ("16UC1", "32FC1")
_TOLD = 20  # messages of an IMU's topic, to find out its measurements
_S_PER_NS = 1e-9
_MAX_NAMED = 3


def recognises(folder: Path) -> bool:
    """Whether the folder contains a ROS bag, or is a bag of ROS 2."""
    return bool(_bags(folder))


def read(folder: Path, topics: Sequence[str] = ()) -> Recording:
    """Read the folder's bag.

    Raises:
        InvalidRecording: there are several bags, or the bag is damaged, has no pictures, or lacks a topic.
        InvalidCamera: its intrinsics are impossible.
        InvalidTrajectory: its poses are impossible.
    """
    bags = _bags(folder)
    if len(bags) > 1:
        raise InvalidRecording(
            f"The folder {folder.name} contains several bags: {', '.join(one.name for one in bags[:_MAX_NAMED])}.",
            "Give one of them.",
        )
    return read_bag(bags[0], topics)


def read_bag(path: Path, topics: Sequence[str] = ()) -> Recording:
    """Read a bag: a file, or a folder with ``metadata.yaml``.

    Args:
        path: the bag.
        topics: names of the topics to use, if there are several of a kind.

    Raises:
        InvalidRecording: the bag is damaged, has no pictures, or lacks one of ``topics``.
        InvalidCamera: its intrinsics are impossible.
        InvalidTrajectory: its poses are impossible.
    """
    with opened_bag(path) as reader:
        found = _Topics.of(reader, topics)
        frames, frame_id, warnings = _frames(path, reader, found)
        camera, camera_warnings = _camera(path, reader, found, frames.size)
        static = [one for one in found.of_types(_TF) if one.topic.endswith("tf_static")]
        mounted = Mounting.of(message for one in static for _, message in _messages(reader, one))
        imu, imu_warnings = _imu(reader, found, mounted, frame_id)
        poses, pose_warnings = _poses(reader, found, mounted, frame_id, frames)
    return Recording(
        frames,
        path.stem,
        path,
        camera,
        imu,
        poses=poses,
        format=RecordingFormat.BAG,
        warnings=(*warnings, *camera_warnings, *imu_warnings, *pose_warnings),
    )


def _bags(folder: Path) -> list[Path]:
    """The bags of a folder by name; the folder itself if it is one of ROS 2."""
    if (folder / "metadata.yaml").is_file():
        return [folder]
    return sorted(path for path in folder.iterdir() if path.suffix.lower() in BAG_SUFFIXES and path.is_file())


@dataclass(frozen=True, eq=False)
class _Topics:
    """The connections of a bag that have messages, which topics were asked for, and the connection of the pictures."""

    connections: tuple[Connection, ...]
    asked: tuple[str, ...]
    picture: Connection

    @classmethod
    def of(cls, reader: AnyReader, asked: Sequence[str]) -> _Topics:
        """Topics of an open bag; ``picture`` is the one asked for, or the one with most pictures.

        Raises InvalidRecording if a topic that was asked for is missing, or if there are no pictures.
        """
        connections = tuple(one for one in reader.connections if one.msgcount > 0)
        names = {one.topic for one in connections}
        for topic in asked:
            if topic not in names:
                listed = ", ".join(sorted(names)[:12])
                raise InvalidRecording(f"The bag has no topic {topic[:80]}.", f"It has {listed}.")
        pictures = [one for one in connections if one.msgtype in (IMAGE, COMPRESSED_IMAGE)]
        pictures = [one for one in pictures if one.topic in asked or _is_picture(reader, one)]
        chosen = _chosen(pictures, asked)
        if chosen is None:
            raise InvalidRecording("The bag has no pictures.", "Record a topic of Image or CompressedImage.")
        return cls(connections, tuple(asked), chosen)

    def of_types(self, *types: str) -> list[Connection]:
        """Connections with messages of these types."""
        return [one for one in self.connections if one.msgtype in types]

    def chosen(self, *types: str) -> Connection | None:
        """The connection of these types that was asked for, else the one with most messages; None if there is none."""
        return _chosen(self.of_types(*types), self.asked)


def _chosen(connections: Sequence[Connection], asked: Sequence[str]) -> Connection | None:
    """The connection asked for, else the one with most messages; None without any."""
    ordered = sorted(connections, key=lambda one: (one.topic not in asked, -one.msgcount, one.topic))
    return next(iter(ordered), None)


def _is_picture(reader: AnyReader, connection: Connection) -> bool:
    """Whether a topic of images shows pictures, not depths, by its first message."""
    message = _first(reader, connection)
    if connection.msgtype == COMPRESSED_IMAGE:
        return "compressedDepth" not in str(message.format)
    return message.encoding not in _DEPTH


def _first(reader: AnyReader, connection: Connection) -> Any:
    """First message of a connection that has messages."""
    _, _, raw = next(iter(reader.messages([connection])))
    return reader.deserialize(raw, connection.msgtype)


def _messages(reader: AnyReader, connection: Connection) -> Iterable[tuple[int, Any]]:
    """Iterate over when each message of the connection's topic was logged [ns], and the message."""
    publishers = [one for one in reader.connections if one.topic == connection.topic]
    for _, logged_ns, raw in reader.messages(publishers):
        yield logged_ns, reader.deserialize(raw, connection.msgtype)


# -- pictures and cameras --------------------------------------------------------------------------------------------


def _frames(path: Path, reader: AnyReader, found: _Topics) -> tuple[BagFrames, str, tuple[RecordingWarning, ...]]:
    """The pictures, their coordinate frame, and warnings about other picture topics. Raises InvalidRecording."""
    topic = found.picture
    logged: list[int] = []
    stamps: list[int] = []
    first: Any = None
    for logged_ns, message in _messages(reader, topic):
        first = first or message
        logged.append(logged_ns)
        stamps.append(stamp_ns(message, logged_ns))
    times = np.array(stamps, dtype=np.int64) * _S_PER_NS
    rows, warnings = advancing_rows(times, "frames")
    size = picture_size(first, topic.topic)
    frames = BagFrames(path, topic.topic, np.array(logged, dtype=np.int64), rows, times[rows], size)
    others = sorted({one.topic for one in found.of_types(IMAGE, COMPRESSED_IMAGE)} - {topic.topic})
    if others:
        listed = ", ".join(others[:_MAX_NAMED]) + (f" and {len(others) - _MAX_NAMED} more" if len(others) > 3 else "")
        text = f"Of the bag's pictures those of {topic.topic} are used, not {listed}; --topic chooses others."
        warnings = (*warnings, RecordingWarning(WarningKind.NOT_USED, text))
    return frames, str(first.header.frame_id), warnings


def _camera(
    path: Path, reader: AnyReader, found: _Topics, size: tuple[int, int]
) -> tuple[Camera | None, tuple[RecordingWarning, ...]]:
    """The intrinsics for pictures of ``size`` (width, height) by the bag's CameraInfo, else by ``sensors.txt`` beside
    it, and warnings; None without either. Raises InvalidCamera if they are impossible, or of another aspect ratio.
    """
    infos = found.of_types(_CAMERA_INFO)
    asked = [one for one in infos if one.topic in found.asked]
    topic = found.picture.topic
    matching = asked or [one for one in infos if topic.startswith(_namespace(one))]
    if matching:
        nearest = max(matching, key=lambda one: len(_namespace(one)))
        is_rectified = "rect" in topic.removesuffix("/compressed").rsplit("/", 1)[-1]
        return camera_of_info(_first(reader, nearest), size, is_rectified)
    sensors = (path if path.is_dir() else path.parent) / "sensors.txt"
    if not sensors.is_file():
        return None, ()
    cameras = list(read_cameras(sensors).values())
    pictures = sorted({one.topic for one in found.of_types(IMAGE, COMPRESSED_IMAGE)})
    if len(cameras) not in (1, len(pictures)):
        topics = f"{len(pictures)} topic{'s' if len(pictures) > 1 else ''} of pictures"
        text = f"sensors.txt is not used: it has {len(cameras)} cameras, the bag {topics}."
        return None, (RecordingWarning(WarningKind.NOT_USED, text),)
    camera = cameras[pictures.index(found.picture.topic) if len(cameras) > 1 else 0]
    if isinstance(camera, Camera):
        return camera.fitted(*size), ()
    return None, () if camera == UNKNOWN_MODEL else (unsupported(camera[:40]),)


def _namespace(connection: Connection) -> str:
    """The connection's topic up to and including its last slash."""
    return connection.topic.rpartition("/")[0] + "/"


# -- other measurements ------------------------------------------------------------------------------------------


def _imu(
    reader: AnyReader, found: _Topics, mounted: Mounting, camera_frame: str
) -> tuple[Imu | None, tuple[RecordingWarning, ...]]:
    """Gyroscope and accelerometer, each from a requested topic that measures it, else from the one with most rows; and
    warnings. One topic with both is preferred. None if one is missing. Raises InvalidRecording.
    """
    accelerometers, gyroscopes = [], []
    for connection in found.of_types(_IMU):
        a, w = _measures(reader, connection)
        accelerometers += [connection] * a
        gyroscopes += [connection] * w
    accelerometer, gyroscope = _chosen(accelerometers, found.asked), _chosen(gyroscopes, found.asked)
    both = [one for one in accelerometers if one in gyroscopes]
    if both and not {one.topic for one in accelerometers + gyroscopes if one not in both} & set(found.asked):
        accelerometer = gyroscope = _chosen(both, found.asked)
    if accelerometer is None or gyroscope is None:
        return None, ()
    acceleration_rows, rate_rows = (list(_messages(reader, one)) for one in (accelerometer, gyroscope))
    samples = [
        Samples(
            np.array([stamp_ns(message, logged_ns) for logged_ns, message in rows], dtype=np.float64),
            np.array([vector(getattr(message, name)) for _, message in rows]),
        )
        for rows, name in ((acceleration_rows, "linear_acceleration"), (rate_rows, "angular_velocity"))
    ]
    T_camera_imu = mounted.between(camera_frame, str(rate_rows[0][1].header.frame_id))
    R_camera_imu = None if T_camera_imu is None else T_camera_imu[:3, :3]
    return normalise_imu(samples[0], samples[1], ImuConvention(time_unit="ns"), R_camera_imu)


def _measures(reader: AnyReader, connection: Connection) -> tuple[bool, bool]:
    """Whether an IMU's topic has accelerations, and whether it has angular velocities.

    Judged by its first 21 messages. Values are missing if they are all zero, or if the covariance begins with −1.
    """
    a, w = False, False
    for number, (_, message) in enumerate(_messages(reader, connection)):
        a |= bool(message.linear_acceleration_covariance[0] >= 0 and np.any(vector(message.linear_acceleration)))
        w |= bool(message.angular_velocity_covariance[0] >= 0 and np.any(vector(message.angular_velocity)))
        if number >= _TOLD:
            break
    return a, w


def _poses(
    reader: AnyReader, found: _Topics, mounted: Mounting, camera_frame: str, frames: BagFrames
) -> tuple[GivenPoses | None, tuple[RecordingWarning, ...]]:
    """The camera's poses from the requested topic, else from poses (taken as exact), else from odometry; and warnings.
    None without such a topic, or (with a warning) if no pose belongs to a frame.
    """
    asked = [one for one in found.of_types(*_POSES, _ODOMETRY) if one.topic in found.asked]
    connection = _chosen(asked or found.of_types(*_POSES), ()) or found.chosen(_ODOMETRY)
    if connection is None:
        return None, ()
    times, T = [], []
    body = ""
    for logged, message in _messages(reader, connection):
        body = str(getattr(message, "child_frame_id", ""))
        times.append(stamp_ns(message, logged) * _S_PER_NS)
        T.append(pose_of(message, connection.topic))
    T_body_camera = mounted.between(body, camera_frame) if body else None
    if T_body_camera is None:
        R = np.eye(3) if not body or body.endswith("optical_frame") else R_FORWARD_OPTICAL
        T_body_camera = pose_matrix(R, np.zeros(3))
    order = np.unique(np.array(times), return_index=True)[1]
    table = PoseTable(np.array(times)[order], np.array(T)[order] @ T_body_camera)
    kind = PoseKind.ODOMETRY if connection.msgtype == _ODOMETRY else PoseKind.EXACT
    try:
        return replace(match_poses(table, frames), kind=kind), ()
    except InvalidTrajectory as error:
        return None, (RecordingWarning(WarningKind.NOT_USED, f"{connection.topic} is not used: {error.message}"),)
