"""A recording: frames with their times, and what else was measured during the walk."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Protocol

from rholoc.geometry import BoolArray, ByteArray, Camera, FloatArray, IntArray
from rholoc.geometry.earth import EarthPlace
from rholoc.recordings.frames.depth import DepthImages
from rholoc.reports import RecordingWarning

GRAVITY = 9.81  # m/s², what an accelerometer at rest reads


class RecordingFormat(StrEnum):
    """Format of a recording; maps/README.md describes each."""

    VIDEO = "video"  # a video file and nothing else
    RHOLOC = "rholoc"  # our own folder, and any folder of images
    ANDROID_CSV = "android-csv"  # timestamp_ns tables beside a video
    OPENCAMERA_SENSORS = "opencamera-sensors"
    MARS_LOGGER = "mars-logger"
    SENSOR_LOGGER = "sensor-logger"
    SPECTACULAR = "spectacular-ai"  # data.jsonl
    STRAY_SCANNER = "stray-scanner"
    IOS_LOGGER = "ios-logger"  # Frames.txt, MotARH.txt, ARposes.txt
    ADVIO = "advio"
    EUROC = "euroc"  # ASL's layout
    TUM_RGBD = "tum-rgbd"
    SEVEN_SCENES = "7-scenes"
    COLMAP = "colmap"  # text model
    NERFSTUDIO = "nerfstudio"  # transforms.json
    KAPTURE = "kapture"
    BAG = "ros-bag"  # of ROS 1 or 2
    METASHAPE = "metashape"  # cameras.xml
    SCANNER_APP = "3d-scanner-app"  # frame_*.jpg with frame_*.json
    POLYCAM = "polycam"  # keyframes/
    RECORD3D = "record3d"  # metadata with poses
    ARKIT_SCENES = "arkit-scenes"  # lowres_wide.traj


class FrameSource(Protocol):
    """The frames of a recording; images are decoded on demand."""

    @property
    def times(self) -> FloatArray:
        """(N,) float64, increasing: seconds on the recording's clock if ``timed``, else the rows 0..N-1."""
        ...

    @property
    def timed(self) -> bool:
        """Whether the times were measured. Without times neither rates nor durations are known."""
        ...

    @property
    def numbers(self) -> IntArray:
        """(N,) int64, the frames' numbers as users know them: in a video 0..N-1, in a folder the file's own."""
        ...

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        ...

    def images(self, rows: Sequence[int]) -> Iterator[ByteArray]:
        """The images (H, W, 3) BGR of the given rows 0..N-1, which must increase.

        Raises:
            InvalidRecording: a frame cannot be decoded.
        """
        ...


@dataclass(frozen=True, eq=False)
class Imu:
    """The IMU's table (the paper's Table 3), in the IMU's own axes.

    Attributes:
        times: (M,) float64, seconds on the recording's clock, increasing.
        acceleration: (M, 3) m/s². At rest it reads +9.81 upwards if ``includes_gravity``, else 0.
        angular_velocity: (M, 3) rad/s.
        includes_gravity: whether gravity's reaction is part of the acceleration.
        R_camera_imu: (3, 3), takes vectors of the IMU's axes to the camera frame, or None where unknown.
    """

    times: FloatArray
    acceleration: FloatArray
    angular_velocity: FloatArray
    includes_gravity: bool
    R_camera_imu: FloatArray | None


@dataclass(frozen=True)
class Waypoint:
    """A measured point of the walk: the camera's position at a time, metres in the map frame.

    If only the waypoints' order is known, their times are NaN: the camera then paused at each. ``sigma_m`` is the
    standard deviation of each coordinate. ``earth`` is the same point on Earth; positions are then metres to the east,
    to the north and up of the first waypoint.
    """

    name: str
    time: float
    position: tuple[float, float, float]
    sigma_m: float = 0.02
    earth: EarthPlace | None = None


@dataclass(frozen=True)
class KnownLength:
    """A measured distance between the camera's places in two frames.

    Attributes:
        first, second: the frames' numbers.
        length_m: metres.
    """

    first: int
    second: int
    length_m: float


@dataclass(frozen=True, eq=False)
class Mounted:
    """Two pictures that cameras of a rig took at the same moment.

    Attributes:
        first, second: the frames' numbers.
        T_first_second: (4, 4) pose of the second camera in the first one's frame [m].
    """

    first: int
    second: int
    T_first_second: FloatArray


class PoseKind(StrEnum):
    """Source of given poses."""

    EXACT = "exact"  # by motion capture or structure from motion: no drift
    ODOMETRY = "odometry"  # by a tracker, as ARKit's and ARCore's: exact from frame to frame, but they drift


@dataclass(frozen=True, eq=False)
class GivenPoses:
    """Poses that came with the recording, for some or all of its frames.

    Attributes:
        known: (N,) bool, whether the frame in this row has a pose.
        T_map_camera: (N, 4, 4), NaN where unknown.
        metric: whether their unit of length is the metre; False: it is unknown.
        kind: how they were measured.
    """

    known: BoolArray
    T_map_camera: FloatArray
    metric: bool = True
    kind: PoseKind = PoseKind.EXACT


@dataclass(frozen=True, eq=False)
class Odometry:
    """Motion of the camera, measured by wheels or a tracker.

    Attributes:
        times: (M,) seconds on the recording's clock, increasing.
        T_odom_camera: (M, 4, 4) in a frame that drifts, metres.
        sigma_m: (M,) standard deviation of the motion since the row before, of each coordinate.
        sigma_rad: (M,) of its rotation about each axis.
    """

    times: FloatArray
    T_odom_camera: FloatArray
    sigma_m: FloatArray
    sigma_rad: FloatArray


@dataclass(frozen=True, eq=False)
class Recording:
    """A walk through a place.

    Attributes:
        frames: the video's frames or the images.
        name: its name.
        path: where it was read from.
        camera: None if the intrinsics are unknown; structure from motion then estimates them.
        imu: None if there is none.
        waypoints: measured points of the walk.
        poses: None if none came with it.
        format: the layout that it was read as.
        frame_intrinsics: (N, 4) fx, fy, cx, cy of each frame in pixels, NaN where not logged; None where none were.
        readout_s: seconds that a rolling shutter takes from the first row to the last, or None where not logged.
        depth: depth images of its frames, or None.
        odometry: None if there is none.
        focal_px: first guess of the focal length where the intrinsics are unknown, by EXIF; or None.
        lenses: number of the lens that took each frame, by the frame's number, where pictures of several sizes came
            without focal lengths; empty if one took all.
        lengths: measured distances between the camera's places.
        mounted: pairs of pictures by cameras whose mounting on a rig is known.
        warnings: its problems.
    """

    frames: FrameSource
    name: str = ""
    path: Path = Path()
    camera: Camera | None = None
    imu: Imu | None = None
    waypoints: tuple[Waypoint, ...] = ()
    poses: GivenPoses | None = None
    format: RecordingFormat = RecordingFormat.RHOLOC
    frame_intrinsics: FloatArray | None = None
    readout_s: float | None = None
    depth: DepthImages | None = None
    odometry: Odometry | None = None
    focal_px: float | None = None
    lenses: Mapping[int, int] = field(default_factory=dict)
    lengths: tuple[KnownLength, ...] = ()
    mounted: tuple[Mounted, ...] = ()
    warnings: tuple[RecordingWarning, ...] = ()
