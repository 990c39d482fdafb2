"""Views of a board → the camera, its uncertainty, and whether it is good enough.

Pinholes by Zhang's method (2000, with OpenCV), fisheyes by :mod:`rholoc.calibration.fisheye`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from rholoc.calibration.boards import Board, BoardKind, Sighting
from rholoc.calibration.fisheye import solve_fisheye
from rholoc.calibration.views import BoardViews, find_views
from rholoc.errors import InvalidCamera, InvalidInput, InvalidRecording
from rholoc.geometry import BoolArray, Camera, FloatArray, Lens, angles_between, pose_matrix
from rholoc.recordings import FrameSource

_MIN_VIEWS = 8
_OPTICAL_AXIS = np.array([0.0, 0.0, 1.0])
_MAX_RMS_PX = 2.0  # at a width of 1000 px: beyond, the board is another one, bent, or smeared
_MAX_FOCAL_SIGMA = 0.01  # relative
_MIN_TILT_DEG = 6.0
_OUTLIER = 3.0  # times the median error of all views
_SIGNIFICANT = 3.0  # standard deviations from zero that the sixth-order term must be to be kept
_PARAMETERS = {
    Lens.PINHOLE: ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"),
    Lens.FISHEYE: ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"),
}
_CELLS = (6, 8)  # rows and columns that the image is cut into, for coverage

_MOVE = "Film it from near and far, tilted by 30° and more, in every part of the picture."


@dataclass(frozen=True, eq=False)
class CalibrationView:
    """One view that was used.

    Attributes:
        sighting: the corners.
        residuals_px: (C, 2) detected minus projected corner.
        T_camera_board: (4, 4).
    """

    sighting: Sighting
    residuals_px: FloatArray
    T_camera_board: FloatArray


@dataclass(frozen=True, eq=False)
class Calibration:
    """A calibrated camera.

    Attributes:
        camera: the intrinsics.
        sigmas: standard deviations of fx, fy, cx, cy in pixels and of each distortion coefficient.
        rms_px: RMS distance between detected and projected corners.
        board: the board that was filmed.
        found: views of the board found in the recording.
        views: the views that were used.
    """

    camera: Camera
    sigmas: dict[str, float]
    rms_px: float
    board: Board
    found: BoardViews
    views: tuple[CalibrationView, ...]

    @property
    def coverage(self) -> float:
        """Share 0 to 1 of the image's 8 × 6 cells that hold a corner."""
        return float(self.covered.mean())

    @property
    def tilt_deg(self) -> float:
        """RMS angle [°] between the board and the image plane over the views."""
        normals = np.array([view.T_camera_board[:3, 2] for view in self.views])
        turned = angles_between(normals * np.sign(normals[:, 2:]), _OPTICAL_AXIS)
        return float(np.degrees(np.sqrt(np.mean(turned**2))))

    @property
    def covered(self) -> BoolArray:
        """Mask (6, 8) of the image's cells that hold a corner."""
        pixels = np.concatenate([view.sighting.pixels for view in self.views])
        size = np.array([self.camera.height, self.camera.width])
        cells = np.floor((pixels[:, ::-1] + 0.5) / size * _CELLS).astype(int)
        covered = np.zeros(_CELLS, dtype=np.bool_)
        covered[tuple(np.clip(cells, 0, np.array(_CELLS) - 1).T)] = True
        return covered

    @property
    def figures(self) -> dict[str, Any]:
        """Figures stored with the camera, for JSON: board, rms, sigmas, frames, views, coverage, tilt and distances."""
        depths = [view.T_camera_board[2, 3] for view in self.views]
        return {
            "board": str(self.board),
            "square_mm": 1000 * self.board.square_m,
            "rms_px": round(self.rms_px, 4),
            "sigmas": {name: float(f"{sigma:.3g}") for name, sigma in self.sigmas.items()},
            "frames_searched": self.found.searched,
            "frames_with_board": self.found.found,
            "views": len(self.views),
            "coverage": round(self.coverage, 3),
            "tilt_deg": round(self.tilt_deg, 1),
            "distances_m": [round(float(min(depths)), 3), round(float(max(depths)), 3)],
        }


def calibrate(
    frames: FrameSource, board: Board, advance: Callable[[], None] = lambda: None, lens: Lens = Lens.PINHOLE
) -> Calibration:
    """The camera that filmed a board.

    Args:
        frames: a video or pictures of one camera, its focus and zoom unchanged.
        board: the board; the size of its squares scales distances, not intrinsics.
        advance: called after each frame that was looked at.
        lens: of the camera: a pinhole or a fisheye.

    Raises:
        InvalidInput: the lens is a panorama's, which needs no calibration.
        InvalidRecording: the board is not found, there are fewer than eight different views, they are tilted by less
            than 6° (RMS), or the result is inexact.
    """
    if lens not in _PARAMETERS:
        raise InvalidInput("A panorama needs no calibration: its size says it all.", "Store it as equirectangular.")
    found = find_views(frames, board, advance)
    if not found.found:
        counts = "squares" if board.kind is BoardKind.CHARUCO else "inner corners"
        raise InvalidRecording(
            f"None of {found.searched} frames shows the {board}.",
            f"Count its {counts}, keep it sharp" + (", and wholly in view." if counts != "squares" else "."),
        )
    if len(found.chosen) < _MIN_VIEWS:
        raise InvalidRecording(
            f"{found.found} frames show the board, but only {len(found.chosen)} sharp views of it differ; "
            f"at least {_MIN_VIEWS} are needed.",
            _MOVE,
        )
    try:
        calibration = _without_outliers(found, board, frames.size, lens)
    except InvalidCamera as error:
        raise InvalidRecording("The views do not determine the focal length: they are too similar.", _MOVE) from error
    _check(calibration)
    return calibration


def _check(calibration: Calibration) -> None:
    """Raise InvalidRecording for large residuals, boards tilted by under 6° (RMS) or a focal sigma of over 1 %."""
    limit_px = _MAX_RMS_PX * max(calibration.camera.width, calibration.camera.height) / 1000
    if calibration.rms_px > limit_px:
        raise InvalidRecording(
            f"The corners are off by {calibration.rms_px:.1f} px; {limit_px:.1f} px is the limit.",
            "Is the board flat, and of that size? Were focus and zoom unchanged?",
        )
    tilt_deg = calibration.tilt_deg
    if tilt_deg < _MIN_TILT_DEG:  # the solver may then stop anywhere, and be sure of it
        raise InvalidRecording(f"The views are too similar: the board is tilted by only {tilt_deg:.1f}°.", _MOVE)
    sigma = calibration.sigmas["fx"] / calibration.camera.fx
    if sigma > _MAX_FOCAL_SIGMA:
        raise InvalidRecording(
            f"The views determine the focal length only to ±{sigma:.1%}: they are too similar.", _MOVE
        )


def _without_outliers(found: BoardViews, board: Board, size: tuple[int, int], lens: Lens) -> Calibration:
    """Calibration without the views whose RMS residual exceeds ``_OUTLIER`` × the median; they are left out once."""
    first = _solve(found, found.chosen, board, size, lens)
    errors = np.array([np.sqrt(np.mean(view.residuals_px**2)) for view in first.views])
    kept = [
        sighting for sighting, error in zip(found.chosen, errors, strict=True) if error <= _OUTLIER * np.median(errors)
    ]
    return first if len(kept) == len(errors) else _solve(found, kept, board, size, lens)


def _solve(
    found: BoardViews, sightings: Sequence[Sighting], board: Board, size: tuple[int, int], lens: Lens
) -> Calibration:
    """Calibration by all of the ``sightings``, which are among the views in ``found``."""
    solve = solve_fisheye if lens is Lens.FISHEYE else _solve_pinhole
    camera, poses, deviations = solve(sightings, board, size)
    views = []
    for sighting, T in zip(sightings, poses, strict=True):
        points = board.corners[sighting.corners] @ T[:3, :3].T + T[:3, 3]
        views.append(CalibrationView(sighting, sighting.pixels - camera.project(points), T))
    residuals = np.concatenate([view.residuals_px for view in views])
    sigmas = dict(zip(_PARAMETERS[lens][: len(camera.parameters)], deviations.tolist(), strict=False))
    return Calibration(camera, sigmas, float(np.sqrt((residuals**2).sum(axis=1).mean())), board, found, tuple(views))


def _solve_pinhole(
    sightings: Sequence[Sighting], board: Board, size: tuple[int, int]
) -> tuple[Camera, list[FloatArray], FloatArray]:
    """Camera, T_camera_board (4, 4) of each view and standard deviations, as of :func:`solve_fisheye`, for a pinhole.
    k3 is kept if it is three standard deviations from zero. Raises InvalidCamera.
    """
    solved = _calibrate_camera(sightings, board, size, 0)
    if abs(solved[2].ravel()[4]) < _SIGNIFICANT * solved[5].ravel()[8]:
        solved = _calibrate_camera(sightings, board, size, cv2.CALIB_FIX_K3)
    _, K, distortion, turns, shifts, deviations, _, _ = solved
    coefficients = distortion.ravel()[:5]
    count = 5 if coefficients[4] != 0 else 4
    fx, fy, cx, cy = (float(value) for value in (K[0, 0], K[1, 1], K[0, 2], K[1, 2]))
    camera = Camera(*size, fx, fy, cx, cy, tuple(coefficients[:count].tolist()))
    poses = [
        pose_matrix(np.asarray(cv2.Rodrigues(turn)[0], dtype=np.float64), np.asarray(shift, dtype=np.float64).ravel())
        for turn, shift in zip(turns, shifts, strict=True)
    ]
    return camera, poses, np.asarray(deviations, dtype=np.float64).ravel()[: 4 + count]


def _calibrate_camera(sightings: Sequence[Sighting], board: Board, size: tuple[int, int], flags: int) -> Any:
    """The result of OpenCV's ``calibrateCameraExtended`` with these flags."""
    return cv2.calibrateCameraExtended(
        [board.corners[sighting.corners].astype(np.float32) for sighting in sightings],
        [sighting.pixels.astype(np.float32) for sighting in sightings],
        size,
        np.eye(3),
        np.zeros(5),
        flags=flags,
    )
