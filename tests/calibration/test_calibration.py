"""A board's pictures give back the camera that they were rendered with, or one line on why not."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rholoc.calibration import Board, BoardKind, Calibration, calibrate
from rholoc.calibration.boards import BoardFinder, Sighting
from rholoc.calibration.fisheye import solve_fisheye
from rholoc.errors import InvalidCamera, InvalidInput, InvalidRecording
from rholoc.geometry import ByteArray, Camera, Lens, pose_matrix
from rholoc.pictures.calibration import calibration_png

_CHECKERBOARD = Board.parse("9x6", 25, BoardKind.CHECKERBOARD)
_CHARUCO = Board.parse("10x7", 25, BoardKind.CHARUCO)
_BLANK = np.full((480, 640, 3), 120, np.uint8)


@pytest.fixture(scope="module")
def pictures(phone: Camera, studio) -> list[ByteArray]:
    rng = np.random.default_rng(0)
    room = studio(phone, _CHECKERBOARD)
    return [room.photograph(T, rng) for T in room.walk(12, rng)]


@pytest.fixture(scope="module")
def calibration(pictures: list[ByteArray], as_frames) -> Calibration:
    """From sharp views, blurred ones of the same, and blank frames."""
    blurred = [cv2.GaussianBlur(picture, (0, 0), 4) for picture in pictures[:4]]
    return calibrate(as_frames([*pictures, *blurred, _BLANK, _BLANK]), _CHECKERBOARD)


def off_by_sigmas(found: Calibration, truth: Camera) -> dict[str, float]:
    """How far each of the intrinsics is off, in its standard deviations."""
    names = ("fx", "fy", "cx", "cy")
    return {name: (getattr(found.camera, name) - getattr(truth, name)) / found.sigmas[name] for name in names}


def test_a_checkerboard_gives_the_camera_back(calibration: Calibration, phone: Camera) -> None:
    assert calibration.camera.fx == pytest.approx(phone.fx, abs=0.5)
    assert calibration.camera.fy == pytest.approx(phone.fy, abs=0.5)
    assert (calibration.camera.cx, calibration.camera.cy) == pytest.approx((phone.cx, phone.cy), abs=0.6)
    assert calibration.camera.distortion == pytest.approx(phone.distortion, abs=0.01)
    assert calibration.rms_px < 0.1


def test_the_uncertainties_are_honest(calibration: Calibration, phone: Camera) -> None:
    assert max(map(abs, off_by_sigmas(calibration, phone).values())) < 4
    assert calibration.sigmas["fx"] < 0.5


def test_blurred_and_blank_frames_are_left_out(calibration: Calibration) -> None:
    used = {view.sighting.row for view in calibration.views}
    assert used <= set(range(12))
    assert len(used) >= 10
    assert calibration.found.searched == 18
    assert 12 <= calibration.found.found <= 16


def test_distances_come_from_the_size_of_a_square(
    calibration: Calibration, pictures: list[ByteArray], as_frames
) -> None:
    double = calibrate(as_frames(pictures), replace(_CHECKERBOARD, square_m=0.05))
    assert double.camera.fx == pytest.approx(calibration.camera.fx, rel=1e-3)
    ratio = np.array(double.figures["distances_m"]) / calibration.figures["distances_m"]
    np.testing.assert_allclose(ratio, 2, rtol=0.02)


def test_the_picture_shows_what_was_covered(calibration: Calibration) -> None:
    image = cv2.imdecode(np.frombuffer(calibration_png(calibration), np.uint8), cv2.IMREAD_COLOR)
    assert image.shape[1] > 1000
    assert 0.5 < calibration.coverage <= 1


@pytest.mark.slow
def test_a_charuco_board_partly_in_view_gives_the_camera_back(phone: Camera, studio, as_frames) -> None:
    rng = np.random.default_rng(1)
    room = studio(phone, _CHARUCO)
    cut = [room.photograph(T, rng) for T in room.walk(8, rng)]
    for picture in cut:
        picture[:, : 640 // 4] = 90
    found = calibrate(as_frames(cut), _CHARUCO)
    assert min(len(view.sighting.corners) for view in found.views) < _CHARUCO.columns * _CHARUCO.rows
    assert max(map(abs, off_by_sigmas(found, phone).values())) < 4
    assert found.camera.fx == pytest.approx(phone.fx, abs=2)


@pytest.mark.slow
def test_a_large_picture_is_searched_small_and_measured_large(studio) -> None:
    camera = Camera(1600, 1200, 1325.0, 1320.0, 780.0, 615.0)
    rng = np.random.default_rng(2)
    room = studio(camera, _CHECKERBOARD)
    (T,) = room.walk(1, rng)
    found = BoardFinder(_CHECKERBOARD).find(0, room.photograph(T, rng))
    seen = camera.project(_CHECKERBOARD.corners @ T[:3, :3].T + T[:3, 3])
    error_px = min(np.abs(found.pixels - seen).max(), np.abs(found.pixels[::-1] - seen).max())
    assert error_px < 0.2


def test_frames_without_the_board_are_refused(as_frames) -> None:
    with pytest.raises(InvalidRecording, match=r"None of 3 frames shows the 9x6 checkerboard\. Count its inner"):
        calibrate(as_frames([_BLANK] * 3), _CHECKERBOARD)


def test_too_few_different_views_are_refused(pictures: list[ByteArray], as_frames) -> None:
    with pytest.raises(InvalidRecording, match=r"6 frames show the board, but only 2 sharp views.*tilted"):
        calibrate(as_frames([pictures[0]] * 3 + [pictures[1]] * 3), _CHECKERBOARD)


@pytest.mark.parametrize("tilt_deg", [0.0, pytest.param(3.0, marks=pytest.mark.slow)])
def test_views_that_leave_the_focal_length_open_are_refused(tilt_deg: float, phone: Camera, studio, as_frames) -> None:
    rng = np.random.default_rng(3)
    room = studio(phone, _CHECKERBOARD)
    flat = [room.photograph(T, rng) for T in room.walk(8, rng, tilt_deg)]
    with pytest.raises(InvalidRecording, match=r"too similar.*Film it"):
        calibrate(as_frames(flat), _CHECKERBOARD)


@pytest.mark.parametrize("size", ["", "9", "9x", "0x6", "2x6", "9x6x2", "999x999", "-9x6", "a x b"])
def test_what_is_no_board_is_refused(size: str) -> None:
    with pytest.raises(InvalidInput, match="not the size of a board"):
        Board.parse(size, 25, BoardKind.CHECKERBOARD)


def test_squares_without_a_size_are_refused() -> None:
    for square_mm in (0, -25, float("nan")):
        with pytest.raises(InvalidInput, match="square"):
            Board.parse("9x6", square_mm, BoardKind.CHECKERBOARD)


def test_boards_are_named_as_they_are_sold() -> None:
    assert (str(_CHECKERBOARD), str(_CHARUCO)) == ("9x6 checkerboard", "10x7 charuco")
    assert len(_CHARUCO.corners) == len(_CHECKERBOARD.corners) == 54


@pytest.mark.slow
def test_a_fisheye_is_given_back(studio, as_frames) -> None:
    """Of pictures in which the lens bends the board most, it is not found."""
    fisheye = Camera(480, 480, 160.0, 161.0, 242.0, 237.0, (0.01, 0.02, -0.015, 0.003), Lens.FISHEYE)
    rng = np.random.default_rng(4)
    room = studio(fisheye, _CHECKERBOARD)
    pictures = [room.photograph(T, rng) for T in room.walk(24, rng)]
    found = calibrate(as_frames(pictures), _CHECKERBOARD, lens=Lens.FISHEYE)
    assert found.rms_px < 0.15
    assert max(map(abs, off_by_sigmas(found, fisheye).values())) < 5
    seen = np.concatenate([view.sighting.pixels for view in found.views])
    off_deg = np.degrees(np.linalg.norm(found.camera.rays(seen) - fisheye.rays(seen), axis=1))
    assert np.median(off_deg) < 0.15
    assert found.camera.lens is Lens.FISHEYE
    assert set(found.sigmas) == {"fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"}


def test_a_panorama_has_nothing_to_calibrate(as_frames) -> None:
    with pytest.raises(InvalidInput, match="panorama"):
        calibrate(as_frames([_BLANK]), _CHECKERBOARD, lens=Lens.EQUIRECTANGULAR)


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


@pytest.mark.parametrize("camera", [NARROW, pytest.param(WIDE, marks=pytest.mark.slow)], ids=["67°", "170°"])
def test_the_camera_comes_back_within_its_sigmas(camera: Camera) -> None:
    for seed in range(2):
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
