"""What was fed and what came back: one clear line each, never a traceback, and nothing left behind."""

import io
import json
import shutil
import stat
import zipfile
from collections.abc import Callable
from pathlib import Path

import phone_recordings as phone
import pytest

from rholoc.errors import InvalidRecording, RholocError
from rholoc.recordings import START_BYTES, check_file_name, check_file_start, read_recording
from rholoc.reports import WarningKind

# ruff: noqa: E501 (a row of the tables is one line)


Rows = list[list[str]]


def edited(name: str, file: str, change: Callable[[Rows], Rows]) -> Callable[[Path], Path]:
    """The walk in a layout, one of its tables changed."""

    def feed(folder: Path) -> Path:
        phone.edit_rows(phone.write_recording(name, folder / "walk") / file, change)
        return folder / "walk"

    return feed


def written(name: str, file: str, content: str | bytes) -> Callable[[Path], Path]:
    """The walk in a layout, one of its files written anew."""

    def feed(folder: Path) -> Path:
        path = phone.write_recording(name, folder / "walk") / file
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return folder / "walk"

    return feed


def replaced(name: str, file: str, old: str, new: str) -> Callable[[Path], Path]:
    """The walk in a layout, a text in one of its files replaced."""

    def feed(folder: Path) -> Path:
        path = phone.write_recording(name, folder / "walk") / file
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new))
        return folder / "walk"

    return feed


def without(name: str, file: str) -> Callable[[Path], Path]:
    """The walk in a layout, one of its files or folders taken out."""

    def feed(folder: Path) -> Path:
        path = phone.write_recording(name, folder / "walk") / file
        shutil.rmtree(path) if path.is_dir() else path.unlink()
        return folder / "walk"

    return feed


def cut(name: str, file: str, share: float) -> Callable[[Path], Path]:
    """The walk in a layout, one of its files cut off."""

    def feed(folder: Path) -> Path:
        path = phone.write_recording(name, folder / "walk") / file
        path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
        return folder / "walk"

    return feed


def packed(entries: dict[str, bytes], mode: int = 0o644) -> Callable[[Path], Path]:
    """A ZIP file of entries, each with a mode."""

    def feed(folder: Path) -> Path:
        path = folder / "walk.zip"
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, data in entries.items():
                info = zipfile.ZipInfo(name)
                info.external_attr = mode << 16
                info.compress_type = zipfile.ZIP_DEFLATED
                archive.writestr(info, data)
        return path

    return feed


def single(name: str, content: bytes) -> Callable[[Path], Path]:
    """A file of its own."""

    def feed(folder: Path) -> Path:
        (folder / name).write_bytes(content)
        return folder / name

    return feed


def cell(row: int, column: int, value: str) -> Callable[[Rows], Rows]:
    def change(rows: Rows) -> Rows:
        rows[row][column] = value
        return rows

    return change


def swap_halves(rows: Rows) -> Rows:
    """A clock that jumps back in the middle of a table without a header."""
    return rows[len(rows) // 2 :] + rows[: len(rows) // 2]


def nested_zip() -> bytes:
    inner = io.BytesIO()
    with zipfile.ZipFile(inner, "w") as archive:
        archive.writestr("video.mp4", b"")
    return inner.getvalue()


def encrypted(folder: Path) -> Path:
    path = packed({"imu.csv": b"timestamp"})(folder)
    data = bytearray(path.read_bytes())
    for signature, offset in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        data[data.index(signature) + offset] |= 1
    path.write_bytes(bytes(data))
    return path


def empty_folder(folder: Path) -> Path:
    (folder / "walk").mkdir()
    return folder / "walk"


def linked_image(folder: Path) -> Path:
    """An image in a list that is a link out of the recording."""
    root = phone.write_recording("euroc", folder / "walk") / "mav0" / "cam0" / "data"
    image = next(iter(sorted(root.iterdir())))
    image.unlink()
    secret = folder / "secret.png"
    phone.write_images(folder, ["secret.png"])
    image.symlink_to(secret)
    return folder / "walk"


def two_formats(folder: Path) -> Path:
    phone.write_recording("stray", folder / "walk")
    phone.write_nerfstudio(folder / "walk")
    return folder / "walk"


FRAMES_30 = "\n".join(["timestamp_ns,filename", *(f"{i * 50_000_000},f{i}.jpg" for i in range(30))])
DEEP = "[" * 100_000

# What was fed, how it is made, the error's code, and a part of what came back.
REFUSED: list[tuple[str, Callable[[Path], Path], str, str]] = [
    ("nothing at all", lambda folder: folder / "walk", "invalid_recording", "There is no"),
    ("an empty folder", empty_folder, "invalid_recording", "is empty"),
    ("a file of 0 bytes", single("walk.zip", b""), "invalid_recording", "not a complete ZIP file"),
    ("a video of 0 bytes", single("walk.mp4", b""), "invalid_recording", "not a video that can be opened"),
    ("text that claims to be a video", single("walk.mov", b"hello " * 99), "invalid_recording", "not a video"),
    ("a format nobody knows", single("walk.insv2", b"#FILM V2.0"), "invalid_recording", "not a recording of a known"),
    ("a ZIP file with no frames", packed({"notes.txt": b"hi"}), "invalid_recording", "neither a video nor images"),
    ("a ZIP file in a ZIP file", packed({"walk.zip": nested_zip()}), "invalid_recording", "neither a video nor images"),
    ("a ZIP bomb", packed({"imu.csv": b"\0" * 30_000_000}), "too_large", "suspiciously high compression ratio"),
    ("a path out of the folder", packed({"../../imu.csv": b"x"}), "invalid_recording", "outside its folder"),
    ("an absolute path", packed({"/etc/rholoc.csv": b"x"}), "invalid_recording", "outside its folder"),
    ("a path of Windows", packed({"C:\\imu.csv": b"x"}), "invalid_recording", "outside its folder"),
    ("a link in a ZIP file", packed({"imu.csv": b"/etc/passwd"}, stat.S_IFLNK | 0o777), "invalid_recording", "a link"),
    ("a device in a ZIP file", packed({"imu.csv": b""}, stat.S_IFCHR | 0o644), "invalid_recording", "link or device"),
    ("an encrypted ZIP file", encrypted, "invalid_recording", "encrypted"),
    ("a video cut off", cut("android-csv", "video.mp4", 0.6), "invalid_recording", "video.mp4"),
    ("a video cut off, StrayScanner", cut("stray", "rgb.mp4", 0.3), "invalid_recording", "rgb.mp4"),
    ("no video, OpenCamera Sensors", without("opencamera", "VID_1.mp4"), "invalid_recording", "contains no video"),
    ("no camera, Sensor Logger", without("sensor-logger-ios", "Camera"), "invalid_recording", "no folder Camera"),
    ("no acceleration, Sensor Logger", without("sensor-logger-ios", "Accelerometer.csv"), "invalid_recording", "neither"),
    ("no times of frames, OpenCamera Sensors", without("opencamera", "20260101_101010/VID_1_timestamps.csv"), "invalid_recording", "no table of the frames' times"),
    ("NaN in an IMU", edited("rholoc", "imu.csv", cell(9, 3, "NaN")), "invalid_recording", "imu.csv, row 10: 'NaN' under az"),
    ("NaN in an IMU, MARS logger", edited("mars-android", "gyro_accel.csv", cell(5, 2, "nan")), "invalid_recording", "'nan' under gy"),
    ("times in an unknown unit, MARS logger", edited("mars-android", "gyro_accel.csv", cell(0, 0, "Timestamp[millisec]")), "invalid_recording", "times in [millisec]"),
    ("a unit of any length, MARS logger", edited("mars-android", "gyro_accel.csv", cell(0, 0, f"Timestamp[{'m' * 300}]")), "invalid_recording", f"times in [{'m' * 20}]"),
    ("infinity in a gyroscope, ADVIO", edited("advio", "iphone/gyro.csv", cell(3, 1, "inf")), "invalid_recording", "'inf' under column 2"),
    ("a gyroscope beyond all bounds", edited("opencamera", "20260101_101010/VID_1_gyro.csv", cell(3, 1, "-1e308")), "invalid_recording", "reads 1e+308"),
    ("a number of a million digits", edited("android-csv", "gyroscope.csv", cell(3, 1, "7" * 10**6)), "invalid_recording", "is not a finite number"),
    ("more names than columns", replaced("sensor-logger-android", "Metadata.csv", "version,", "version,note,"), "invalid_recording", "7 names over 6 columns"),
    ("a word for a number, EuRoC", edited("euroc", "mav0/imu0/data.csv", cell(7, 4, "fast")), "invalid_recording", "'fast' under a_rs_s_x"),
    ("times that go back", edited("opencamera", "20260101_101010/VID_1_gyro.csv", swap_halves), "invalid_recording", "do not increase"),
    ("frames that go back", edited("android-csv", "frames.csv", lambda rows: [rows[0], *rows[:0:-1]]), "invalid_recording", "do not increase"),
    ("one time for all", edited("ios-logger", "MotARH.txt", lambda rows: [["5", *row[1:]] for row in rows]), "invalid_recording", "are implausible"),
    ("other columns", edited("rholoc", "imu.csv", cell(0, 3, "up")), "invalid_recording", "no column az"),
    ("a table that stops within a row", edited("stray", "imu.csv", lambda rows: [*rows[:50], rows[50][:4]]), "invalid_recording", "imu.csv, line 51: 4 values, not 7"),
    ("a table without rows", edited("android-csv", "gyroscope.csv", lambda rows: rows[:1]), "invalid_recording", "gyroscope.csv has no rows"),
    ("a table that is a picture", written("stray", "imu.csv", b"\x89PNG\xff\xfe\0"), "invalid_recording", "not a text file"),
    ("more times than frames", written("android-csv", "frames.csv", FRAMES_30), "invalid_recording", "has 30 frames, but video.mp4 has 24"),
    ("sensors of two clocks", edited("android-csv", "accelerometer.csv", lambda rows: [rows[0], *([f"9{t}", *v] for t, *v in rows[1:])]), "invalid_recording", "do not overlap in time"),
    ("JSON that is malformed", written("spectacular", "data.jsonl", "{]\n{}\n"), "invalid_recording", "data.jsonl, line 1 is not JSON"),
    ("JSON of another form", written("spectacular", "data.jsonl", '{"frames": 3}\n'), "invalid_recording", "line 1 is not of the known form"),
    ("NaN in JSON", replaced("spectacular", "data.jsonl", '"time": 1000.0}', '"time": NaN}'), "invalid_recording", "is not of the known form"),
    ("intrinsics of another form", replaced("spectacular", "data.jsonl", '"cameraParameters": {"focalLengthX": 60.0, "focalLengthY": 61.0, "principalPointX": 31.5, "principalPointY": 23.5}', '"cameraParameters": "none"'), "invalid_recording", "is not of the known form"),
    ("an image of infinite width", replaced("nerfstudio", "transforms.json", '"w": 64', '"w": Infinity'), "invalid_camera", "w is not a number"),
    ("JSON too deep", written("nerfstudio", "transforms.json", DEEP), "invalid_recording", "not JSON"),
    ("a calibration of nothing", written("spectacular", "calibration.json", '{"cameras": []}'), "invalid_camera", "describes no camera"),
    ("a focal length of zero", replaced("spectacular", "calibration.json", '"focalLengthX": 60.0', '"focalLengthX": 0.0'), "invalid_camera", "focal length is positive"),
    ("a pose that is no rotation", replaced("nerfstudio", "transforms.json", '"transform_matrix": [[', '"transform_matrix": [[9'), "invalid_trajectory", "is not a pose"),
    ("a list that leads out, nerfstudio", replaced("nerfstudio", "transforms.json", "images/frame_00001.png", "../../../etc/passwd"), "invalid_recording", "outside the recording's folder"),
    ("a list that leads out, EuRoC", edited("euroc", "mav0/cam0/data.csv", cell(1, 1, "/etc/passwd")), "invalid_recording", "outside the recording's folder"),
    ("a transform without end, nerfstudio", replaced("nerfstudio", "transforms.json", '"frames": [', '"applied_transform": [[1, 0, 0, 1e400], [0, 1, 0, 0], [0, 0, 1, 0]], "frames": ['), "invalid_trajectory", "applied_transform is not a pose"),
    ("times that are a number, Record3D", replaced("record3d", "metadata", '"frameTimestamps": [', '"frameTimestamps": 5, "others": ['), "invalid_recording", "frameTimestamps is not a list"),
    ("cameras by name, Record3D", replaced("record3d", "metadata", '"perFrameIntrinsicCoeffs": [', '"perFrameIntrinsicCoeffs": {"a": 1}, "others": ['), "invalid_recording", "perFrameIntrinsicCoeffs is not a list"),
    ("a picture called ², Record3D", written("record3d", "rgbd/².jpg", "hello"), "invalid_recording", "has no pose of ².jpg"),
    ("a link that leads out, EuRoC", linked_image, "invalid_recording", "outside the recording's folder"),
    ("an image that is not there", replaced("tum", "rgb.txt", "rgb/1000.100000.png", "rgb/no.png"), "invalid_recording", "no.png is listed but missing"),
    ("an image that is text", written("colmap", "images/walk/frame0003.png", "hello"), "invalid_recording", "frame0003.png"),
    ("a quaternion of no length", edited("stray", "odometry.csv", lambda rows: [rows[0], *([*row[:5], "0", "0", "0", "0", *row[9:]] for row in rows[1:])]), "invalid_trajectory", "not of unit length"),
    ("a pose file with words", written("7-scenes", "frame-000003.pose.txt", "lost"), "invalid_trajectory", "not a 4×4 matrix"),
    ("a model without its camera", written("colmap", "sparse/0/cameras.txt", "# none\n"), "invalid_camera", "no camera 1"),
    ("a model without images", written("colmap", "sparse/0/images.txt", "# none\n"), "invalid_recording", "lists no images"),
    ("YAML that is malformed", written("euroc", "mav0/cam0/sensor.yaml", "intrinsics: [1, 2"), "invalid_camera", "not plain YAML"),
    ("YAML that makes objects", written("euroc", "mav0/cam0/sensor.yaml", "!!python/object/apply:os.system ['true']"), "invalid_camera", "not plain YAML"),
    ("a camera matrix with a row too few", written("stray", "camera_matrix.csv", "60, 0, 32\n0, 60, 24\n"), "invalid_camera", "not a 3×3 matrix"),
    ("files of two formats", two_formats, "invalid_recording", "contains files of stray-scanner and nerfstudio"),
    ("a camera of another shape", written("android-csv", "camera.json", json.dumps({"width": 64, "height": 64, "fx": 60, "fy": 60, "cx": 32, "cy": 32})), "invalid_camera", "64×64"),
]  # fmt: skip

# What was fed, how it is made, and which problem is reported of what is read all the same.
READ: list[tuple[str, Callable[[Path], Path], WarningKind]] = [
    ("a video with a frame less than times", edited("android-csv", "frames.csv", lambda rows: rows[:-1]), WarningKind.FRAME_COUNT),
    ("a frame's time twice", edited("android-csv", "frames.csv", lambda rows: [*rows[:5], rows[4][:1] + rows[5][1:], *rows[6:]]), WarningKind.REPEATED_TIMES),
    ("a row of the IMU twice", edited("rholoc", "imu.csv", lambda rows: [*rows[:9], rows[8], *rows[9:]]), WarningKind.REPEATED_TIMES),
    ("half a second without IMU", edited("rholoc", "imu.csv", lambda rows: rows[:60] + rows[110:]), WarningKind.IMU_GAP),
    ("half a second without frames", edited("tum", "rgb.txt", lambda rows: rows[:10] + rows[20:]), WarningKind.FRAME_GAP),
    ("an IMU of another day", edited("rholoc", "imu.csv", lambda rows: [rows[0], *([f"9{t}", *v] for t, *v in rows[1:])]), WarningKind.NO_OVERLAP),
    ("a recorder that was killed", cut("spectacular", "data.jsonl", 0.9999), WarningKind.NOT_USED),
    ("milliseconds for nanoseconds", edited("android-csv", "gyroscope.csv", lambda rows: [rows[0], *([str(int(t) / 1e6), *v] for t, *v in rows[1:])]), WarningKind.TIME_UNIT),
]  # fmt: skip


@pytest.mark.parametrize(("feed", "code", "answer"), [row[1:] for row in REFUSED], ids=[row[0] for row in REFUSED])
def test_what_cannot_be_used_is_refused_in_one_line(
    feed: Callable[[Path], Path], code: str, answer: str, tmp_path: Path
) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "work").mkdir()
    path = feed(tmp_path / "in")
    before = sorted(tmp_path.iterdir())
    with pytest.raises(RholocError) as caught:
        list(read_recording(path, workdir=tmp_path / "work").frames.images([0]))
    assert caught.value.code == code
    assert answer in caught.value.message
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 500 + len(str(path))
    assert str(tmp_path) not in caught.value.message.replace(str(path), "")
    assert list((tmp_path / "work").iterdir()) == []
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize(("feed", "kind"), [row[1:] for row in READ], ids=[row[0] for row in READ])
def test_what_can_be_used_all_the_same_is_read_and_reported(
    feed: Callable[[Path], Path], kind: WarningKind, tmp_path: Path
) -> None:
    recording = read_recording(feed(tmp_path))
    assert kind in [warning.kind for warning in recording.warnings]
    assert all("\n" not in warning.text for warning in recording.warnings)
    assert len(list(recording.frames.images([0, 5]))) == 2


MPEG4 = b"\0\0\0\x20ftypisom"
EBML = b"\x1aE\xdf\xa3" + b"\x01" * 8
AVI = b"RIFF\x10\0\0\0AVI "
ZIP = b"PK\x03\x04\x14\0\0\0\0\0\0\0"
JPEG = b"\xff\xd8\xff\xe0\0\x10JFIF\0\1"
PNG = b"\x89PNG\r\n\x1a\n\0\0\0\r"


@pytest.mark.parametrize(
    ("name", "start"),
    [
        ("walk.mp4", MPEG4),
        ("walk.MOV", b"\0\0\0\x08wide\0\0\0\0"),
        ("walk.mov", b"\0\0\x10\0moov\0\0\0\0"),
        ("walk.webm", EBML),
        ("walk.mkv", EBML),
        ("walk.avi", AVI),
        ("walk.zip", ZIP),
        ("frames/0001.jpg", JPEG),
        ("frames/0001.png", PNG),
        ("imu.csv", b"timestamp,ax"),
        ("notes.txt", b""),
    ],
)
def test_files_are_what_they_are_called(name, start):
    assert len(start) in (0, START_BYTES)
    check_file_start(name, start)


@pytest.mark.parametrize(
    ("name", "start"),
    [
        ("walk.mp4", b""),
        ("walk.mp4", b"<html><body>"),
        ("walk.mp4", PNG),
        ("walk.avi", b"RIFF\x10\0\0\0WAVE"),
        ("walk.zip", b"PK\x05\x06" + b"\0" * 8),
        ("frames/0001.png", JPEG),
    ],
)
def test_files_that_are_not_what_they_are_called(name, start):
    with pytest.raises(InvalidRecording, match=name.rsplit("/", 1)[-1]):
        check_file_start(name, start)


def test_a_lone_file_is_a_video_or_a_zip_file():
    for name in ("walk.mp4", "WALK.MOV", "walk.zip"):
        check_file_name(name)
    for name in ("walk", "imu.csv", "walk.mp4.exe", "frame.jpg"):
        with pytest.raises(InvalidRecording):
            check_file_name(name)
