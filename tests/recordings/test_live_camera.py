"""A live camera: the newest frame counts, and one that ends says so. The camera is a stream of motion JPEG."""

import threading
import time
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import cv2
import numpy as np
import pytest

from rholoc.errors import InvalidInput, InvalidRecording
from rholoc.recordings import Recording, read_recording, write_frames_csv
from rholoc.recordings.frames.live_camera import is_live, opened_camera
from rholoc.reports import WarningKind

SIZE = (64, 48)


@contextmanager
def stream(shades, size=SIZE, interval_s=0.02):
    """The address of a camera that shows pictures of these shades of grey, one after the other."""

    class Camera(BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(200)
            self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
            self.end_headers()
            for shade in shades:
                jpeg = cv2.imencode(".jpg", np.full((size[1], size[0], 3), shade, np.uint8))[1].tobytes()
                self.wfile.write(b"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n" % len(jpeg))
                self.wfile.write(jpeg + b"\r\n")
                time.sleep(interval_s)

        def log_message(self, *_):
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Camera)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}/stream.mjpg"
    finally:
        server.shutdown()
        server.server_close()


@pytest.mark.parametrize(
    ("source", "live"),
    [
        ("0", True),
        ("/dev/video2", True),
        ("rtsp://camera/stream", True),
        ("http://camera:81/stream", True),
        ("walk.mp4", False),
        ("walk", False),
        ("/dev/shm/walk.mp4", False),
        ("C:/walk", False),
    ],
)
def test_what_is_a_live_camera(source, live):
    assert is_live(source) == live


def test_its_frames_come_in_order_and_then_it_says_that_it_ended():
    before_s = time.time()
    with stream(range(20, 220, 5)) as address, opened_camera(address) as camera:
        assert camera.size == SIZE
        found = []

        def consume():
            for time_s, image in camera.frames():
                found.append((time_s, int(image.mean())))
                time.sleep(0.05)  # slower than the camera: frames are skipped, not queued

        with pytest.raises(InvalidInput, match="no more pictures"):
            consume()
    times, shades = zip(*found, strict=True)
    assert list(times) == sorted(set(times))
    assert before_s <= times[0] <= time.time()
    assert list(shades) == sorted(set(shades))
    assert len(found) < 40


def test_tiny_pictures_and_no_camera_are_refused():
    with (
        stream([9] * 50, size=(8, 8)) as address,
        pytest.raises((InvalidInput, InvalidRecording), match=r"8×8|gives no pictures"),
        opened_camera(address),
    ):
        pass
    with pytest.raises(InvalidInput, match="cannot be opened"), opened_camera("http://127.0.0.1:9/"):
        pass


def _unused(recording: Recording) -> list[str]:
    return [warning.text for warning in recording.warnings if warning.kind is WarningKind.NOT_USED]


@pytest.fixture
def walk(tmp_path: Path) -> Path:
    """A folder of pictures in which everything is used."""
    folder = tmp_path / "walk"
    (folder / "frames").mkdir(parents=True)
    for number in range(4):
        assert cv2.imwrite(str(folder / "frames" / f"{number}.png"), np.zeros((40, 60, 3), np.uint8))
    write_frames_csv(folder / "frames.csv", np.arange(4), np.arange(4.0))
    for name in ("README.md", ".DS_Store", "camera.json"):
        (folder / name).write_text("{}")
    return folder


def test_a_folder_in_which_everything_is_used_has_no_warning(walk: Path) -> None:
    assert _unused(read_recording(walk)) == []


def test_unknown_files_are_named_and_folders_counted(walk: Path) -> None:
    for name in ("scan.obj", "notes.txt", "audio/a.wav", "audio/b.wav", "depth/0.exr"):
        (walk / name).parent.mkdir(exist_ok=True)
        (walk / name).write_bytes(b"?")
    (text,) = _unused(read_recording(walk))
    assert text.endswith(": audio/ (2 files), depth/0.exr, notes.txt, scan.obj.")


def test_of_many_unknown_files_some_are_named(walk: Path) -> None:
    for number in range(9):
        (walk / f"page{number}.pdf").write_bytes(b"?")
    (text,) = _unused(read_recording(walk))
    assert text.endswith(": page0.pdf, page1.pdf, page2.pdf, page3.pdf and 5 more.")


def test_pictures_that_another_folder_hides_are_named(walk: Path) -> None:
    assert cv2.imwrite(str(walk / "7.png"), np.zeros((40, 60, 3), np.uint8))
    (walk / "frames.csv").unlink()
    (text,) = _unused(read_recording(walk))
    assert text.endswith(": frames/ (4 files).")


def test_a_chosen_part_of_a_recording_names_no_frames_as_unused(walk: Path) -> None:
    assert _unused(read_recording(walk, frames="1:3")) == []
