"""A wall with a picture on it, and recordings of walks along it: exact geometry at the price of one warp a frame."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest

from rholoc.geometry import ByteArray, Camera, FloatArray, IntArray, Pose
from rholoc.recordings import GivenPoses, Recording

CAMERA = Camera(480, 360, 400.0, 400.0, 239.5, 179.5)
_TEXELS_PER_M = 200.0
_WALL_M = (8.0, 4.0)


@dataclass(frozen=True, eq=False)
class WallFrames:
    """Pictures of the wall y = 0 (8 m along x, 4 m high) from poses at y < 0, by a light of colour ``light`` (BGR)."""

    picture: ByteArray
    poses: Sequence[Pose]
    light: tuple[float, float, float]

    @property
    def times(self) -> FloatArray:
        return np.arange(len(self.poses)) / 10

    @property
    def timed(self) -> bool:
        return True

    @property
    def numbers(self) -> IntArray:
        return np.arange(len(self.poses))

    @property
    def size(self) -> tuple[int, int]:
        return CAMERA.width, CAMERA.height

    def images(self, rows: Sequence[int]) -> Iterator[ByteArray]:
        for row in rows:
            T = self.poses[row].inverse()
            # texel (s, t) ↦ (s / k, 0, 4 − t / k)
            wall = np.array([[1 / _TEXELS_PER_M, 0, 0], [0, 0, 0], [0, -1 / _TEXELS_PER_M, _WALL_M[1]]])
            H = CAMERA.matrix @ (T[:3, :3] @ wall + T[:3, 3:] * np.array([0, 0, 1]))
            warped = cv2.warpPerspective(self.picture, H, self.size, flags=cv2.INTER_AREA)
            noise = np.random.default_rng(row).normal(0, 2, warped.shape)
            yield np.clip(warped * self.light + noise, 0, 255).astype(np.uint8)


@dataclass(frozen=True, eq=False)
class Wall:
    """The wall."""

    picture: ByteArray

    def walk(self, count: int, away_m: float = 2.0, light: tuple[float, float, float] = (1, 1, 1)) -> Recording:
        """A posed walk of two metres along it, looking at it; the camera rolls a little."""
        poses = [
            Pose.from_heading(
                np.array([3 + 2 * s, -away_m, 2 + 0.1 * np.sin(9 * s)]), np.array([0.4 * np.sin(5 * s), 1, 0]), 0.1 * s
            )
            for s in np.linspace(0, 1, count)
        ]
        T = np.array([pose.T_map_camera for pose in poses])
        return Recording(
            name="wall",
            path=Path("wall"),
            frames=WallFrames(self.picture, poses, light),
            camera=CAMERA,
            poses=GivenPoses(np.ones(count, dtype=bool), T),
        )

    @staticmethod
    def points_seen(camera: Camera, pose: Pose) -> FloatArray:
        """The wall's point (H, W, 3) at each pixel's centre."""
        u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
        rays = camera.rays(np.column_stack([u.ravel(), v.ravel()])) @ pose.R_map_camera.T
        points = pose.position - rays * (pose.position[1] / rays[:, 1])[:, None]
        return points.reshape(camera.height, camera.width, 3)


@pytest.fixture(scope="session")
def wall() -> Wall:
    """A wall covered with coloured rectangles."""
    rng = np.random.default_rng(3)
    width, height = (int(side * _TEXELS_PER_M) for side in _WALL_M)
    picture = np.full((height, width, 3), 128, np.uint8)
    for _ in range(4000):
        x, y = int(rng.integers(0, width)), int(rng.integers(0, height))
        w, h = (int(side) for side in rng.integers(4, 50, 2))
        cv2.rectangle(picture, (x, y), (x + w, y + h), tuple(map(int, rng.integers(20, 236, 3))), -1)
    return Wall(picture)
