"""A first guess of the focal length."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from synthetic_walk import DELAY_S, SyntheticWalk, followed

from rholoc.geometry import Camera, FloatArray
from rholoc.recordings import Imu
from rholoc.simulation import PHONE_CAMERA
from rholoc.trajectory.inertial.gyroscope import GyroCalibration
from rholoc.trajectory.visual import camera_guess
from rholoc.trajectory.visual.camera_guess import calibrate_by_flow, centred_camera, guess_camera
from rholoc.trajectory.visual.flow import Flow


@pytest.fixture(scope="module")
def walk() -> SyntheticWalk:
    """Twelve seconds of a walk."""
    return SyntheticWalk(seed=2, times=np.arange(4.0, 16.0, 0.2))


def test_the_principal_point_is_in_the_middle() -> None:
    camera = centred_camera((640, 480), 500.0)
    assert (camera.cx, camera.cy, camera.fx, camera.fy) == (319.5, 239.5, 500.0, 500.0)


def test_a_stated_focal_length_is_where_pictures_start_from(
    walk: SyntheticWalk, monkeypatch: pytest.MonkeyPatch
) -> None:
    longer = max(walk.flow.size)
    monkeypatch.setattr(camera_guess, "_focal_by_pictures", lambda _: 0.7)
    monkeypatch.setattr(camera_guess, "_focal_by_gyroscope", lambda *_: 0.8)
    assert guess_camera(walk.flow, None, 555.0).focal == pytest.approx(555.0)
    assert guess_camera(walk.flow, None).focal == pytest.approx(0.7 * longer)
    assert guess_camera(walk.flow, walk.imu, 555.0).focal == pytest.approx(0.8 * longer)


def test_the_gyroscope_is_calibrated_by_followed_corners(walk: SyntheticWalk) -> None:
    found = calibrate_by_flow(walk.flow, PHONE_CAMERA, walk.imu)
    assert found is not None
    assert found.fits
    assert found.time_offset_s == pytest.approx(DELAY_S, abs=0.006)


def test_the_focal_length_is_that_at_which_pictures_turn_as_the_gyroscope_does(walk: SyntheticWalk) -> None:
    found = guess_camera(walk.flow, replace(walk.imu, R_camera_imu=None))
    assert found.focal == pytest.approx(PHONE_CAMERA.focal, rel=0.06)


def test_without_a_gyroscope_the_pictures_give_one_that_is_plausible(walk: SyntheticWalk) -> None:
    found = guess_camera(walk.flow, None)
    assert found.focal == pytest.approx(PHONE_CAMERA.focal, rel=0.25)


@pytest.mark.slow
def test_a_camera_that_shows_nothing_gets_the_usual_one() -> None:
    blank = SyntheticWalk(times=np.arange(0.0, 6.0, 0.2), blank=((0.0, 99.0),))
    found = guess_camera(blank.flow, blank.imu)
    assert 0.7 < found.focal / max(blank.flow.size) < 1.0


_IMU = Imu(np.arange(2.0), np.zeros((2, 3)), np.zeros((2, 3)), True, None)


def _by_gyroscope(
    monkeypatch: pytest.MonkeyPatch, walk: SyntheticWalk, residual_deg: Callable[[float], float | None]
) -> float | None:
    """The focal length found where the gyroscope leaves so much at a share of the image's longer side."""
    tried: list[float] = []

    def calibrate(flow: object, camera: Camera, imu: Imu, most: int | None = None) -> GyroCalibration | None:
        assert most == 200
        tried.append(round(camera.focal / max(walk.flow.size), 4))
        left = residual_deg(camera.focal / max(walk.flow.size))
        return None if left is None else GyroCalibration(0.0, 0.0, np.zeros(3), 0.0, np.eye(3), False, 0.0, left)

    monkeypatch.setattr(camera_guess, "calibrate_by_flow", calibrate)
    found = camera_guess._focal_by_gyroscope(walk.flow, _IMU)
    assert len(tried) == len(set(tried)), "a residual was computed twice"
    assert set(np.arange(0.6, 1.31, 0.1).round(4)) <= set(tried)
    return found


@pytest.mark.parametrize("share", [0.63, 0.7, 0.775, 0.91, 1.04, 1.27])
def test_a_parabolas_lowest_point_is_found(share: float, walk: SyntheticWalk, monkeypatch: pytest.MonkeyPatch) -> None:
    found = _by_gyroscope(monkeypatch, walk, lambda tried: 0.2 + 10 * (tried - share) ** 2)
    assert found == pytest.approx(share, abs=1e-6)


def test_where_the_walk_does_not_show_it_nothing_is_found(walk: SyntheticWalk, monkeypatch: pytest.MonkeyPatch) -> None:
    assert _by_gyroscope(monkeypatch, walk, lambda tried: 1.0 - 0.09 * (abs(tried - 0.9) < 0.01)) is None
    assert _by_gyroscope(monkeypatch, walk, lambda tried: 1.0 - 0.11 * (abs(tried - 0.9) < 0.01)) is not None
    assert _by_gyroscope(monkeypatch, walk, lambda tried: None) is None
    assert _by_gyroscope(monkeypatch, walk, lambda tried: 2.1) is None  # the gyroscope fits nowhere
    plausible = _by_gyroscope(
        monkeypatch, walk, lambda tried: 0.5 if 0.76 < tried < 0.82 else 1.5 if tried < 0.76 else 2.1
    )
    assert plausible == pytest.approx(0.8), "on one side nothing is known"


def test_of_long_walks_the_middle_shows_the_gyroscope(walk: SyntheticWalk, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rotations are of frames a fifth of a second apart, from 15 corners on, chained from the first."""
    asked: list[FloatArray] = []

    def calibrate(times: FloatArray, R: FloatArray, imu: Imu) -> None:
        asked.extend((times, R))

    monkeypatch.setattr(camera_guess, "calibrate_gyro", calibrate)
    camera_guess.calibrate_by_flow(walk.flow, PHONE_CAMERA, walk.imu)
    times, R = asked
    assert np.diff(times).min() >= 0.2
    assert len(times) > 45
    true = walk.T_map_camera[np.searchsorted(walk.times, times), :3, :3]
    turned = Rotation.from_matrix(R[0].T @ R) * Rotation.from_matrix(true[0].T @ true).inv()
    assert np.degrees(turned.magnitude()[:5]).max() < 2
    camera_guess.calibrate_by_flow(walk.flow, PHONE_CAMERA, walk.imu, 21)
    before = (len(times) - 21) // 2
    np.testing.assert_array_equal(asked[2], times[before : before + 21])
    camera_guess.calibrate_by_flow(walk.flow, PHONE_CAMERA, walk.imu, len(times))
    np.testing.assert_array_equal(asked[4], times)


@pytest.mark.parametrize(("corners", "turned"), [(14, False), (15, True)])
def test_fewer_than_fifteen_corners_show_no_rotation(
    corners: int, turned: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform([-1.5, -1, 3], [1.5, 1, 6], (corners, 3))
    R = Rotation.from_euler("y", [[0], [4]], degrees=True).as_matrix()
    pixels = np.array([PHONE_CAMERA.project((points - [0.2 * k, 0, 0]) @ R[k]) for k in range(2)])
    flow = followed(
        np.array([0.0, 0.2]), (PHONE_CAMERA.width, PHONE_CAMERA.height), pixels, np.ones((2, corners), bool)
    )
    asked: list[FloatArray] = []
    monkeypatch.setattr(camera_guess, "calibrate_gyro", lambda times, R, imu: asked.append(R))
    camera_guess.calibrate_by_flow(flow, PHONE_CAMERA, _IMU)
    angle_deg = np.degrees(Rotation.from_matrix(asked[0][0].T @ asked[0][1]).as_rotvec())
    np.testing.assert_allclose(angle_deg, [0, 4 if turned else 0, 0], atol=0.05)


def _sideways(focal_px: float, frames: int = 80, corners: int = 60) -> Flow:
    """What a camera without distortion sees that swings past things, a hundredth of its picture at a time."""
    rng = np.random.default_rng(1)
    camera = centred_camera((640, 480), focal_px)
    points = rng.uniform([-2, -1.5, 2], [2, 1.5, 6], (corners, 3))
    pixels = []
    for k in range(frames):
        R = Rotation.from_rotvec([0.10 * np.sin(k / 9), 0.10 * np.cos(k / 7), 0.05 * np.sin(k / 5)]).as_matrix()
        at = np.array([0.5 * np.sin(k / 6), 0.4 * np.cos(k / 8), 0.3 * np.sin(k / 10)])
        pixels.append(camera.project((points - at) @ R))
    return followed(np.arange(frames) / 10, (640, 480), np.array(pixels), np.ones((frames, corners), bool))


@pytest.mark.parametrize("share", [0.7, 1.1])
def test_perfect_pictures_show_the_focal_length_alone(share: float) -> None:
    assert camera_guess._focal_by_pictures(_sideways(share * 640)) == pytest.approx(share, rel=0.02)


def test_implausible_focal_lengths_and_too_few_corners_are_not_believed(monkeypatch: pytest.MonkeyPatch) -> None:
    assert camera_guess._focal_by_pictures(_sideways(600, corners=29)) is None
    assert camera_guess._focal_by_pictures(_sideways(600, corners=31)) is not None
    flow = _sideways(600, corners=40)
    pairs: list[int] = []

    def found(focal_px: float, agreeing: int, of: int = 100) -> float | None:
        pairs.clear()

        def shared(a: FloatArray, b: FloatArray) -> tuple[float, int]:
            pairs.append(len(a))
            return (focal_px, agreeing) if len(pairs) <= of else (1.0, agreeing)

        monkeypatch.setattr(camera_guess, "_shared_focal", shared)
        return camera_guess._focal_by_pictures(flow)

    assert found(600.0, 29) == pytest.approx(600 / 640)
    assert len(pairs) == 60
    assert found(600.0, 28) is None  # seven in ten must agree
    assert found(0.51 * 640, 40) == pytest.approx(0.51)
    assert found(0.49 * 640, 40) is None
    assert found(1.99 * 640, 40) == pytest.approx(1.99)
    assert found(2.01 * 640, 40) is None
    assert found(600.0, 40, of=10) is not None  # a sixth of the pairs
    assert found(600.0, 40, of=9) is None


def test_pairs_of_pictures_are_a_twelfth_of_their_side_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    flow = replace(_sideways(600, corners=40), motion=np.full(80, 0.02))
    compared: list[tuple[int, int]] = []
    shared = type(flow).shared

    def spy(self: object, a: int, b: int) -> object:
        compared.append((a, b))
        return shared(flow, a, b)

    monkeypatch.setattr(type(flow), "shared", spy)
    camera_guess._focal_by_pictures(flow)
    assert len(compared) == 60
    assert all(3 <= b - a <= 5 for a, b in compared)
    assert compared[0][0] == 0
    assert compared[-1][1] == 79
