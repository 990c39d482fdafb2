"""How a camera moves, from its pictures alone: the landmarks of an answer are followed from frame to frame.

An answer with matches says which pixels show which points of the map. Optical flow (pyramidal Lucas–Kanade) follows the
pixels, and a frame's pose is the one that projects the points there. It needs OpenCV: the extra ``pictures``.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from rholoc_client.models import Camera
from rholoc_client.tracking.belief import OdometryNoise
from rholoc_client.tracking.lenses import image_planes
from rholoc_client.tracking.rigid import FloatArray, inverse, pose, rotation

PICTURE_NOISE = OdometryNoise(drift=0.03, turn_drift=0.02, heading_drift_deg_m=0.5, step_m=0.003, step_deg=0.05)
"""How accurate it is: it does not drift while the same points stay in the picture."""

_FEW_POINTS = 30
_MIN_POINTS = 8  # with fewer there is no pose
_MAX_POINTS = 250
_FLOW = {"winSize": (21, 21), "maxLevel": 4}
_BACK_PX = 1.0  # forward and backward flow must end where it began
_TOLERANCES_PX = (60.0, 20.0, 8.0, 4.0)
_FIRST_TOLERANCE = 3.0  # in medians, where the picture moved further than the first tolerance
_ITERATIONS, _SETTLED = 5, 1e-5  # metres or radians
_MIN_DEPTH = 0.05  # in front of the camera, metres
_SAME_PX = 4.0
_KEPT_PICTURES = 90  # while an answer is awaited


@dataclass(frozen=True, eq=False)
class _Points:
    """Points of the odometry's frame (N, 3), and the pixels (N, 2) that show them."""

    points: FloatArray
    pixels: FloatArray

    def take(self, kept: np.ndarray) -> _Points:
        return _Points(self.points[kept], self.pixels[kept])


@dataclass(frozen=True, eq=False)
class _FollowedFrame:
    """A frame: its time, its picture (H, W) in grey and the camera's intrinsics, its pose (4, 4) if it has one, and the
    points in it."""

    time_s: float
    grey: np.ndarray
    camera: Camera
    T_odom_camera: FloatArray | None
    points: _Points


class PictureMotion:
    """Odometry from pictures. Its frame starts out as the map's, by the first answer, and drifts from there."""

    def __init__(self) -> None:
        self._last: _FollowedFrame | None = None
        self._kept: deque[_FollowedFrame] = deque(maxlen=_KEPT_PICTURES)

    @property
    def is_short_of_points(self) -> bool:
        """Whether so few points are left that asking pays."""
        return self._last is not None and len(self._last.points.points) < _FEW_POINTS

    def follow(self, time_s: float, picture: np.ndarray, camera: Camera) -> FloatArray | None:
        """The camera's pose (4, 4) at a picture (H, W, 3) BGR or (H, W) grey; None where too few points are left.

        ``camera`` has the picture's intrinsics, which autofocus may change from one picture to the next.
        """
        grey = picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
        self._last = self._followed(self._last, time_s, grey, camera)
        if self._kept:
            self._kept.append(self._last)
        return self._last.T_odom_camera

    def keep(self) -> None:
        """Remember the last picture and those that follow: an answer is being asked for."""
        self._kept.clear()
        if self._last is not None:
            self._kept.append(self._last)

    def answered(
        self, T_map_camera: FloatArray, pixels: Sequence[Sequence[float]], landmarks: Sequence[Sequence[float]]
    ) -> list[tuple[float, FloatArray | None]]:
        """Take in an answer about the picture that was kept first: its pose (4, 4), pixels and landmarks in the map.

        Returns:
            The time and the pose of that picture and of each since, the last one's included.
        """
        if not self._kept:
            return []
        asked, *later = self._kept
        self._kept.clear()
        seen = _Points(
            np.reshape(np.asarray(landmarks, dtype=np.float64), (-1, 3))[:_MAX_POINTS],
            np.reshape(np.asarray(pixels, dtype=np.float64), (-1, 2))[:_MAX_POINTS],
        )
        # The points alone give a pose slightly off the answer's, which weighs them better. Motion is from one such pose
        # to the next, so that both are off by the same amount.
        placed = _placed(asked.camera, seen, T_map_camera)
        T_map_seen, seen = (T_map_camera, seen) if placed is None else placed
        T_odom_camera = T_map_camera if asked.T_odom_camera is None else asked.T_odom_camera
        T_odom_map = T_odom_camera @ inverse(T_map_seen)
        seen = replace(seen, points=seen.points @ T_odom_map[:3, :3].T + T_odom_map[:3, 3])
        seen = _joined(seen, asked.points)
        last = replace(asked, T_odom_camera=T_odom_camera, points=seen)
        path = [(last.time_s, last.T_odom_camera)]
        for frame in later:
            last = self._followed(last, frame.time_s, frame.grey, frame.camera)
            path.append((last.time_s, last.T_odom_camera))
        self._last = last
        return path

    def unanswered(self) -> None:
        """No answer came."""
        self._kept.clear()

    def _followed(self, last: _FollowedFrame | None, time_s: float, grey: np.ndarray, camera: Camera) -> _FollowedFrame:
        nothing = _FollowedFrame(time_s, grey, camera, None, _Points(np.zeros((0, 3)), np.zeros((0, 2))))
        if last is None or last.T_odom_camera is None or len(last.points.points) < _MIN_POINTS:
            return nothing
        if last.grey.shape != grey.shape:
            return nothing
        points = _flowed(last.grey, grey, last.points)
        placed = _placed(camera, points, last.T_odom_camera)
        return nothing if placed is None else _FollowedFrame(time_s, grey, camera, *placed)


def _placed(camera: Camera, points: _Points, T_guess: FloatArray) -> tuple[FloatArray, _Points] | None:
    """The pose (4, 4) that projects the points to their pixels, and the points that agree with it.

    Gauss–Newton from a guess, with weights that fall to 0 at a tolerance that narrows: flow has few outliers and
    the guess is the frame before, so that no random sampling is needed. The first tolerance covers the whole picture's
    motion: a camera that turns quickly, or frames that are far apart, move every point by more than flow is ever off.
    """
    if len(points.points) < _MIN_POINTS:
        return None
    R_plane_camera, plane = image_planes(camera, points.pixels)
    T, focal_px = inverse(T_guess), float(np.sqrt(camera.fx * camera.fy))
    agreeing = np.zeros(len(plane), dtype=bool)

    def projected() -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        seen = points.points @ T[:3, :3].T + T[:3, 3]
        there = np.einsum("nij,nj->ni", R_plane_camera, seen)
        residual = plane - there[:, :2] / np.maximum(there[:, 2:], _MIN_DEPTH)
        return seen, there, residual, focal_px * np.linalg.norm(residual, axis=1)

    first, *narrower = _TOLERANCES_PX
    for tolerance_px in (max(first, _FIRST_TOLERANCE * float(np.median(projected()[3]))), *narrower):
        for _ in range(_ITERATIONS):
            seen, there, residual, off_px = projected()
            x, y, depth = there[:, 0], there[:, 1], np.maximum(there[:, 2], _MIN_DEPTH)
            agreeing = (off_px < tolerance_px) & (there[:, 2] > _MIN_DEPTH)
            if agreeing.sum() < _MIN_POINTS:
                return None
            weight = np.where(agreeing, 1 - (off_px / tolerance_px) ** 2, 0.0)
            one, none = np.ones_like(x), np.zeros_like(x)
            by_point = np.stack([np.stack([one, none, -x / depth], 1), np.stack([none, one, -y / depth], 1)], 1)
            by_point = by_point / depth[:, None, None] @ R_plane_camera
            J = np.concatenate([by_point, -by_point @ _crosses(seen)], axis=2)  # of a motion of the camera frame
            weighted = (J * weight[:, None, None]).reshape(-1, 6)
            curvature = weighted.T @ J.reshape(-1, 6) + 1e-9 * np.eye(6)
            step = np.linalg.solve(curvature, weighted.T @ residual.ravel())
            R = rotation(step[3:])
            T = pose(R @ T[:3, :3], R @ T[:3, 3] + step[:3])
            if np.abs(step).max() < _SETTLED:
                break
    return inverse(T), points.take(np.flatnonzero(agreeing))


def _crosses(vectors: FloatArray) -> FloatArray:
    """[v]× (N, 3, 3) of vectors (N, 3)."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)


def _joined(new: _Points, old: _Points) -> _Points:
    """New points, and the old ones that lie elsewhere in the picture, so that motion does not depend on one answer."""
    if len(new.points) == 0 or len(old.points) == 0:
        return new if len(new.points) else old
    apart_px = np.linalg.norm(old.pixels[:, None] - new.pixels[None], axis=2).min(axis=1)
    kept = old.take(np.flatnonzero(apart_px > _SAME_PX)[: max(0, _MAX_POINTS - len(new.points))])
    return _Points(np.concatenate([new.points, kept.points]), np.concatenate([new.pixels, kept.pixels]))


def _flowed(before: np.ndarray, now: np.ndarray, points: _Points) -> _Points:
    """The points where they are now; only those whose backward flow ends where they came from."""
    start = points.pixels.astype(np.float32).reshape(-1, 1, 2)
    end, found, _ = cv2.calcOpticalFlowPyrLK(before, now, start, None, **_FLOW)  # type: ignore[call-overload]
    back, found_back, _ = cv2.calcOpticalFlowPyrLK(now, before, end, None, **_FLOW)  # type: ignore[call-overload]
    height, width = now.shape
    inside = ((end[:, 0] >= 0) & (end[:, 0] < (width, height))).all(axis=1)
    near = np.linalg.norm(back[:, 0] - start[:, 0], axis=1) < _BACK_PX
    kept = np.flatnonzero((found[:, 0] == 1) & (found_back[:, 0] == 1) & inside & near)
    return _Points(points.points[kept], end[kept, 0].astype(np.float64))
