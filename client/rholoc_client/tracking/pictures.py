"""How a camera moves, by its pictures alone: landmarks that an answer named are followed from frame to frame.

An answer with matches says which pixels show which points of the map. Optical flow (Lucas and Kanade, pyramidal)
follows the pixels, and the pose that shows the points there is a frame's. It needs OpenCV: the extra ``pictures``.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from rholoc_client.models import Camera
from rholoc_client.tracking.belief import OdometryNoise
from rholoc_client.tracking.rigid import FloatArray, inverse, pose

PICTURE_NOISE = OdometryNoise(drift=0.03, turn_drift=0.02, heading_drift_deg_m=0.5, step_m=0.003, step_deg=0.05)
"""How good it is: points seen again and again hold it, until they leave the picture."""

_FEW_POINTS = 30
_FEWEST_POINTS = 8  # there is no pose
_MOST_POINTS = 250
_FLOW = {"winSize": (21, 21), "maxLevel": 4}
_BACK_PX = 1.0  # flow forth and back ends where it began
_AGREEING_PX = 3.0
_KEPT_PICTURES = 90  # while an answer is awaited


@dataclass(frozen=True, eq=False)
class _Points:
    """Points of the odometry's frame (N, 3), and the pixels (N, 2) that show them."""

    points: FloatArray
    pixels: FloatArray

    def take(self, kept: np.ndarray) -> _Points:
        return _Points(self.points[kept], self.pixels[kept])


@dataclass(frozen=True, eq=False)
class _Standing:
    """A frame: its time, its picture (H, W) in grey, its pose (4, 4) if it has one, and the points in it."""

    time_s: float
    grey: np.ndarray
    T_odom_camera: FloatArray | None
    points: _Points


class PictureMotion:
    """Odometry from pictures. Its frame is that of the map as the first answer had it; it drifts from there.

    Args:
        camera: the intrinsics; ``width`` and ``height`` are those of the pictures.
    """

    def __init__(self, camera: Camera) -> None:
        self._K = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1.0]])
        self._distortion = np.array(camera.distortion, dtype=np.float64)
        self._last: _Standing | None = None
        self._kept: deque[_Standing] = deque(maxlen=_KEPT_PICTURES)

    @property
    def is_short_of_points(self) -> bool:
        """Whether so few points are left that an answer pays."""
        return self._last is not None and len(self._last.points.points) < _FEW_POINTS

    def follow(self, time_s: float, picture: np.ndarray) -> FloatArray | None:
        """The camera's pose (4, 4) at a picture (H, W, 3) BGR or (H, W) grey; None where too few points are left."""
        grey = picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
        self._last = self._followed(self._last, time_s, grey)
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
            np.reshape(np.asarray(landmarks, dtype=np.float64), (-1, 3))[:_MOST_POINTS],
            np.reshape(np.asarray(pixels, dtype=np.float64), (-1, 2))[:_MOST_POINTS],
        )
        # The points alone show a pose that is a little off the answer's, which weighs them better. Motion is from one
        # such pose to the next, so that it is the same little for both.
        placed = self._placed(seen, T_map_camera)
        T_map_seen, seen = (T_map_camera, seen) if placed is None else placed
        T_odom_camera = T_map_camera if asked.T_odom_camera is None else asked.T_odom_camera
        T_odom_map = T_odom_camera @ inverse(T_map_seen)
        seen = replace(seen, points=seen.points @ T_odom_map[:3, :3].T + T_odom_map[:3, 3])
        standing = replace(asked, T_odom_camera=T_odom_camera, points=seen)
        way = [(standing.time_s, standing.T_odom_camera)]
        for frame in later:
            standing = self._followed(standing, frame.time_s, frame.grey)
            way.append((standing.time_s, standing.T_odom_camera))
        self._last = standing
        return way

    def unanswered(self) -> None:
        """No answer came."""
        self._kept.clear()

    def _followed(self, last: _Standing | None, time_s: float, grey: np.ndarray) -> _Standing:
        nothing = _Standing(time_s, grey, None, _Points(np.zeros((0, 3)), np.zeros((0, 2))))
        if last is None or last.T_odom_camera is None or len(last.points.points) < _FEWEST_POINTS:
            return nothing
        if last.grey.shape != grey.shape:
            return nothing
        points = _flowed(last.grey, grey, last.points)
        placed = self._placed(points, last.T_odom_camera)
        return nothing if placed is None else _Standing(time_s, grey, *placed)

    def _placed(self, points: _Points, T_guess: FloatArray) -> tuple[FloatArray, _Points] | None:
        """The pose (4, 4) that shows points where they are, and those that agree with it."""
        if len(points.points) < _FEWEST_POINTS:
            return None
        T = inverse(T_guess)
        found, turned, moved, inliers = cv2.solvePnPRansac(
            points.points,
            points.pixels,
            self._K,
            self._distortion,
            cv2.Rodrigues(T[:3, :3])[0],
            T[:3, 3].copy(),
            useExtrinsicGuess=True,
            iterationsCount=60,
            reprojectionError=_AGREEING_PX,
            confidence=0.999,
        )
        if not found or inliers is None or len(inliers) < _FEWEST_POINTS:
            return None
        agreeing = points.take(inliers[:, 0])
        turned, moved = cv2.solvePnPRefineLM(agreeing.points, agreeing.pixels, self._K, self._distortion, turned, moved)
        T_odom_camera = inverse(pose(np.asarray(cv2.Rodrigues(turned)[0], dtype=np.float64), np.ravel(moved)))
        return (T_odom_camera, agreeing) if np.isfinite(T_odom_camera).all() else None


def _flowed(before: np.ndarray, now: np.ndarray, points: _Points) -> _Points:
    """The points where they are now; those that flow back to where they came from."""
    start = points.pixels.astype(np.float32).reshape(-1, 1, 2)
    end, found, _ = cv2.calcOpticalFlowPyrLK(before, now, start, None, **_FLOW)  # type: ignore[call-overload]
    back, found_back, _ = cv2.calcOpticalFlowPyrLK(now, before, end, None, **_FLOW)  # type: ignore[call-overload]
    height, width = now.shape
    inside = ((end[:, 0] >= 0) & (end[:, 0] < (width, height))).all(axis=1)
    near = np.linalg.norm(back[:, 0] - start[:, 0], axis=1) < _BACK_PX
    kept = np.flatnonzero((found[:, 0] == 1) & (found_back[:, 0] == 1) & inside & near)
    return _Points(points.points[kept], end[kept, 0].astype(np.float64))
