"""A fisheye's intrinsics from the corners of a board."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rholoc.calibration import Board, BoardKind
from rholoc.calibration.boards import Sighting
from rholoc.calibration.fisheye import solve_fisheye
from rholoc.errors import InvalidCamera
from rholoc.geometry import Camera, Lens, pose_matrix

BOARD = Board.parse("9x6", 25, BoardKind.CHECKERBOARD)
NARROW = Camera(640, 480, 420.0, 421.0, 322.0, 237.0, (-0.02, 0.01, 0.0, 0.0), Lens.FISHEYE)
WIDE = Camera(480, 480, 160.0, 161.0, 242.0, 237.0, (0.01, 0.02, -0.015, 0.003), Lens.FISHEYE)


def _sightings(camera: Camera, count: int, rng: np.random.Generator, noise_px: float = 0.1) -> list[Sighting]:
    """A board of which all corners are seen, from about as near as it fits, tilted by up to 35°."""
    middle, found = np.append(BOARD.outline.mean(axis=0), 0), []
    reach = camera.width / camera.focal / 2
    while len(found) < count:
        turn = Rotation.from_euler("xyz", rng.uniform(-35, 35, 3) * (1, 1, 0.4), degrees=True).as_matrix()
        depth_m = rng.uniform(0.15, 0.4) / np.tan(min(reach, 1.0))
        aside = depth_m * np.tan(min(reach, 1.0)) * rng.uniform(-1, 1, 2)
        T = pose_matrix(turn, np.array([*aside, depth_m]) - turn @ middle)
        pixels = camera.project(BOARD.corners @ T[:3, :3].T + T[:3, 3])
        if camera.contains(pixels).all():
            noise = noise_px * rng.normal(size=pixels.shape)
            found.append(Sighting(len(found), np.arange(len(pixels)), pixels + noise, 1.0))
    return found


@pytest.mark.parametrize("camera", [NARROW, WIDE], ids=["67°", "170°"])
def test_the_camera_comes_back_within_its_sigmas(camera: Camera) -> None:
    for seed in range(3):
        sightings = _sightings(camera, 20, np.random.default_rng(seed))
        found, poses, sigmas = solve_fisheye(sightings, BOARD, (camera.width, camera.height))
        assert found.lens is Lens.FISHEYE
        assert len(poses) == 20
        assert np.abs((np.array(found.parameters) - camera.parameters) / sigmas).max() < 4.5
        assert sigmas[0] < 1.0


def test_a_corner_that_is_wrong_hardly_matters() -> None:
    sightings = _sightings(WIDE, 16, np.random.default_rng(0))
    for sighting in sightings[:8]:
        sighting.pixels[3] += 15
    found, _, sigmas = solve_fisheye(sightings, BOARD, (WIDE.width, WIDE.height))
    assert np.abs((np.array(found.parameters[:4]) - WIDE.parameters[:4]) / sigmas[:4]).max() < 5


def test_what_no_fisheye_shows_is_refused() -> None:
    rng = np.random.default_rng(1)
    scattered = [Sighting(k, np.arange(54), rng.uniform(0, 480, (54, 2)), 1.0) for k in range(8)]
    with pytest.raises(InvalidCamera, match="fisheye"):
        solve_fisheye(scattered, BOARD, (480, 480))
