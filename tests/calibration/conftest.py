"""Pictures of boards, rendered with known intrinsics and distortion."""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rholoc.calibration import Board, BoardKind
from rholoc.geometry import ByteArray, Camera, FloatArray, pose_matrix
from rholoc.recordings import MemoryFrames

_SAMPLES = 2  # a pixel's side
_TEXELS = 40  # a square's side


@dataclass(frozen=True, eq=False)
class Studio:
    """A camera before a board: every pixel's ray is followed to the board's plane."""

    camera: Camera
    board: Board

    def photograph(self, T_camera_board: FloatArray, rng: np.random.Generator, blur_px: float = 0.6) -> ByteArray:
        """(H, W, 3), blurred by a Gaussian and noisy."""
        H_board_plane = np.linalg.inv(T_camera_board[:3, [0, 1, 3]])
        points = self._rays @ H_board_plane.T
        texels = (points[:, :2] / points[:, 2:] / self.board.square_m + 2) * _TEXELS - 0.5
        fine = texels.reshape(_SAMPLES * self.camera.height, -1, 2).astype(np.float32)
        seen = cv2.remap(self._texture, fine, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=90)
        gray = cv2.resize(seen, (self.camera.width, self.camera.height), interpolation=cv2.INTER_AREA)
        gray = cv2.GaussianBlur(gray, (0, 0), blur_px) + rng.normal(0, 2, gray.shape)
        return np.repeat(np.clip(gray, 0, 255).astype(np.uint8)[:, :, None], 3, axis=2)

    def walk(self, count: int, rng: np.random.Generator, tilt_deg: float = 35.0) -> list[FloatArray]:
        """Poses T_camera_board that show the board wholly, from the nearest distance at which it fits to twice that."""
        middle = self.board.outline.mean(axis=0)
        depth_m = np.ptp(self.board.outline[:, 0]) / (self.camera.width / self.camera.fx) * 1.25
        poses = []
        while len(poses) < count:
            turn = Rotation.from_euler("xyz", rng.uniform(-tilt_deg, tilt_deg, 3) * (1, 1, 0.4), degrees=True)
            z = depth_m * rng.uniform(1, 2)
            shift = z * rng.uniform(-0.5, 0.5, 2) * (self.camera.width, self.camera.height) / self.camera.fx
            R = turn.as_matrix()
            T = pose_matrix(R, np.array([*shift, z]) - R @ [*middle, 0])
            corners = self.camera.project(self.board.corners @ T[:3, :3].T + T[:3, 3])
            if ((corners > 12) & (corners < (self.camera.width - 12, self.camera.height - 12))).all():
                poses.append(T)
        return poses

    @cached_property
    def _rays(self) -> FloatArray:
        """Each sample's ray, (N, 3)."""
        u, v = ((np.arange(_SAMPLES * side) + 0.5) / _SAMPLES - 0.5 for side in (self.camera.width, self.camera.height))
        return self.camera.rays(np.stack(np.meshgrid(u, v), axis=2).reshape(-1, 2))

    @cached_property
    def _texture(self) -> ByteArray:
        """The print: the first inner corner is two squares from the edge, of which one is white margin."""
        columns, rows = self.board.columns + 1, self.board.rows + 1
        if self.board.kind is BoardKind.CHARUCO:
            markers = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_250)
            print_ = cv2.aruco.CharucoBoard((columns, rows), 1.0, 0.7, markers)
            inside = print_.generateImage((columns * _TEXELS, rows * _TEXELS))
        else:
            dark = np.add.outer(np.arange(rows), np.arange(columns)) % 2 == 0
            inside = np.kron(np.where(dark, 20, 235), np.ones((_TEXELS, _TEXELS))).astype(np.uint8)
        return cv2.copyMakeBorder(inside, *[_TEXELS] * 4, cv2.BORDER_CONSTANT, value=235)


@pytest.fixture(scope="session")
def studio() -> type[Studio]:
    """Makes studios."""
    return Studio


@pytest.fixture(scope="session")
def as_frames() -> type[MemoryFrames]:
    """Makes sources of frames."""
    return MemoryFrames


@pytest.fixture(scope="session")
def phone() -> Camera:
    """What a phone's camera may be, not centred, with distortion."""
    return Camera(640, 480, 530.0, 528.0, 311.0, 246.5, (0.09, -0.21, 0.0008, -0.0012))
