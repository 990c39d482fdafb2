"""The frames of a live camera: a device, or a stream from the network."""

import re
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import cv2
import numpy as np

from rholoc.errors import InvalidInput
from rholoc.geometry import ByteArray
from rholoc.recordings.frames.video import check_frame_size

_SILENCE_S = 5.0
_DEVICE = re.compile(r"\d+|/dev/video\d+")
_ADDRESS = re.compile(r"[a-z]+://.+")


def is_live(source: str) -> bool:
    """Whether a text names a live camera: a number, ``/dev/video0``, or an address such as ``rtsp://…``."""
    return bool(_DEVICE.fullmatch(source) or _ADDRESS.fullmatch(source))


class LiveCamera:
    """A live camera. A thread reads its frames, and keeps only the newest: a slow consumer skips frames.

    Attributes:
        size: width and height in pixels.
    """

    def __init__(self, source: str, capture: cv2.VideoCapture) -> None:
        self._source, self._capture = source, capture
        self._arrived = threading.Condition()
        self._newest: tuple[float, ByteArray] | None = None
        self._ended = False
        # The wall clock, but steady: it must not jump within a track.
        self._clock_s = time.time() - time.monotonic()
        found, image = capture.read()
        if not found:
            raise InvalidInput(f"The camera {_shown(source)} gives no pictures.", "Check that nothing else uses it.")
        self.size = (image.shape[1], image.shape[0])
        check_frame_size(_shown(source), *self.size)
        self._reader = threading.Thread(target=self._read, daemon=True)

    def frames(self) -> Iterator[tuple[float, ByteArray]]:
        """Iterate over arrival time [s, Unix epoch] and image (H, W, 3) BGR of the newest frame, each at most once.
        Call it once.

        Raises:
            InvalidInput: no frame has arrived for five seconds, or the camera or stream has ended.
        """
        self._reader.start()
        while True:
            with self._arrived:
                self._arrived.wait_for(lambda: self._newest is not None or self._ended, _SILENCE_S)
                newest, self._newest = self._newest, None
            if newest is None:
                message = f"The camera {_shown(self._source)} gives no more pictures."
                raise InvalidInput(message, "Check its cable, or its address.")
            yield newest

    def _read(self) -> None:
        """The thread: replace the newest frame until stopped, the camera fails, or a frame has another size."""
        last_s = 0.0
        while not self._ended:
            found, image = self._capture.read()
            with self._arrived:
                last_s = max(self._clock_s + time.monotonic(), last_s + 1e-6)
                if found and image.shape[1::-1] == self.size:
                    self._newest = last_s, np.asarray(image, dtype=np.uint8)
                else:
                    self._ended = True
                self._arrived.notify()

    def stop(self) -> bool:
        """Stop reading, waiting up to five seconds. Returns False if the camera still keeps its reader waiting."""
        self._ended = True
        if self._reader.is_alive():
            self._reader.join(_SILENCE_S)
        return not self._reader.is_alive()


@contextmanager
def opened_camera(source: str) -> Iterator[LiveCamera]:
    """Open the live camera ``source``, see :func:`is_live`, for the block.

    Raises:
        InvalidInput: there is no such camera, or it gives no pictures.
        InvalidRecording: its pictures have a side below 16 px, or more than 8K pixels.
    """
    capture = cv2.VideoCapture(int(source)) if source.isdecimal() else cv2.VideoCapture(source)
    if not capture.isOpened():
        message = f"The camera {_shown(source)} cannot be opened."
        raise InvalidInput(message, "Check its number (see /dev/video*), or its address, and your permissions.")
    camera = LiveCamera(source, capture)
    try:
        yield camera
    finally:
        if camera.stop():  # what is being read must not be released
            capture.release()


def _shown(source: str) -> str:
    """The source without user name and password."""
    return re.sub(r"//[^/@]*@", "//", source)
