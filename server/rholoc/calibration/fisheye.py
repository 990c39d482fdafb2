"""Views of a board → a fisheye camera: poses by resection from guessed focal lengths, then all together."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from rholoc.calibration.boards import Board, Sighting
from rholoc.errors import InvalidCamera
from rholoc.geometry import Camera, FloatArray, Lens
from rholoc.geometry.resection import resected

_FIELDS_RAD = np.radians([80.0, 110.0, 140.0, 170.0, 200.0])  # of view across, that are tried
_INTRINSICS = 8  # fx, fy, cx, cy, k1, k2, k3, k4
_INCREMENTS = np.array([1e-3] * 4 + [1e-6] * 4)  # by which their slopes are found
_SAMPLES = 200
_GUESS_TOLERANCE = 0.02  # of the image's width, within which a corner agrees with a guessed camera
_CAUCHY_PX = 1.0
_STEPS, _SETTLED = 60, 1e-9  # share of the cost
_DAMPING = (1e-3, 1e-9, 1e9)  # at first, at least, at most


@dataclass(frozen=True, eq=False)
class _Solution:
    """A camera and T_camera_board (V, 4, 4), with the residuals (2N,) [px], projected − detected, and their slopes.

    ``slopes`` (2N, 8 + 6 V) are by the intrinsics, then view by view by rotation (from the left) and translation.
    """

    camera: Camera
    poses: FloatArray
    residuals: FloatArray
    slopes: FloatArray

    @property
    def weights(self) -> FloatArray:
        """Cauchy's weights (2N,) of the residuals."""
        return np.asarray(1 / (1 + (self.residuals / _CAUCHY_PX) ** 2))

    @property
    def cost(self) -> float:
        """Cauchy's loss, summed over the residuals."""
        return float(np.log1p((self.residuals / _CAUCHY_PX) ** 2).sum())


def solve_fisheye(
    sightings: Sequence[Sighting], board: Board, size: tuple[int, int]
) -> tuple[Camera, list[FloatArray], FloatArray]:
    """The fisheye camera (Kannala and Brandt) that saw a board.

    Returns:
        The camera, T_camera_board (4, 4) of each view, and standard deviations (8,) of fx, fy, cx, cy, k1, k2, k3, k4.

    Raises:
        InvalidCamera: no fisheye camera fits the views.
    """
    found = [_refined(start, sightings, board) for start in _starts(sightings, board, size)]
    if not found:
        raise InvalidCamera("No fisheye camera explains the views of the board.")
    best = min(found, key=lambda one: one.cost)
    return best.camera, list(best.poses), _sigmas(best)


def _starts(sightings: Sequence[Sighting], board: Board, size: tuple[int, int]) -> list[_Solution]:
    """A camera and poses for each guessed focal length (field of view 80° to 200°) with which every view has a pose."""
    starts = []
    for field_rad in _FIELDS_RAD:
        focal = size[0] / float(field_rad)
        camera = Camera(*size, focal, focal, (size[0] - 1) / 2, (size[1] - 1) / 2, (0.0,) * 4, Lens.FISHEYE)
        settings = {"max_iterations": _SAMPLES, "max_reproj_error": _GUESS_TOLERANCE * size[0], "seed": 1}
        poses = []
        for sighting in sightings:
            rays, corners = camera.rays(sighting.pixels), board.corners[sighting.corners]
            T_board_camera, agreeing = resected([rays], [corners], np.eye(4)[None], focal, settings)
            if agreeing >= len(corners) / 2 and np.isfinite(T_board_camera).all():
                poses.append(np.linalg.inv(T_board_camera))
        if len(poses) == len(sightings):
            start = _evaluated(camera, np.array(poses), sightings, board)
            starts += [] if start is None else [start]
    return starts


def _refined(found: _Solution, sightings: Sequence[Sighting], board: Board) -> _Solution:
    """Refine all intrinsics and poses together (Levenberg–Marquardt); ``found`` itself if no step lowers its cost."""
    damping, least, most = _DAMPING
    for _ in range(_STEPS):
        weighted = found.slopes * found.weights[:, None]
        curvature, slope = weighted.T @ found.slopes, weighted.T @ found.residuals
        step = -np.linalg.solve(curvature + np.diag(damping * np.diag(curvature) + 1e-12), slope)
        there = _evaluated(*_stepped(found, step), sightings, board)
        if there is None or there.cost >= found.cost:
            damping *= 10
            if damping > most:
                break
            continue
        is_settled = found.cost - there.cost <= _SETTLED * found.cost
        found, damping = there, max(damping / 10, least)
        if is_settled:
            break
    return found


def _stepped(found: _Solution, step: FloatArray) -> tuple[Camera | None, FloatArray]:
    """Camera (None if it is impossible) and poses (V, 4, 4) after a step (8 + 6 V,)."""
    turn, shift = np.split(step[_INTRINSICS:].reshape(-1, 6), 2, axis=1)
    poses = found.poses.copy()
    poses[:, :3, :3] = Rotation.from_rotvec(turn).as_matrix() @ poses[:, :3, :3]
    poses[:, :3, 3] += shift
    return _changed(found.camera, step[:_INTRINSICS]), poses


def _changed(camera: Camera, by: FloatArray) -> Camera | None:
    """Camera with ``by`` (8,) added to fx, fy, cx, cy, k1 … k4; None if these are impossible."""
    fx, fy, cx, cy, *coefficients = (np.array(camera.parameters) + by).tolist()
    try:
        return replace(camera, fx=fx, fy=fy, cx=cx, cy=cy, distortion=tuple(coefficients))
    except InvalidCamera:
        return None


def _evaluated(
    camera: Camera | None, poses: FloatArray, sightings: Sequence[Sighting], board: Board
) -> _Solution | None:
    """Residuals and slopes of a camera and poses; None without a camera, or if the lens does not show all corners."""
    if camera is None:
        return None
    corners = [board.corners[sighting.corners] for sighting in sightings]
    turned = [some @ T[:3, :3].T for some, T in zip(corners, poses, strict=True)]
    points = np.concatenate([some + T[:3, 3] for some, T in zip(turned, poses, strict=True)])
    residuals = camera.project(points) - np.concatenate([sighting.pixels for sighting in sightings])
    if not np.isfinite(residuals).all():
        return None
    slopes = np.zeros((len(points), 2, _INTRINSICS + 6 * len(poses)))
    for column, increment in enumerate(_INCREMENTS):
        ahead, back = (_changed(camera, way * increment * np.eye(_INTRINSICS)[column]) for way in (1, -1))
        if ahead is None or back is None:
            return None
        slopes[:, :, column] = (ahead.project(points) - back.project(points)) / (2 * increment)
    by_point, first = camera.slopes(points), 0
    for view, some in enumerate(turned):
        rows, column = slice(first, first + len(some)), _INTRINSICS + 6 * view
        by_turn = np.cross(np.eye(3)[None], some[:, None, :]).transpose(0, 2, 1)  # of a point, by a turn: ω × point
        slopes[rows, :, column : column + 3] = by_point[rows] @ by_turn
        slopes[rows, :, column + 3 : column + 6] = by_point[rows]
        first += len(some)
    return _Solution(camera, poses, residuals.ravel(), slopes.reshape(residuals.size, -1))


def _sigmas(found: _Solution) -> FloatArray:
    """Standard deviations (8,) of the intrinsics, by the curvature and the residuals."""
    weights = found.weights
    freedom = max(len(found.residuals) - found.slopes.shape[1], 1)
    variance = float(np.sum(weights * found.residuals**2)) / freedom
    covariance = np.linalg.pinv((found.slopes * weights[:, None]).T @ found.slopes) * variance
    return np.asarray(np.sqrt(np.diag(covariance)[:_INTRINSICS]))
