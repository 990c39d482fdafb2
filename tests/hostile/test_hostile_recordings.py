"""Recordings that are small to send and large to read: refused in one line, before memory is taken for them."""

import io
import json
import math
import struct
import tracemalloc
import zipfile
from pathlib import Path

import cv2
import httpx
import numpy as np
import pytest

from rholoc.errors import InvalidCamera, InvalidRecording, InvalidWaypoints, TooLarge
from rholoc.jobs import JobOptions
from rholoc.jobs.leases import Lease, shortened
from rholoc.jobs.table import JobWork
from rholoc.library.maps import MapLibrary
from rholoc.library.recordings import RecordingStore
from rholoc.library.stores import Stores
from rholoc.processes.limits import Limits, machine_memory_bytes
from rholoc.progress import ProgressListener, silent
from rholoc.recordings import check_archive, frame_pixels_limited, read_recording
from rholoc.recordings.archive import unpack
from rholoc.recordings.tables.csv_table import read_numbers
from rholoc.recordings.tables.logged_table import read_logged_table
from rholoc.service import Settings
from rholoc.worker.build_process import build_in_process, run_build
from rholoc.worker.job_folders import JobFolders
from rholoc.worker.pipeline import MappingPipeline, MappingTask

IMU_HEADER = "timestamp,ax,ay,az,gx,gy,gz\n"


def write_images(folder: Path, count: int = 3, size: tuple[int, int] = (64, 48)) -> Path:
    (folder / "frames").mkdir(parents=True)
    for number in range(count):
        cv2.imwrite(str(folder / "frames" / f"{number:04}.png"), np.zeros((size[1], size[0], 3), np.uint8))
    return folder


def imu_rows(times: np.ndarray) -> str:
    return IMU_HEADER + "".join(f"{time:.6f},0.1,0.2,9.8,0.01,0.02,0.03\n" for time in times)


def test_one_wrong_time_does_not_stand_for_years_of_samples(tmp_path):
    write_images(tmp_path / "walk")
    times = np.concatenate([np.arange(100) / 100, 1e9 + np.arange(100) / 100])
    (tmp_path / "walk" / "imu.csv").write_text(imu_rows(times))
    with pytest.raises(InvalidRecording, match="span"):
        read_recording(tmp_path / "walk")


def test_a_frame_of_another_century_is_refused(tmp_path):
    write_images(tmp_path / "walk")
    (tmp_path / "walk" / "frames.csv").write_text("frame,timestamp\n0,0\n1,0.1\n2,1e12\n")
    with pytest.raises(InvalidRecording, match="span"):
        read_recording(tmp_path / "walk")


@pytest.mark.slow
def test_a_table_takes_the_memory_of_its_numbers(tmp_path):
    path = tmp_path / "imu.csv"
    path.write_text(imu_rows(np.arange(20_000) / 200))
    numbers_bytes = 20_000 * 7 * 8
    tracemalloc.start()
    try:
        table = read_numbers(path, IMU_HEADER.strip().split(","))
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert len(table["az"]) == 20_000
    assert peak < 3 * numbers_bytes


@pytest.mark.parametrize("reader", ["own", "logged"])
def test_a_table_has_a_limit_of_rows(tmp_path, monkeypatch, reader):
    for module in ("csv_table", "logged_table"):
        monkeypatch.setattr(f"rholoc.recordings.tables.{module}.MAX_TABLE_ROWS", 10)
    path = tmp_path / "imu.csv"
    path.write_text(imu_rows(np.arange(11) / 100))
    with pytest.raises(InvalidRecording, match="more than 10 rows"):
        read_numbers(path, ["ax"]) if reader == "own" else read_logged_table(path)
    path.write_text(imu_rows(np.arange(10) / 100))
    assert len(read_numbers(path, ["ax"])["ax"]) == len(read_logged_table(path)) == 10


@pytest.mark.parametrize("content", ["[" * 100_000 + "]" * 100_000, '{"fx": ' + "[" * 100_000 + "]" * 100_000 + "}"])
def test_a_camera_file_nested_beyond_reason_is_refused_in_one_line(tmp_path, content):
    write_images(tmp_path / "walk")
    (tmp_path / "walk" / "camera.json").write_text(content)
    with pytest.raises(InvalidCamera, match="nested too deep"):
        read_recording(tmp_path / "walk")


def test_a_camera_file_is_small_and_is_quoted_briefly(tmp_path):
    write_images(tmp_path / "walk")
    camera = tmp_path / "walk" / "camera.json"
    camera.write_text(json.dumps({"note": "x" * 2**21}))
    with pytest.raises(InvalidCamera, match="larger than 1 MiB"):
        read_recording(tmp_path / "walk")
    camera.write_text(json.dumps({"fps": "x" * 100_000}))
    with pytest.raises(InvalidCamera) as caught:
        read_recording(tmp_path / "walk")
    assert len(str(caught.value)) < 500


@pytest.mark.parametrize("size", [(3000, 8), (8, 3000)])
def test_a_video_of_absurd_dimensions_is_refused_by_its_header(tmp_path, size, monkeypatch):
    path = tmp_path / "walk.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 30, size)
    for _ in range(3):
        writer.write(np.zeros((size[1], size[0], 3), np.uint8))
    writer.release()
    with pytest.raises(InvalidRecording, match=f"{size[0]}×{size[1]} pixels"):
        read_recording(path)


def test_a_video_of_too_many_pixels_is_refused_before_a_frame_is_decoded(tmp_path, monkeypatch):
    path = tmp_path / "walk.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 30, (640, 480))
    writer.write(np.zeros((480, 640, 3), np.uint8))
    writer.release()
    with frame_pixels_limited(640 * 480):
        assert read_recording(path).frames.size == (640, 480)
    monkeypatch.setattr("rholoc.recordings.frames.video._retrieved_size", lambda _: pytest.fail("decoded"))
    with pytest.raises(InvalidRecording, match="pixels"), frame_pixels_limited(640 * 480 - 1):
        read_recording(path)


def test_the_pixels_of_a_video_are_a_setting_of_the_service(tmp_path):
    path = tmp_path / "walk.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 30, (640, 480))
    writer.write(np.zeros((480, 640, 3), np.uint8))
    writer.release()
    limits = Settings(max_video_pixels=1000).worker_setup.limits
    stores = Stores(tmp_path / "maps", tmp_path / "data")
    folders = JobFolders(stores, limits.frame_pixels)
    stored = stores.recordings.create([(path.name, [path.read_bytes()])]).id
    task = folders.task(Lease("0" * 32, "run", 1), JobWork(stored, "room", JobOptions()), math.inf)
    with pytest.raises(InvalidRecording, match="at most 1,000"):
        MappingPipeline().build(task, lambda *_: None)


_SLOW = pytest.mark.slow


@pytest.mark.parametrize(
    "size", [pytest.param((100_000, 10), marks=_SLOW), (10, 100_000), pytest.param((40_000, 1000), marks=_SLOW)]
)
def test_a_video_of_a_size_beyond_reason_fails_its_job_in_one_line(tmp_path, size):
    path = tmp_path / "walk.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"FFV1"), 30, size)
    writer.write(np.zeros((size[1], size[0], 3), np.uint8))
    writer.release()
    task = MappingTask(path, tmp_path / "map.rho", tmp_path, "room", JobOptions())
    failure = run_build(MappingPipeline(), task, Limits(), silent)
    assert failure.code == "invalid_recording"
    assert len(failure.message) < 500


def test_a_job_of_a_camera_file_nested_beyond_reason_fails_in_one_line(tmp_path):
    folder = write_images(tmp_path / "walk")
    (folder / "camera.json").write_text('{"fx": ' + "[" * 10**5 + "]" * 10**5 + "}")
    task = MappingTask(folder, tmp_path / "map.rho", tmp_path, "room", JobOptions())
    assert run_build(MappingPipeline(), task, Limits(), silent).code == "invalid_camera"


def test_pictures_of_absurd_dimensions_are_refused(tmp_path):
    with pytest.raises(InvalidRecording, match="8×4000 pixels"):
        read_recording(write_images(tmp_path / "walk", size=(8, 4000)))


def waypoints(tmp_path: Path, names: list[str]) -> Path:
    write_images(tmp_path / "walk")
    first = read_recording(tmp_path / "walk").frames.numbers[0]
    rows = "".join(f"{name},{first},{i},0,1.5\n" for i, name in enumerate(names))
    (tmp_path / "walk" / "waypoints.csv").write_text("name,frame,x,y,z\n" + rows)
    return tmp_path / "walk"


def test_waypoints_are_few_and_have_short_names(tmp_path):
    for count in (1001, 5000):
        with pytest.raises(InvalidWaypoints, match="more than 1000 rows") as caught:
            read_recording(waypoints(tmp_path / str(count), [f"W{i}" for i in range(count)]))
        assert len(str(caught.value)) < 500
    with pytest.raises(InvalidWaypoints, match="not a valid waypoint name") as caught:
        read_recording(waypoints(tmp_path / "b", ["W1", "W2", "x" * 100_000]))
    assert len(str(caught.value)) < 500


def test_a_message_does_not_repeat_every_waypoint(tmp_path):
    with pytest.raises(InvalidWaypoints, match="and 490 more") as caught:
        read_recording(waypoints(tmp_path, [f"repeated-{i % 495}" for i in range(990)]))
    assert len(str(caught.value)) < 500


def packed(path: Path, entries: dict[str, bytes]) -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in entries.items():
            archive.writestr(name, content)
    return path


def test_the_entries_of_a_zip_file_are_counted_before_they_are_read(tmp_path, monkeypatch):
    path = packed(tmp_path / "walk.zip", {f"folder-{i}/": b"" for i in range(300)})
    check_archive(path, max_files=300)
    monkeypatch.setattr("zipfile.ZipFile.__init__", lambda *_args, **_options: pytest.fail("read"))
    for look in (lambda: check_archive(path, max_files=299), lambda: unpack(path, tmp_path, max_files=299)):
        with pytest.raises(TooLarge, match="more than 299"):
            look()


def test_a_zip_file_that_understates_its_entries_is_counted_all_the_same(tmp_path):
    path = packed(tmp_path / "walk.zip", {f"folder-{i}/": b"" for i in range(300)})
    content = bytearray(path.read_bytes())
    end = content.rfind(b"PK\x05\x06")
    content[end + 8 : end + 12] = struct.pack("<HH", 1, 1)
    path.write_bytes(content)
    with pytest.raises(TooLarge):
        check_archive(path, max_files=100)


def test_a_zip_file_with_a_long_comment_and_zip64_records_is_read(tmp_path):
    path = tmp_path / "walk.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.comment = b"c" * 60_000
        with archive.open("imu.csv", "w", force_zip64=True) as file:
            file.write(IMU_HEADER.encode())
    check_archive(path, max_files=1)
    with pytest.raises(TooLarge):
        check_archive(path, max_files=0)


@pytest.mark.parametrize("how", ["checked", "unpacked"])
def test_a_file_in_a_zip_file_is_what_its_name_says(tmp_path, how):
    listing = b"ffconcat version 1.0\nfile /etc/hostname\n"
    path = packed(tmp_path / "walk.zip", {"video.mp4": listing, "imu.csv": b"x"})
    with pytest.raises(InvalidRecording, match=r"video\.mp4 is not a MP4 file"):
        check_archive(path) if how == "checked" else unpack(path, tmp_path)
    assert not (tmp_path / "video.mp4").exists()


def test_the_limit_of_files_holds_for_zip_files_too(serve, tmp_path):
    running = serve(max_upload_files=20)
    path = packed(tmp_path / "walk.zip", {f"{i}.csv": b"x" for i in range(30)})
    files, fields = {"file": ("walk.zip", path.read_bytes())}, {"map": "room"}
    answer = httpx.post(f"{running.url}/v1/recordings", files=files, data=fields)
    assert (answer.status_code, answer.json()["code"]) == (413, "too_large")


def test_many_small_files_are_stored_without_counting_them_again(tmp_path):
    with RecordingStore(tmp_path).begin(max_bytes=10**6) as pending:
        sizes = pending._sizes = CountingDict()
        for number in range(50):
            pending.write(f"{number}.csv", b"x")
        assert pending.size_bytes == 50
        assert sizes.walked == 0


class CountingDict(dict):
    walked = 0

    def values(self):
        self.walked += 1
        return super().values()


class GreedyPipeline:
    """A build that asks for more memory than there is, at once."""

    def build(self, task: MappingTask, progress: ProgressListener) -> None:
        np.ones(2**40, np.uint8)

    def publish(self, task: MappingTask, library: MapLibrary) -> tuple[str, ...]:
        return ()


@pytest.mark.slow
def test_a_build_that_asks_for_too_much_memory_fails_for_that_reason(tmp_path):
    task = MappingTask(tmp_path / "walk.mp4", tmp_path / "map.rho", tmp_path, "room", JobOptions())
    limits = Limits(memory_bytes=2**31)
    failure = build_in_process(GreedyPipeline(), task, silent, lambda: None, 0.1, 0.1, limits).failure
    assert (failure.code, "RHOLOC_JOB_MEMORY_GIB" in failure.hint) == ("mapping_failed", True)


def test_jobs_are_limited_by_default():
    limits = Settings().worker_setup.limits
    assert 3600 <= limits.time_s <= 24 * 3600
    assert limits.memory_bytes == pytest.approx(0.75 * machine_memory_bytes())
    machine_kib = int(Path("/proc/meminfo").read_text().split()[1])
    assert machine_memory_bytes() <= 1024 * machine_kib * 1.01


def test_what_a_job_says_is_short_and_well_formed():
    assert shortened("a line") == "a line"
    assert len(shortened("x" * 10**6)) == 500
    assert shortened("odd \ud800") == "odd ?"
    assert io.StringIO(shortened("a" * 499 + "é…")).read().endswith("…")
