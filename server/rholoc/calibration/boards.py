"""Calibration boards: positions of their corners on the board and in a picture."""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import cv2
import numpy as np

from rholoc.errors import InvalidInput
from rholoc.geometry import ByteArray, FloatArray, IntArray
from rholoc.lazy import lazy

_SIDES = range(3, 51)  # squares or corners along a side that boards have
_LONGER_SIDE_PX = 1280  # larger pictures are searched at this size; corners are then refined at the full one
_MIN_CORNERS = 12
_MIN_SHARE = 0.25  # of the board's corners
_MARKER_SHARE = 0.75  # a marker's side over its square's; what it really is hardly matters, corners are refined
_DICTIONARIES = (
    cv2.aruco.DICT_4X4_1000,
    cv2.aruco.DICT_5X5_1000,
    cv2.aruco.DICT_6X6_1000,
    cv2.aruco.DICT_7X7_1000,
    cv2.aruco.DICT_ARUCO_ORIGINAL,
)


class BoardKind(StrEnum):
    """Pattern printed on a calibration board."""

    CHECKERBOARD = "checkerboard"  # squares alone: it must be in view as a whole
    CHARUCO = "charuco"  # with ArUco markers in the white squares: a part in view is enough


# How far around a corner its edges are looked at, in squares: as far as there is nothing else.
_WINDOW = {BoardKind.CHECKERBOARD: 0.25, BoardKind.CHARUCO: 0.1}


@dataclass(frozen=True)
class Board:
    """A flat board. Its corners lie at z = 0, (x, y) in metres, row by row.

    Attributes:
        kind: its printed pattern.
        columns, rows: numbers of inner corners.
        square_m: side of a square [m].
    """

    kind: BoardKind
    columns: int
    rows: int
    square_m: float

    @classmethod
    def parse(cls, size: str, square_mm: float, kind: BoardKind) -> Board:
        """From ``COLUMNSxROWS`` as boards are sold: inner corners of a checkerboard, squares of a ChArUco board.

        Raises:
            InvalidInput: ``size`` has another form, a side is not 3 to 50, or a square not 0.1 to 10,000 mm.
        """
        match = re.fullmatch(r"(\d{1,3})[x×](\d{1,3})", size.strip().lower())
        if match is None or not all(int(side) in _SIDES for side in match.groups()):
            raise InvalidInput(
                f"'{size}' is not the size of a board.",
                "Give COLUMNSxROWS, such as 9x6: inner corners of a checkerboard, squares of a ChArUco board.",
            )
        if not 0.1 <= square_mm <= 10_000:
            raise InvalidInput(f"A square of {square_mm:g} mm is not a valid size.", "Measure a square's side in mm.")
        columns, rows = (int(side) - (kind is BoardKind.CHARUCO) for side in match.groups())
        return cls(kind, columns, rows, square_mm / 1000)

    @property
    def corners(self) -> FloatArray:
        """Positions (columns · rows, 3) [m] of the inner corners, row by row."""
        rows, columns = np.divmod(np.arange(self.columns * self.rows), self.columns)
        return np.column_stack([columns, rows, np.zeros(len(rows))]) * self.square_m

    @property
    def outline(self) -> FloatArray:
        """Outermost inner corners (4, 2) [m]: (0, 0), (x, 0), (x, y), (0, y)."""
        x, y = (self.columns - 1) * self.square_m, (self.rows - 1) * self.square_m
        return np.array([[0, 0], [x, 0], [x, y], [0, y]], dtype=np.float64)

    def __str__(self) -> str:
        squares = self.kind is BoardKind.CHARUCO
        return f"{self.columns + squares}x{self.rows + squares} {self.kind.value}"


@dataclass(frozen=True, eq=False)
class Sighting:
    """The board as one frame shows it.

    Attributes:
        row: the frame's row in its source.
        corners: (C,) numbers of the board's corners that are seen.
        pixels: (C, 2) their pixels.
        blur_px: width of the edges between black and white.
    """

    row: int
    corners: IntArray
    pixels: FloatArray
    blur_px: float


class BoardFinder:
    """Finds a board in pictures. Of a ChArUco board the first picture that shows it determines the kind of markers."""

    def __init__(self, board: Board) -> None:
        self.board = board

    def find(self, row: int, image: ByteArray) -> Sighting | None:
        """Find the board in an image (H, W, 3) BGR or (H, W) of frame ``row``; None if it is not found.

        A checkerboard must be in view as a whole; a ChArUco board with 12 corners and a quarter of them.
        """
        gray = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image, dtype=np.uint8)
        shrink = min(1.0, _LONGER_SIDE_PX / max(gray.shape))
        small = gray if shrink == 1 else cv2.resize(gray, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA)
        found = self._checkerboard(small) if self.board.kind is BoardKind.CHECKERBOARD else self._charuco(small)
        if found is None:
            return None
        corners, pixels = found
        spacing_px = self._spacing_px(corners, pixels) / shrink
        pixels = _refined(gray, (pixels + 0.5) / shrink - 0.5, _WINDOW[self.board.kind] * spacing_px)
        return Sighting(row, corners, pixels, _blur_px(gray, pixels, spacing_px))

    def _checkerboard(self, gray: Any) -> tuple[IntArray, FloatArray] | None:
        """Numbers (C,) and pixels (C, 2) of all corners; None unless all are found."""
        size = (self.board.columns, self.board.rows)
        found, pixels = cv2.findChessboardCornersSB(gray, size, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
        if not found:
            return None
        return np.arange(size[0] * size[1]), np.asarray(pixels, np.float64).reshape(-1, 2)

    def _charuco(self, gray: Any) -> tuple[IntArray, FloatArray] | None:
        """Numbers (C,) and pixels (C, 2) of the corners found; None if they are too few."""
        fewest = max(_MIN_CORNERS, _MIN_SHARE * self.board.columns * self.board.rows)
        for detector in self._detectors:
            pixels, corners, _, _ = detector.detectBoard(gray)
            if corners is not None and len(corners) >= fewest:
                self._detectors = [detector]
                return np.asarray(corners).ravel(), np.asarray(pixels, np.float64).reshape(-1, 2)
        return None

    @lazy
    def _detectors(self) -> list[Any]:
        """Detectors for each dictionary of markers, with OpenCV's present and its legacy pattern.

        After the first board was found, only the detector that found it.
        """
        size, square = (self.board.columns + 1, self.board.rows + 1), self.board.square_m
        detectors = []
        for number in _DICTIONARIES:
            for is_legacy in (False, True):
                markers = cv2.aruco.getPredefinedDictionary(number)
                board = cv2.aruco.CharucoBoard(size, square, _MARKER_SHARE * square, markers)
                board.setLegacyPattern(is_legacy)
                detectors.append(cv2.aruco.CharucoDetector(board))
        return detectors

    def _spacing_px(self, corners: IntArray, pixels: FloatArray) -> float:
        """Shortest distance [px] of neighbouring corners; inf if none are neighbours."""
        grid = np.full((self.board.rows, self.board.columns, 2), np.nan)
        grid[np.divmod(corners, self.board.columns)] = pixels
        steps = [np.linalg.norm(np.diff(grid, axis=axis), axis=2) for axis in (0, 1)]
        return float(min(np.nanmin(step, initial=np.inf) for step in steps))


def _refined(gray: ByteArray, pixels: FloatArray, window_px: float) -> FloatArray:
    """Corners (C, 2) refined to a fraction of a pixel by the gradients within ``window_px`` of each (cornerSubPix)."""
    half = int(np.clip(window_px, 2, 12))
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 60, 1e-4)
    start = np.ascontiguousarray(pixels[:, None], dtype=np.float32)
    refined = cv2.cornerSubPix(gray, start, (half, half), (-1, -1), criteria)
    return np.asarray(refined, dtype=np.float64).reshape(-1, 2)


def _blur_px(gray: ByteArray, pixels: FloatArray, spacing_px: float) -> float:
    """Width [px] of edges between black and white: contrast over steepest gradient, median of all corners (C, 2)."""
    half = max(2, int(0.3 * spacing_px))
    steepness = np.hypot(cv2.Sobel(gray, cv2.CV_32F, 1, 0, scale=0.125), cv2.Sobel(gray, cv2.CV_32F, 0, 1, scale=0.125))
    widths = []
    for u, v in np.round(pixels).astype(int):
        patch = np.s_[max(v - half, 0) : v + half + 1, max(u - half, 0) : u + half + 1]
        low, high = np.percentile(gray[patch], (10, 90))
        widths.append((high - low) / max(float(np.percentile(steepness[patch], 95)), 1e-3))
    return float(np.median(widths))
