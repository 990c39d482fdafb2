"""Frames of a video file."""

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import cv2
import numpy as np

from rholoc.errors import InvalidRecording
from rholoc.geometry import ByteArray, FloatArray, IntArray

VIDEO_SUFFIXES = frozenset({".mp4", ".mov", ".m4v", ".webm", ".mkv", ".avi"})
_INDEXED_SUFFIXES = VIDEO_SUFFIXES - {".webm", ".mkv"}  # of these the number of frames is estimated from the length

MIN_FRAME_SIDE = 16
MAX_FRAME_PIXELS = 7680 * 4320

# Decoders write errors about damaged files to stderr; our own error suffices.
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # AV_LOG_QUIET; read when the first video is opened
cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)

_max_frame_pixels: ContextVar[int] = ContextVar("max_frame_pixels", default=MAX_FRAME_PIXELS)

_HINT = "Record again as MP4 (H.264 or HEVC) or WebM, and let the recorder finish the file."


@contextmanager
def frame_pixels_limited(most: int) -> Iterator[None]:
    """Within the block, lower the maximum number of pixels of a frame from 8K to ``most``."""
    token = _max_frame_pixels.set(most)
    try:
        yield
    finally:
        _max_frame_pixels.reset(token)


@dataclass(frozen=True, eq=False)
class VideoFrames:
    """The frames of a video file, see :class:`rholoc.recordings.FrameSource`; numbers are 0..N-1.

    A phone's rotation flag is applied. ``announced`` is the number of frames by the file's index, 0 where it has none.
    """

    timed: ClassVar[bool] = True  # a video file has a clock

    path: Path
    times: FloatArray
    size: tuple[int, int]
    announced: int = 0

    @property
    def numbers(self) -> IntArray:
        """(N,) int64, 0..N-1."""
        return np.arange(len(self.times))

    def images(self, rows: Sequence[int]) -> Iterator[ByteArray]:
        """The images (H, W, 3) BGR of the rows, which must increase; the file is decoded from its start.

        Raises:
            InvalidRecording: a frame cannot be decoded.
            ValueError: rows do not increase.
        """
        with _opened(self.path) as capture:
            position = -1
            for row in rows:
                if row <= position:
                    raise ValueError("rows must increase")
                while position < row and capture.grab():
                    position += 1
                decoded, image = capture.retrieve() if position == row else (False, None)
                if not decoded or image is None:
                    raise InvalidRecording(f"Frame {row} of {self.path.name} cannot be decoded.", _HINT)
                yield np.asarray(image, dtype=np.uint8)


def read_video(path: Path) -> VideoFrames:
    """Open a video file; times are the container's, at its resolution.

    Decodes the whole file once, because the number of frames and the times declared by containers are unreliable.
    Damage that the decoder conceals is not detected; a file that ends early has fewer frames than ``announced``.

    Raises:
        InvalidRecording: the file cannot be opened (such as a truncated MP4), has no frames, or times that do not
            increase.
    """
    times: list[float] = []
    size: tuple[int, int] | None = None
    with _opened(path) as capture:
        announced = int(capture.get(cv2.CAP_PROP_FRAME_COUNT)) if path.suffix.lower() in _INDEXED_SUFFIXES else 0
        width, height = (int(capture.get(side)) for side in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
        check_frame_size(path.name, width, height)
        while capture.grab():
            if size is None:
                size = _retrieved_size(capture)
            times.append(capture.get(cv2.CAP_PROP_POS_MSEC) / 1000)
    if size is None:
        raise InvalidRecording(f"{path.name} has no frames that can be decoded.", _HINT)
    array = np.array(times)
    if not np.isfinite(array).all() or np.any(np.diff(array) <= 0):
        raise InvalidRecording(f"The frame times of {path.name} do not increase.", _HINT)
    return VideoFrames(path, array, size, announced)


def _retrieved_size(capture: cv2.VideoCapture) -> tuple[int, int] | None:
    """Width and height of the frame that was grabbed last; None if it cannot be decoded."""
    decoded, image = capture.retrieve()
    return (image.shape[1], image.shape[0]) if decoded and image is not None else None


def check_frame_size(name: str, width: int, height: int) -> None:
    """Check the size of a file's frames.

    Raises:
        InvalidRecording: a side is shorter than 16 pixels, or there are more pixels than 8K or
            :func:`frame_pixels_limited` allow.
    """
    most, size = _max_frame_pixels.get(), f"The frames of {name} have {width}×{height} pixels"
    if min(width, height) < MIN_FRAME_SIDE:
        raise InvalidRecording(
            f"{size}: too few to recognise anything.", f"At least {MIN_FRAME_SIDE} a side are needed."
        )
    if width * height > most:
        raise InvalidRecording(f"{size}; at most {most:,} are allowed.", "Record at 1080p, or scale the pictures down.")


@contextmanager
def _opened(path: Path) -> Iterator[cv2.VideoCapture]:
    """Open a video for the block. Raises InvalidRecording if it cannot be opened."""
    capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    try:
        if not capture.isOpened():
            raise InvalidRecording(f"{path.name} is not a video that can be opened.", _HINT)
        yield capture
    finally:
        capture.release()
