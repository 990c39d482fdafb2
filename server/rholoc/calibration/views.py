"""Frames → the views of a board that a calibration is made from: sharp ones, and different ones."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from rholoc.calibration.boards import Board, BoardFinder, Sighting
from rholoc.geometry import ByteArray, FloatArray
from rholoc.recordings import FrameSource

_SEARCHED = 160  # frames; more cost time and add little
_SCAN_WIDTH_PX = 320
_MAX_VIEWS = 40
_BLUR_FACTOR = 1.6  # of the sharpest quarter's edges, beyond which a view is blurred
_MIN_DIFFERENCE = 0.03  # of the image's diagonal, between the outlines of two views that are different


@dataclass(frozen=True, eq=False)
class BoardViews:
    """Views of a board found in a recording.

    Attributes:
        searched: number of frames in which the board was searched.
        found: number of frames in which it was found.
        chosen: sharp and different views among these, the sharpest first.
    """

    searched: int
    found: int
    chosen: tuple[Sighting, ...]


def find_views(frames: FrameSource, board: Board, advance: Callable[[], None] = lambda: None) -> BoardViews:
    """Look for the board in the sharpest frame of each of at most 160 stretches, and choose views.

    Args:
        frames: frames of the recording; all are decoded once.
        board: the board.
        advance: called after each frame.

    Raises:
        InvalidRecording: a frame cannot be decoded.
    """
    finder = BoardFinder(board)
    searched = list(_sharpest(frames, advance, lambda row, image: finder.find(row, image)))
    found = [sighting for sighting in searched if sighting is not None]
    return BoardViews(len(searched), len(found), choose_views(found, board, frames.size))


def choose_views(found: Sequence[Sighting], board: Board, size: tuple[int, int]) -> tuple[Sighting, ...]:
    """At most 40 sharp and different views: the sharpest, then repeatedly the one that differs most from all chosen.

    Sharp: blur up to 1.6 × its 25th percentile. Different: the board's outline is at least 3 % of the diagonal of
    ``size`` (width, height) from all chosen ones, in the mean over its corners.
    """
    if not found:
        return ()
    blur = np.array([sighting.blur_px for sighting in found])
    sharp = [found[i] for i in np.argsort(blur, kind="stable") if blur[i] <= _BLUR_FACTOR * np.percentile(blur, 25)]
    outlines = np.array([outline(sighting, board) for sighting in sharp]) / np.hypot(*size)
    chosen = [0]
    nearest = np.full(len(sharp), np.inf)
    while len(chosen) < _MAX_VIEWS:
        apart = np.linalg.norm(outlines - outlines[chosen[-1]], axis=2).mean(axis=1)
        nearest = np.minimum(nearest, apart)
        if nearest.max() < _MIN_DIFFERENCE:
            break
        chosen.append(int(nearest.argmax()))
    return tuple(sharp[i] for i in chosen)


def outline(sighting: Sighting, board: Board) -> FloatArray:
    """Pixels (4, 2) of :attr:`Board.outline`, by the board's homography, whether they are in view or not."""
    H, _ = cv2.findHomography(board.corners[sighting.corners, :2], sighting.pixels)
    return np.asarray(cv2.perspectiveTransform(board.outline[None], H)[0])


def _sharpest(
    frames: FrameSource,
    advance: Callable[[], None],
    look: Callable[[int, ByteArray], Sighting | None],
) -> Iterator[Sighting | None]:
    """Iterate over ``look(row, image)`` of the sharpest frame of each of at most 160 equal parts of the recording."""
    count = len(frames.times)
    stretch = np.arange(count) * min(count, _SEARCHED) // count
    best: tuple[float, int, ByteArray] | None = None
    for row, image in enumerate(frames.images(range(count))):
        if best is not None and stretch[row] != stretch[best[1]]:
            yield look(*best[1:])
            best = None
        sharpness = _sharpness(image)
        if best is None or sharpness > best[0]:
            best = (sharpness, row, image)
        advance()
    if best is not None:
        yield look(*best[1:])


def _sharpness(image: ByteArray) -> float:
    """Variance of the Laplacian of an image (H, W, 3) or (H, W), resized to a width of 320 px."""
    height, width = image.shape[:2]
    size = (_SCAN_WIDTH_PX, max(1, round(height * _SCAN_WIDTH_PX / width)))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return float(cv2.Laplacian(small, cv2.CV_32F).var())
