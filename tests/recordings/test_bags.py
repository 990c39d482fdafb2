"""Bags that rosbags' own writers made: pictures of every encoding, cameras, IMUs, odometry and poses."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from rholoc.errors import InvalidRecording, RholocError
from rholoc.geometry import ByteArray, Camera, FloatArray, Lens, pose_matrix
from rholoc.recordings import PoseKind, Recording, RecordingFormat, read_recording
from rholoc.reports import WarningKind

SIZE = WIDTH, HEIGHT = 64, 48
START_NS, STEP_NS, COUNT = 1_700_000_000_000_000_000, 50_000_000, 12
IMU_STEP_NS = 5_000_000
KINDS = ("bag", "db3", "mcap")


@dataclass(frozen=True, eq=False)
class Bag:
    """A bag that is being written."""

    store: Any
    is_ros1: bool
    writer: Any
    connections: dict[str, Any]

    def make(self, kind: str, **fields: Any) -> Any:
        return self.store.types[kind](**fields)

    def header(self, stamp_ns: int, frame: str) -> Any:
        seconds, rest = divmod(stamp_ns, 1_000_000_000)
        time = self.make("builtin_interfaces/msg/Time", sec=seconds, nanosec=rest)
        return self.make("std_msgs/msg/Header", stamp=time, frame_id=frame, **({"seq": 0} if self.is_ros1 else {}))

    def vector(self, values: Any) -> Any:
        x, y, z = map(float, values)
        return self.make("geometry_msgs/msg/Vector3", x=x, y=y, z=z)

    def pose(self, T: FloatArray) -> Any:
        x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat().tolist()
        position = self.make("geometry_msgs/msg/Point", **dict(zip("xyz", map(float, T[:3, 3]), strict=True)))
        orientation = self.make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)
        return self.make("geometry_msgs/msg/Pose", position=position, orientation=orientation)

    def transform(self, T: FloatArray) -> Any:
        turn = self.pose(T).orientation
        return self.make("geometry_msgs/msg/Transform", translation=self.vector(T[:3, 3]), rotation=turn)

    def write(self, topic: str, kind: str, message: Any, logged_ns: int) -> None:
        if topic not in self.connections:
            self.connections[topic] = self.writer.add_connection(topic, kind, typestore=self.store)
        data = (self.store.serialize_ros1 if self.is_ros1 else self.store.serialize_cdr)(message, kind)
        self.writer.write(self.connections[topic], logged_ns, data)

    def picture(self, topic: str, number: int, image: ByteArray, encoding: str, frame: str = "cam") -> None:
        stamp_ns = START_NS + number * STEP_NS
        header = self.header(stamp_ns, frame)
        if encoding in ("jpeg", "png"):
            kind = "sensor_msgs/msg/CompressedImage"
            data = cv2.imencode(f".{encoding}", image)[1].ravel()
            message = self.make(kind, header=header, format=encoding, data=data)
        else:
            kind = "sensor_msgs/msg/Image"
            height, width = image.shape[:2]
            padded = np.pad(image.reshape(height, -1).view(np.uint8), ((0, 0), (0, 5)))  # rows may be padded
            fields = {"height": height, "width": width, "encoding": encoding, "is_bigendian": 0}
            message = self.make(kind, header=header, **fields, step=padded.shape[1], data=padded.ravel())
        self.write(topic, kind, message, stamp_ns + 7_000_000)

    def info(self, topic: str, model: str, coefficients: tuple[float, ...], **region: int) -> None:
        kind, names = "sensor_msgs/msg/CameraInfo", ("d", "k", "r", "p")
        K = np.array([40.0, 0, 31.5, 0, 41.0, 23.5, 0, 0, 1])
        P = np.array([50.0, 0, 30.0, 0, 0, 51.0, 22.0, 0, 0, 0, 1, 0])
        values = dict(zip(names, (np.array(coefficients, dtype=np.float64), K, np.eye(3).ravel(), P), strict=True))
        values = {name.upper() if self.is_ros1 else name: value for name, value in values.items()}
        nowhere = {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False}
        roi = self.make("sensor_msgs/msg/RegionOfInterest", **(nowhere | region))
        message = self.make(
            kind,
            header=self.header(START_NS, "cam"),
            height=HEIGHT,
            width=WIDTH,
            distortion_model=model,
            binning_x=0,
            binning_y=0,
            roi=roi,
            **values,
        )
        self.write(topic, kind, message, START_NS)

    def imu(self, topic: str, stamp_ns: int, acceleration: Any, rate: Any, frame: str = "imu") -> None:
        nothing = np.zeros(9)
        message = self.make(
            "sensor_msgs/msg/Imu",
            header=self.header(stamp_ns, frame),
            orientation=self.make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
            orientation_covariance=nothing,
            angular_velocity=self.vector(rate),
            angular_velocity_covariance=nothing,
            linear_acceleration=self.vector(acceleration),
            linear_acceleration_covariance=nothing,
        )
        self.write(topic, "sensor_msgs/msg/Imu", message, stamp_ns + 2_000_000)

    def odometry(self, topic: str, stamp_ns: int, T: FloatArray, child: str) -> None:
        none = self.make("geometry_msgs/msg/Twist", linear=self.vector((0, 0, 0)), angular=self.vector((0, 0, 0)))
        message = self.make(
            "nav_msgs/msg/Odometry",
            header=self.header(stamp_ns, "odom"),
            child_frame_id=child,
            pose=self.make("geometry_msgs/msg/PoseWithCovariance", pose=self.pose(T), covariance=np.zeros(36)),
            twist=self.make("geometry_msgs/msg/TwistWithCovariance", twist=none, covariance=np.zeros(36)),
        )
        self.write(topic, "nav_msgs/msg/Odometry", message, stamp_ns)

    def stamped_pose(self, topic: str, stamp_ns: int, T: FloatArray) -> None:
        kind = "geometry_msgs/msg/PoseStamped"
        self.write(topic, kind, self.make(kind, header=self.header(stamp_ns, "map"), pose=self.pose(T)), stamp_ns)

    def static(self, parent: str, child: str, T: FloatArray) -> None:
        one = self.make(
            "geometry_msgs/msg/TransformStamped",
            header=self.header(START_NS, parent),
            child_frame_id=child,
            transform=self.transform(T),
        )
        self.write(
            "/tf_static", "tf2_msgs/msg/TFMessage", self.make("tf2_msgs/msg/TFMessage", transforms=[one]), START_NS
        )


@contextmanager
def bag(folder: Path, kind: str = "bag") -> Iterator[tuple[Path, Bag]]:
    """A bag of a kind to be written, and what to read of it afterwards."""
    if kind == "bag":
        path = folder / "walk.bag"
        with Writer1(path) as writer:
            yield path, Bag(_with_tf(get_typestore(Stores.ROS1_NOETIC)), True, writer, {})
        return
    path = folder / "walk"
    plugin = StoragePlugin.SQLITE3 if kind == "db3" else StoragePlugin.MCAP
    with Writer2(path, version=9, storage_plugin=plugin) as writer:
        yield path, Bag(get_typestore(Stores.ROS2_JAZZY), False, writer, {})


def _with_tf(store: Any) -> Any:
    if "tf2_msgs/msg/TFMessage" not in store.types:
        from rosbags.typesys import get_types_from_msg

        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
    return store


def shade(number: int) -> ByteArray:
    """A colourful picture (H, W, 3) BGR."""
    across = np.broadcast_to(np.linspace(40, 120, WIDTH), (HEIGHT, WIDTH))
    return np.stack([across, across + 40, np.full_like(across, 10 * number + 30)], axis=2).astype(np.uint8)


def read(tmp_path: Path, fill: Callable[[Bag], None], kind: str = "bag", **how: Any) -> Recording:
    with bag(tmp_path, kind) as (path, writing):
        fill(writing)
    return read_recording(path, **how)


def turning(step_deg: float) -> FloatArray:
    """Poses (N, 4, 4) of a camera that turns about the vertical."""
    angles_deg = step_deg * np.arange(COUNT)[:, None]
    return pose_matrix(Rotation.from_euler("y", angles_deg, degrees=True).as_matrix(), np.zeros(3))


def pictures(writing: Bag, topic: str = "/cam/image_raw", count: int = COUNT, frame: str = "cam") -> None:
    for number in range(count):
        writing.picture(topic, number, shade(number), "bgr8", frame)


@pytest.mark.parametrize("kind", KINDS)
def test_a_walk_comes_back_from_every_kind_of_bag(kind: str, tmp_path: Path) -> None:
    T_map_camera = turning(3.0)
    T_map_camera[:, 0, 3] = 0.1 * np.arange(COUNT)
    T_base_cam = pose_matrix(Rotation.from_euler("x", -90, degrees=True).as_matrix(), np.array([0.1, 0, 0.2]))

    def fill(writing: Bag) -> None:
        pictures(writing)
        writing.info("/cam/camera_info", "plumb_bob", (0.1, -0.05, 0.001, 0.002, 0.0))
        writing.static("base", "cam", T_base_cam)
        writing.static("base", "imu", np.eye(4))
        for number, T in enumerate(T_map_camera):
            writing.odometry("/odom", START_NS + number * STEP_NS + 1000, T @ np.linalg.inv(T_base_cam), "base")
        for row in range(COUNT * STEP_NS // IMU_STEP_NS):
            writing.imu("/imu", START_NS + row * IMU_STEP_NS, (0.0, 0.0, 9.81), (0.0, np.radians(60), 0.1))

    recording = read(tmp_path, fill, kind)
    assert (recording.name, recording.format) == ("walk", RecordingFormat.BAG)
    assert recording.frames.size == SIZE
    np.testing.assert_allclose(np.diff(recording.frames.times), STEP_NS / 1e9, atol=1e-6)
    assert recording.frames.times[0] == pytest.approx(START_NS / 1e9, abs=1e-6)  # the header's stamp, not the bag's
    for row, image in zip([2, 3, 9], recording.frames.images([2, 3, 9]), strict=True):
        np.testing.assert_array_equal(image, shade(row))
    assert recording.camera == Camera(*SIZE, 40.0, 41.0, 31.5, 23.5, (0.1, -0.05, 0.001, 0.002, 0.0))
    np.testing.assert_allclose(recording.imu.angular_velocity[5], [0, np.radians(60), 0.1], atol=1e-9)
    np.testing.assert_allclose(recording.imu.R_camera_imu, T_base_cam[:3, :3].T, atol=1e-9)
    assert recording.poses.kind is PoseKind.ODOMETRY
    np.testing.assert_allclose(recording.poses.T_map_camera, T_map_camera, atol=1e-5)  # odometry is 1 µs later


@pytest.mark.parametrize(
    ("encoding", "to"),
    [
        ("bgr8", None),
        ("rgb8", cv2.COLOR_BGR2RGB),
        ("bgra8", cv2.COLOR_BGR2BGRA),
        ("rgba8", cv2.COLOR_BGR2RGBA),
        ("jpeg", None),
        ("png", None),
        ("mono8", cv2.COLOR_BGR2GRAY),
    ],
)
@pytest.mark.parametrize("kind", KINDS)
def test_pictures_of_every_encoding(encoding: str, to: int | None, kind: str, tmp_path: Path) -> None:
    image = shade(4)

    def fill(writing: Bag) -> None:
        for number in range(3):
            sent = image if to is None else cv2.cvtColor(image, to)
            writing.picture("/image", number, np.asarray(sent, dtype=np.uint8), encoding)

    (found,) = read(tmp_path, fill, kind).frames.images([1])
    expected = (
        np.repeat(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)[:, :, None], 3, axis=2) if encoding == "mono8" else image
    )
    np.testing.assert_allclose(found.astype(float), expected, atol=4 if encoding == "jpeg" else 0)


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_bayer_patterns_are_named_from_the_first_pixel(pattern: str, tmp_path: Path) -> None:
    image = np.full((HEIGHT, WIDTH, 3), (40, 120, 200), np.uint8)
    mosaic = np.zeros((HEIGHT, WIDTH), np.uint8)
    for place, colour in enumerate(pattern):
        v, u = divmod(place, 2)
        mosaic[v::2, u::2] = image[v::2, u::2, "bgr".index(colour)]
    recording = read(tmp_path, lambda writing: writing.picture("/image", 0, mosaic, f"bayer_{pattern}8"))
    (found,) = recording.frames.images([0])
    np.testing.assert_allclose(found[4:-4, 4:-4], image[4:-4, 4:-4], atol=1)


def test_of_16_bits_the_upper_8_are_kept(tmp_path: Path) -> None:
    grey = (np.arange(HEIGHT * WIDTH).reshape(HEIGHT, WIDTH) * 17).astype("<u2")
    recording = read(tmp_path, lambda writing: writing.picture("/image", 0, grey.view(np.uint16), "mono16"))
    (found,) = recording.frames.images([0])
    np.testing.assert_array_equal(found[:, :, 0], grey >> 8)


@pytest.mark.parametrize(
    ("model", "coefficients", "lens"),
    [
        ("plumb_bob", (0.1, -0.05, 0.001, 0.002, 0.003), Lens.PINHOLE),
        ("rational_polynomial", (0.1, -0.05, 0.001, 0.002, 0.003, 0.1, 0.01, 0.001), Lens.PINHOLE),
        ("equidistant", (0.01, 0.02, -0.01, 0.001), Lens.FISHEYE),
        ("plumb_bob", (0.0, 0.0, 0.0, 0.0, 0.0), Lens.PINHOLE),
    ],
)
@pytest.mark.parametrize("kind", KINDS)
def test_lenses_of_camera_info(
    model: str, coefficients: tuple[float, ...], lens: Lens, kind: str, tmp_path: Path
) -> None:
    def fill(writing: Bag) -> None:
        pictures(writing, "/front/image_raw", 3)
        writing.info("/front/camera_info", model, coefficients)
        writing.info("/back/camera_info", "plumb_bob", (0.5, 0.0, 0.0, 0.0, 0.0))

    expected = coefficients if any(coefficients) else ()
    assert read(tmp_path, fill, kind).camera == Camera(*SIZE, 40.0, 41.0, 31.5, 23.5, expected, lens)


@pytest.mark.parametrize(("topic", "encoding"), [("/cam/image_rect", "bgr8"), ("/cam/image_rect/compressed", "jpeg")])
def test_rectified_pictures_have_the_projections_camera(topic: str, encoding: str, tmp_path: Path) -> None:
    def fill(writing: Bag) -> None:
        for number in range(3):
            writing.picture(topic, number, shade(number), encoding)
        writing.info("/cam/camera_info", "plumb_bob", (0.1, -0.05, 0.001, 0.002, 0.003))

    assert read(tmp_path, fill).camera == Camera(*SIZE, 50.0, 51.0, 30.0, 22.0)


def test_the_nearest_camera_info_describes_the_pictures(tmp_path: Path) -> None:
    def fill(writing: Bag) -> None:
        writing.info("/camera_info", "plumb_bob", (0.5, 0.0, 0.0, 0.0, 0.0))
        pictures(writing, "/front/image_raw", 3)
        writing.info("/front/camera_info", "plumb_bob", ())

    assert read(tmp_path, fill).camera == Camera(*SIZE, 40.0, 41.0, 31.5, 23.5)


def test_a_part_of_the_sensor_has_its_own_principal_point(tmp_path: Path) -> None:
    def fill(writing: Bag) -> None:
        for number in range(3):
            writing.picture("/cam/image_raw", number, shade(number)[8:40, 10:50], "bgr8")
        writing.info("/cam/camera_info", "plumb_bob", (), x_offset=10, y_offset=8, width=40, height=32)

    assert read(tmp_path, fill).camera == Camera(40, 32, 40.0, 41.0, 21.5, 15.5)


@pytest.mark.parametrize(("model", "coefficients"), [("omni", (0.1,)), ("rational_polynomial", (0.1,) * 12)])
def test_an_unknown_lens_is_named(model: str, coefficients: tuple[float, ...], tmp_path: Path) -> None:
    def fill(writing: Bag) -> None:
        pictures(writing, count=3)
        writing.info("/cam/camera_info", model, coefficients)

    recording = read(tmp_path, fill)
    assert recording.camera is None
    assert [warning.kind for warning in recording.warnings] == [WarningKind.CAMERA_UNSUPPORTED]
    assert model in recording.warnings[0].text


def test_gyroscope_and_accelerometer_may_be_topics_of_their_own(tmp_path: Path) -> None:
    def fill(writing: Bag) -> None:
        pictures(writing)
        for row in range(120):
            writing.imu("/gyro/sample", START_NS + row * IMU_STEP_NS, (0, 0, 0), (0.1, 0.2, 0.3))
        for row in range(40):
            writing.imu("/accel/sample", START_NS + row * 3 * IMU_STEP_NS, (0, 9.81, 0), (0, 0, 0))

    imu = read(tmp_path, fill).imu
    assert len(imu.times) > 110
    np.testing.assert_allclose(imu.angular_velocity[50], [0.1, 0.2, 0.3])
    np.testing.assert_allclose(imu.acceleration[50], [0, 9.81, 0], atol=0.01)
    assert imu.R_camera_imu is None


def test_topics_can_be_chosen(tmp_path: Path) -> None:
    def fill(writing: Bag) -> None:
        pictures(writing, "/left/image_raw", 4)
        pictures(writing, "/right/image_raw", 3)
        writing.info("/right/camera_info", "equidistant", (0.01, 0.02, -0.01, 0.001))
        for number in range(4):
            depth = np.full((HEIGHT, WIDTH), 1500, np.uint16)
            writing.picture("/depth/image_raw", number, depth, "16UC1")

    with bag(tmp_path) as (path, writing):
        fill(writing)
    left = read_recording(path)
    assert (len(left.frames.times), left.camera) == (4, None)
    (warning,) = left.warnings
    assert "/right/image_raw" in warning.text
    right = read_recording(path, topics=["/right/image_raw"])
    assert len(right.frames.times) == 3
    assert right.camera.lens is Lens.FISHEYE
    with pytest.raises(InvalidRecording, match="no topic /up"):
        read_recording(path, topics=["/up"])


def test_poses_of_an_optical_frame_are_the_cameras(tmp_path: Path) -> None:
    T = turning(4.0)

    def fill(writing: Bag) -> None:
        pictures(writing, frame="cam_optical_frame")
        for number, one in enumerate(T):
            writing.stamped_pose("/truth", START_NS + number * STEP_NS, one)
            writing.odometry("/odom", START_NS + number * STEP_NS, np.eye(4), "base_link")

    exact = read(tmp_path, fill).poses
    assert exact.kind is PoseKind.EXACT
    np.testing.assert_allclose(exact.T_map_camera, T, atol=1e-9)
    driven = read_recording(tmp_path / "walk.bag", topics=["/odom"]).poses
    assert driven.kind is PoseKind.ODOMETRY
    np.testing.assert_allclose(driven.T_map_camera[0, :3, 2], [1, 0, 0], atol=1e-9)  # a base looks along its x axis


def test_intrinsics_may_lie_beside_the_bag(tmp_path: Path) -> None:
    with bag(tmp_path) as (_, writing):
        pictures(writing, "/a/image_raw", 3)
        pictures(writing, "/b/image_raw", 3)
    (tmp_path / "sensors.txt").write_text(
        "# kapture format: 1.1\n# sensor_id, name, sensor_type, [sensor_params]+\n"
        "left, l, camera, OPENCV_FISHEYE, 64, 48, 20, 21, 32, 24, 0.01, 0.02, -0.01, 0.001\n"
        "right, r, camera, PINHOLE, 64, 48, 40, 41, 32, 24\n"
    )
    fisheye = Camera(*SIZE, 20.0, 21.0, 31.5, 23.5, (0.01, 0.02, -0.01, 0.001), Lens.FISHEYE)
    assert read_recording(tmp_path).camera == fisheye
    assert read_recording(tmp_path, topics=["/b/image_raw"]).camera == Camera(*SIZE, 40.0, 41.0, 31.5, 23.5)
    (tmp_path / "camera.json").write_text('{"width": 64, "height": 48, "fx": 30, "fy": 30, "cx": 31, "cy": 23}')
    assert read_recording(tmp_path).camera == Camera(*SIZE, 30.0, 30.0, 31.0, 23.0)


@pytest.mark.parametrize(
    ("sensors", "named"),
    [
        ("cam, c, camera, THIN_PRISM_FISHEYE, 64, 48, 20, 21, 32, 24, 0, 0, 0, 0, 0, 0, 0, 0\n", "THIN_PRISM_FISHEYE"),
        ("".join(f"{name}, c, camera, PINHOLE, 64, 48, 40, 41, 32, 24\n" for name in "ab"), "2 cameras"),
    ],
)
def test_intrinsics_beside_the_bag_that_cannot_be_used_are_named(sensors: str, named: str, tmp_path: Path) -> None:
    with bag(tmp_path) as (_, writing):
        pictures(writing, count=3)
    (tmp_path / "sensors.txt").write_text(sensors)
    recording = read_recording(tmp_path)
    assert recording.camera is None
    assert any(named in warning.text for warning in recording.warnings)


def test_a_camera_beside_the_bag_without_intrinsics_is_no_cause_for_a_warning(tmp_path: Path) -> None:
    with bag(tmp_path) as (_, writing):
        pictures(writing, count=3)
    (tmp_path / "sensors.txt").write_text("cam, c, camera, UNKNOWN_CAMERA, 64, 48\n")
    recording = read_recording(tmp_path)
    assert recording.camera is None
    assert WarningKind.CAMERA_UNSUPPORTED not in [warning.kind for warning in recording.warnings]


def test_a_file_of_a_bag_reads_without_its_folder(tmp_path: Path) -> None:
    for kind in ("db3", "mcap"):
        with bag(tmp_path / kind, kind) as (path, writing):
            pictures(writing, count=3)
        (file,) = path.glob(f"*.{kind}")
        assert len(read_recording(file).frames.times) == 3


@pytest.mark.parametrize("kind", KINDS)
def test_a_damaged_bag_is_refused_in_one_line(kind: str, tmp_path: Path) -> None:
    with bag(tmp_path, kind) as (path, writing):
        pictures(writing)
    file = path if path.is_file() else next(path.glob(f"*.{kind}"))
    whole = file.read_bytes()
    rng = np.random.default_rng(0)
    for attempt in range(12):
        damaged = bytearray(whole[: int(len(whole) * rng.uniform(0.05, 1))])
        for place in rng.integers(0, len(damaged), 40 * (attempt % 3)):
            damaged[place] = rng.integers(256)
        file.write_bytes(damaged)
        with suppress(RholocError):  # and nothing else
            list(read_recording(path).frames.images(range(3)))


def test_a_bag_without_pictures_says_so(tmp_path: Path) -> None:
    with bag(tmp_path) as (path, writing):
        writing.imu("/imu", START_NS, (0, 0, 9.81), (0, 0, 0.1))
    with pytest.raises(InvalidRecording, match="no pictures"):
        read_recording(path)


def test_an_encoding_that_is_not_known_is_named(tmp_path: Path) -> None:
    with pytest.raises(InvalidRecording, match="mystery"):
        read(tmp_path, lambda writing: writing.picture("/image", 0, shade(0), "mystery"))
