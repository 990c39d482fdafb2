"""Corners tracked through every frame of a recording: pyramidal Lucas–Kanade flow, checked forward and backward."""

import itertools
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import cv2
import numpy as np

from rholoc.geometry import BoolArray, ByteArray, Camera, FloatArray, IntArray
from rholoc.progress import ProgressListener, Stage, silent
from rholoc.recordings import FrameSource

_LONGER_SIDE_PX = 640  # larger images are reduced: corners are tracked no better in more pixels
_SHARPNESS_SIDE_PX = 320
_CONTRAST_SIDE_PX = 64
_CORNERS = 350  # tracked at a time; …
_REFILLED_BELOW = 0.8  # … new ones are added when this share is left
_CORNER_QUALITY = 0.005
_CORNER_DISTANCE_PX = 14
_BORDER_PX = 4
_WINDOW_PX = 21
_LEVELS = 3
_MIN_EIGENVALUE = 1e-4
_MAX_RETURN_PX = 0.7  # forward-backward error
_MIN_TRACKED = 8
_LOST_MOTION = 0.05  # assumed if nothing can be tracked, as a share of the image's longer side
_FORWARD_STOP = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 20, 0.03)
_BACKWARD_STOP = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 10, 0.03)
_IN_FLIGHT = 6


@dataclass(frozen=True, eq=False)
class Flow:
    """Tracked corners in N frames.

    Attributes:
        times: (N,) seconds.
        size: of the images, width and height in pixels.
        starts: (N + 1,) the corners of frame n are rows starts[n] : starts[n + 1] of ``tracks`` and ``pixels``.
        tracks: (M,) corner numbers, increasing within a frame.
        pixels: (M, 2) of the full image.
        motion: (N,) image motion since the frame before, as a share of the longer side; for a wide lens, of the longer
            side of an ordinary picture.
        sharpness: (N,) the variance of the Laplacian.
        brightness: (N,) the mean grey value, 0..255.
        contrast: (N,) the standard deviation of the grey values, blurred to remove noise.
        timed: whether the times were measured; otherwise they are rows.
        frame_numbers: (N,) frame numbers known to users, or None.
    """

    times: FloatArray
    size: tuple[int, int]
    starts: IntArray
    tracks: IntArray
    pixels: FloatArray
    motion: FloatArray
    sharpness: FloatArray
    brightness: FloatArray
    contrast: FloatArray
    timed: bool = True
    frame_numbers: IntArray | None = None

    @property
    def numbers(self) -> IntArray:
        """Frame numbers (N,) known to users; rows if none were given."""
        return np.arange(len(self.times)) if self.frame_numbers is None else self.frame_numbers

    @property
    def shared_with_next(self) -> IntArray:
        """Number (N - 1,) of corners that each frame shares with the next."""
        frames = [self.of_frame(row)[0] for row in range(len(self.times))]
        pairs = itertools.pairwise(frames)
        return np.array([len(np.intersect1d(a, b, assume_unique=True)) for a, b in pairs], dtype=np.int64)

    def of_frame(self, row: int) -> tuple[IntArray, FloatArray]:
        """Numbers (K,) and pixels (K, 2) of a frame's corners."""
        here = slice(self.starts[row], self.starts[row + 1])
        return self.tracks[here], self.pixels[here]

    def shared(self, a: int, b: int) -> tuple[IntArray, FloatArray, FloatArray]:
        """Numbers (K,) of the corners tracked from frame ``a`` to ``b``, and their pixels (K, 2) in both."""
        (tracks_a, pixels_a), (tracks_b, pixels_b) = self.of_frame(a), self.of_frame(b)
        shared, in_a, in_b = np.intersect1d(tracks_a, tracks_b, assume_unique=True, return_indices=True)
        return shared, pixels_a[in_a], pixels_b[in_b]


FrameListener = Callable[[int, ByteArray, float, float], None]
"""Is shown a frame: its row, its image (H, W, 3) BGR, its motion and its sharpness."""


def track_corners(
    frames: FrameSource,
    progress: ProgressListener = silent,
    show: FrameListener | None = None,
    camera: Camera | None = None,
    may_be_film: bool = True,
) -> Flow:
    """Track corners through all frames; each is decoded once and passed to ``show``.

    ``camera`` is needed for wide lenses, to express motion in longer sides of an ordinary picture. Without
    ``may_be_film`` no corners are tracked, and every frame counts as moved by a keyframe's step.

    Raises:
        InvalidRecording: a frame cannot be decoded.
        Cancelled: ``progress`` asked to stop.
    """
    count, breadth = len(frames.times), 1.0 if camera is None else camera.breadth
    most_corners = round(_CORNERS * breadth) if may_be_film else 0
    motion, sharpness, brightness, contrast = np.zeros((4, count))
    tracks: list[IntArray] = []
    pixels: list[FloatArray] = []
    corners, numbers, next_number = np.zeros((0, 2), np.float32), np.zeros(0, np.int64), 0
    before: ByteArray | None = None
    for row, (whole, image, factor, sharpness[row]) in enumerate(_looked_at(frames, breadth)):
        brightness[row] = float(image.mean())
        contrast[row] = float(_reduced(image, _CONTRAST_SIDE_PX).std())
        if before is not None:
            corners, kept, moved = _followed(before, image, corners)
            motion[row] = breadth * moved
            numbers = numbers[kept]
        if len(corners) < _REFILLED_BELOW * most_corners:
            found = _new_corners(image, corners, most_corners)
            corners = np.concatenate([corners, found])
            numbers = np.concatenate([numbers, np.arange(next_number, next_number + len(found))])
            next_number += len(found)
        tracks.append(numbers)
        pixels.append((corners.astype(np.float64) + 0.5) * factor - 0.5)
        before = image
        if show is not None:
            show(row, whole, float(motion[row]), float(sharpness[row]))
        progress(Stage.KEYFRAMES, (row + 1) / count, f"{row + 1} of {count} frames looked at")
    starts = np.concatenate([[0], np.cumsum([len(some) for some in tracks])])
    return Flow(
        frames.times,
        frames.size,
        starts,
        np.concatenate(tracks),
        np.concatenate(pixels),
        motion,
        sharpness,
        brightness,
        contrast,
        frames.timed,
        frames.numbers,
    )


_Seen = tuple[ByteArray, ByteArray, FloatArray, float]  # as :func:`_look` returns it


def _looked_at(frames: FrameSource, breadth: float = 1.0) -> Iterator[_Seen]:
    """Iterate over every frame: whole, reduced in grey, factors (2,) to full-image pixels, and sharpness. A thread
    prepares the next frames while this one's corners are tracked.
    """
    with ThreadPoolExecutor(1) as pool:
        waiting: list[Future[_Seen]] = []
        for image in frames.images(range(len(frames.times))):
            waiting.append(pool.submit(_look, image, breadth))
            if len(waiting) > _IN_FLIGHT:
                yield waiting.pop(0).result()
        for future in waiting:
            yield future.result()


def _look(image: ByteArray, breadth: float = 1.0) -> _Seen:
    """The image, a reduced grey one, factors (2,) from that to the image's pixels, and sharpness."""
    gray = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image, dtype=np.uint8)
    small = _reduced(gray, round(_LONGER_SIDE_PX * breadth))
    factor = np.array([gray.shape[1] / small.shape[1], gray.shape[0] / small.shape[0]])
    sharpness = float(cv2.Laplacian(_reduced(gray, _SHARPNESS_SIDE_PX), cv2.CV_32F).var())
    return image, small, factor, sharpness


def _reduced(gray: ByteArray, longer_side_px: int) -> ByteArray:
    """Grey image (H, W), shrunk to this longer side if it is larger."""
    height, width = gray.shape
    scale = longer_side_px / max(height, width)
    if scale >= 1:
        return np.asarray(gray, dtype=np.uint8)
    size = (round(width * scale), round(height * scale))
    return np.asarray(cv2.resize(gray, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _followed(before: ByteArray, image: ByteArray, corners: FloatArray) -> tuple[FloatArray, BoolArray, float]:
    """Track corners (K, 2) into the next image: those found, a mask (K,) of them, and the median motion. The motion is
    a share of the longer side; 0.05 if fewer than eight are found.
    """
    if len(corners) == 0:
        return corners, np.zeros(0, dtype=np.bool_), _LOST_MOTION
    moved, is_moved = _flow(before, image, corners, None, _LEVELS, _FORWARD_STOP)
    back, is_back = _flow(image, before, moved, corners, 1, _BACKWARD_STOP)
    height, width = image.shape
    inside = np.all((moved >= _BORDER_PX) & (moved < (width - _BORDER_PX, height - _BORDER_PX)), axis=1)
    kept = is_moved & is_back & inside & (np.linalg.norm(back - corners, axis=1) < _MAX_RETURN_PX)
    if kept.sum() < _MIN_TRACKED:
        return moved[kept], kept, _LOST_MOTION
    motion = float(np.median(np.linalg.norm(moved[kept] - corners[kept], axis=1))) / max(height, width)
    return moved[kept], kept, motion


def _flow(
    before: ByteArray,
    after: ByteArray,
    corners: FloatArray,
    guess: FloatArray | None,
    levels: int,
    stop: tuple[int, int, float],
) -> tuple[FloatArray, BoolArray]:
    """New positions (K, 2) of corners (K, 2), searched from ``guess`` (K, 2) or these; a mask (K,) of those found."""
    flags = 0 if guess is None else cv2.OPTFLOW_USE_INITIAL_FLOW
    start = None if guess is None else guess.reshape(-1, 1, 2).copy()
    moved, found, _ = cv2.calcOpticalFlowPyrLK(
        before,
        after,
        corners.reshape(-1, 1, 2),
        start,  # type: ignore[arg-type]
        winSize=(_WINDOW_PX, _WINDOW_PX),
        maxLevel=levels,
        criteria=stop,
        flags=flags,
        minEigThreshold=_MIN_EIGENVALUE,
    )
    return np.asarray(moved.reshape(-1, 2)), np.asarray(found.ravel() == 1)


def _new_corners(image: ByteArray, corners: FloatArray, most: int = _CORNERS) -> FloatArray:
    """New corners (K, 2) away from the tracked ones, to fill up to ``most``."""
    free = np.full(image.shape, 255, dtype=np.uint8)
    for x, y in corners.tolist():
        cv2.circle(free, (int(x), int(y)), _CORNER_DISTANCE_PX, 0, -1)
    found = cv2.goodFeaturesToTrack(
        image, most - len(corners), _CORNER_QUALITY, _CORNER_DISTANCE_PX, mask=free, blockSize=5
    )
    return np.zeros((0, 2), np.float32) if found is None else found.reshape(-1, 2).astype(np.float32)
