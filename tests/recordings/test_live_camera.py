"""A live camera: the newest frame counts, and one that ends says so. The camera is a stream of motion JPEG."""

from __future__ import annotations

import threading
import time
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import cv2
import numpy as np
import pytest

from rholoc.errors import InvalidInput, InvalidRecording
from rholoc.recordings.frames.live_camera import is_live, opened_camera

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
