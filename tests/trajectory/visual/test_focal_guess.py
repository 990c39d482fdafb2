"""A first guess of the focal length; what is said of a focal length that a walk was to show."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from synthetic_walk import DELAY_S, SyntheticWalk, followed

from rholoc.geometry import Camera, FloatArray, pose_matrix
from rholoc.simulation import PHONE_CAMERA
from rholoc.trajectory.visual.calibration_report import calibration_report
from rholoc.trajectory.visual.flow import Flow
from rholoc.trajectory.visual.focal_guess import (
    calibrate_by_flow,
    camera_by_matches,
    centred_camera,
    guess_camera,
    zoom_by_matches,
)


@pytest.fixture(scope="module")
def walk() -> SyntheticWalk:
    """Eight seconds of a walk."""
    return SyntheticWalk(seed=2, times=np.arange(4.0, 12.0, 0.2))


def test_the_principal_point_is_in_the_middle() -> None:
    camera = centred_camera((640, 480), 500.0)
    assert (camera.cx, camera.cy, camera.fx, camera.fy) == (319.5, 239.5, 500.0, 500.0)


def test_a_stated_focal_length_is_where_pictures_start_from(walk: SyntheticWalk) -> None:
    assert guess_camera(walk.flow, None, 555.0).focal == pytest.approx(555.0)


def test_the_gyroscope_is_calibrated_by_followed_corners(walk: SyntheticWalk) -> None:
    found = calibrate_by_flow(walk.flow, PHONE_CAMERA, walk.imu)
    assert found.fits
    assert found.time_offset_s == pytest.approx(DELAY_S, abs=0.006)


def test_the_focal_length_is_that_at_which_pictures_turn_as_the_gyroscope_does(walk: SyntheticWalk) -> None:
    found = guess_camera(walk.flow, replace(walk.imu, R_camera_imu=None))
    assert found.focal == pytest.approx(PHONE_CAMERA.focal, rel=0.06)


@pytest.mark.slow
def test_without_a_gyroscope_the_pictures_give_one_that_is_plausible(walk: SyntheticWalk) -> None:
    found = guess_camera(walk.flow, None)
    assert found.focal == pytest.approx(PHONE_CAMERA.focal, rel=0.25)


def test_a_camera_that_shows_nothing_gets_the_usual_one() -> None:
    blank = SyntheticWalk(times=np.arange(0.0, 2.0, 0.2), blank=((0.0, 99.0),))
    found = guess_camera(blank.flow, blank.imu)
    assert 0.7 < found.focal / max(blank.flow.size) < 1.0


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


@pytest.mark.parametrize("share", [0.7, pytest.param(1.1, marks=pytest.mark.slow)])
def test_perfect_pictures_show_the_focal_length_alone(share: float) -> None:
    assert guess_camera(_sideways(share * 640), None).focal == pytest.approx(share * 640, rel=0.02)


def _matched(camera: Camera, noise_px: float = 0.3) -> list[tuple[FloatArray, FloatArray]]:
    """Pixels of the same points in each two of six pictures from anywhere, in no order."""
    rng = np.random.default_rng(2)
    points = rng.uniform([-3, -2, 2.5], [3, 2, 6], (90, 3))
    poses = [(Rotation.from_rotvec(rng.normal(0, 0.1, 3)).as_matrix(), rng.normal(0, 0.4, 3)) for _ in range(6)]
    seen = [camera.project((points - at) @ R) + rng.normal(0, noise_px, (90, 2)) for R, at in poses]
    return [(a, b) for k, a in enumerate(seen) for b in seen[:k]]


def test_pairs_of_a_set_give_the_focal_length_that_they_agree_on() -> None:
    found = camera_by_matches(_matched(centred_camera((640, 480), 420.0)), (640, 480))
    assert found.focal == pytest.approx(420.0, rel=0.08)


def test_pairs_of_a_set_show_barrel_distortion() -> None:
    bulging = replace(centred_camera((640, 480), 390.0), distortion=(-0.28, 0.07, 0.0, 0.0))
    found = camera_by_matches(_matched(bulging), (640, 480))
    assert found.distortion[0] == pytest.approx(-0.28, abs=0.05)
    assert found.focal == pytest.approx(390.0, rel=0.12)


def test_pairs_that_do_not_agree_give_no_camera() -> None:
    rng = np.random.default_rng(3)
    chance = [(rng.uniform(0, 480, (80, 2)), rng.uniform(0, 480, (80, 2))) for _ in range(12)]
    assert camera_by_matches(chance, (640, 480)) is None
    assert camera_by_matches([], (640, 480)) is None


def _pairs_of_two_lenses(zoom: float, flat: bool, apart: float = 0.4) -> list[tuple[FloatArray, FloatArray]]:
    """Pixels of points in pictures by a camera, and up to so far ``apart`` along each axis by one whose focal length is
    ``zoom`` times as long.
    """
    rng = np.random.default_rng(5)
    camera = centred_camera((640, 480), 500.0)
    longer = replace(camera, fx=zoom * camera.fx, fy=zoom * camera.fy)
    pairs = []
    for _ in range(12):
        points = rng.uniform([-1, -0.8, 2.0], [1, 0.8, 2.0 if flat else 4.0], (80, 3))
        T = pose_matrix(Rotation.from_rotvec(rng.uniform(-0.1, 0.1, 3)).as_matrix(), rng.uniform(-apart, apart, 3))
        moved = (points - T[:3, 3]) @ T[:3, :3]
        pairs.append(
            (camera.project(points) + rng.normal(0, 0.3, (80, 2)), longer.project(moved) + rng.normal(0, 0.3, (80, 2)))
        )
    return pairs


@pytest.mark.parametrize(("zoom", "apart"), [(0.6, 0.1), pytest.param(1.7, 0.4, marks=pytest.mark.slow)])
def test_a_second_lens_is_measured_by_what_both_saw(zoom: float, apart: float) -> None:
    found = zoom_by_matches(centred_camera((640, 480), 500.0), _pairs_of_two_lenses(zoom, flat=False, apart=apart))
    assert found == pytest.approx(zoom, rel=0.03)


def test_a_wall_does_not_tell_a_longer_lens_from_a_step_ahead() -> None:
    camera = centred_camera((640, 480), 500.0)
    assert zoom_by_matches(camera, _pairs_of_two_lenses(1.4, flat=True)) is None
    assert zoom_by_matches(camera, []) is None
    assert zoom_by_matches(camera, [(np.zeros((9, 2)), np.zeros((9, 2)))]) is None


@pytest.mark.parametrize(("sigma_px", "observable"), [(5.0, True), (14.9, True), (15.1, False), (200.0, False)])
def test_a_focal_length_within_three_percent_counts_as_known(sigma_px: float, observable: bool) -> None:
    report = calibration_report(centred_camera((640, 480), 500.0), sigma_px, 12)
    assert report.observable is observable
    assert f"±{sigma_px / 500:.1%}" in report.why
    assert ("turn and walk sideways" in report.why) is not observable


def test_a_handful_of_pictures_leaves_it_open() -> None:
    """Of four, the map was trusted with a focal length that was off by five of its standard deviations."""
    camera = centred_camera((640, 480), 500.0)
    assert calibration_report(camera, 5.0, 6).observable
    report = calibration_report(camera, 5.0, 5)
    assert not report.observable
    assert report.why == "5 pictures leave the camera's focal length open: take a dozen, or calibrate the camera."


@pytest.mark.parametrize(
    ("focal_px", "distortion", "observable"),
    [
        (450.0, (-0.265, 0.056, 0.0, 0.0), False),  # of an action camera's fisheye
        (585.0, (-0.283, 0.074, 0.0, 0.0), True),  # of a robot's wide pinhole camera
        (345.0, (), True),  # a phone's ultra-wide camera, whose pictures are corrected
        (700.0, (-0.28, 0.07, 0.0, 0.0), True),  # as distorted, but not wide
    ],
)
def test_pictures_alone_do_not_calibrate_a_fisheye(
    focal_px: float, distortion: tuple[float, ...], observable: bool
) -> None:
    """A trusted map of forty fisheye pictures was 9 cm off where 1.4 cm was expected."""
    report = calibration_report(replace(centred_camera((960, 720), focal_px), distortion=distortion), 1.0, 40)
    assert report.observable is observable
    assert ("is a fisheye" in report.why) is not observable
