"""A phone's simulated walk without pictures: corners and features, IMU and waypoints → poses."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from synthetic_walk import DELAY_S, SyntheticWalk, estimated

from rholoc.errors import MappingFailed
from rholoc.geometry import UP, FloatArray, angles_between, umeyama
from rholoc.recordings import Waypoint
from rholoc.simulation import PHONE_CAMERA
from rholoc.trajectory import PoseMethod, Scale, Trajectory
from rholoc_lab.evaluation.odometry import measure_odometry

pytestmark = pytest.mark.slow

_WALLS_S = ((11.0, 12.2), (19.0, 20.0))
_HALF_S = np.arange(0.0, 16.0, 0.2)


@pytest.fixture(scope="module")
def walk() -> SyntheticWalk:
    """A walk that sees something all the time."""
    return SyntheticWalk()


@pytest.fixture(scope="module")
def half() -> SyntheticWalk:
    """Its first half, past the third waypoint."""
    return SyntheticWalk(times=_HALF_S)


@pytest.fixture(scope="module")
def torn() -> SyntheticWalk:
    """The same past two blank walls, each for a second."""
    return SyntheticWalk(blank=_WALLS_S)


def _off_m(walk: SyntheticWalk, found: Trajectory) -> FloatArray:
    return np.linalg.norm(found.T_map_camera[:, :3, 3] - walk.T_map_camera[found.rows, :3, 3], axis=1)


@pytest.fixture(scope="module")
def measured(made_once: Any, walk: SyntheticWalk) -> Trajectory:
    """With IMU and waypoints at their times."""
    return made_once("measured", lambda: estimated(walk, walk.recording()))


def test_pictures_imu_and_waypoints_place_all_to_a_centimetre(walk: SyntheticWalk, measured: Trajectory) -> None:
    off_m = _off_m(walk, measured)
    report = measured.report
    assert report.trusted, report.why
    assert measured.scale is Scale.METRIC
    assert measured.upright
    assert report.frames == report.keyframes == len(measured.rows) >= 60
    assert not report.missing
    assert np.median(off_m) < 0.01
    assert off_m.max() < 0.03
    assert report.waypoint_mistake is None
    assert set(report.waypoint_sigmas) == {"START", "W1", "W2", "W3", "E"}
    assert max(report.waypoint_sigmas.values()) < 4
    assert report.imu.time_offset_s == pytest.approx(DELAY_S, abs=0.003)
    assert report.inertial.rms_m < 0.3


def test_odometry_looks_for_no_features_and_meets_no_waypoint(half: SyntheticWalk) -> None:
    found = estimated(half, half.recording(), PoseMethod.ODOMETRY)
    assert found.report.loop_pairs == 0
    assert found.scale is Scale.METRIC
    assert found.upright
    assert found.report.waypoint_times_s is None
    measured = measure_odometry(found.T_map_camera, half.T_map_camera[found.rows], found.upright)
    assert measured.scale == pytest.approx(1, abs=0.03)
    assert measured.rms_m < 0.05


def test_odometry_follows_corners_through_two_pictures_a_second_too() -> None:
    """They count as a set, which has matches elsewhere."""
    walk = SyntheticWalk(times=np.arange(0, 20, 0.5))
    found = estimated(walk, replace(walk.recording(), imu=None, waypoints=()), PoseMethod.ODOMETRY)
    assert len(found.rows) == len(walk.times)


def test_its_covariance_holds_its_errors(walk: SyntheticWalk, measured: Trajectory) -> None:
    off = measured.T_map_camera[:, :3, 3] - walk.T_map_camera[measured.rows, :3, 3]
    squared = np.einsum("ni,nij,nj->n", off, np.linalg.inv(measured.covariances[:, :3, :3]), off)
    assert np.mean(squared < 7.8) > 0.7  # 95 % are expected, but they err together
    assert 0.3 * np.median(_off_m(walk, measured)) < measured.report.expected_error_m < 0.03


def test_waypoints_in_order_and_an_imu_of_unknown_mounting(walk: SyntheticWalk) -> None:
    unknown = replace(walk.imu, R_camera_imu=None)
    in_order = tuple(replace(waypoint, time=float("nan")) for waypoint in walk.waypoints)
    found = estimated(walk, walk.recording(imu=unknown, waypoints=in_order))
    assert found.report.trusted, found.report.why
    assert np.median(_off_m(walk, found)) < 0.01
    assert list(found.report.waypoint_times_s) == ["START", "W1", "W2", "W3", "E"]
    np.testing.assert_allclose(list(found.report.waypoint_times_s.values()), walk.walk.pause_times, atol=0.4)


def test_the_imu_alone_gives_scale_and_gravity(half: SyntheticWalk) -> None:
    found = estimated(half, half.recording(waypoints=()))
    assert found.scale is Scale.METRIC
    assert found.upright
    to_truth = umeyama(found.T_map_camera[:, :3, 3], half.T_map_camera[found.rows, :3, 3])
    assert to_truth.scale == pytest.approx(1, abs=0.03)
    assert np.degrees(angles_between(to_truth.rotation[2], UP)) < 0.5
    np.testing.assert_allclose(found.T_map_camera[0, :3, 3], 0, atol=1e-9)


def test_an_unknown_camera_is_estimated(half: SyntheticWalk) -> None:
    found = estimated(half, half.recording(camera=None, waypoints=half.waypoints[:3]))
    assert found.camera.focal == pytest.approx(PHONE_CAMERA.focal, rel=0.02)
    assert abs(found.camera.fx - PHONE_CAMERA.fx) < 4 * found.report.camera.focal_sigma_px
    assert np.median(_off_m(half, found)) < 0.02


def test_a_second_before_a_blank_wall_is_bridged_by_the_imu(torn: SyntheticWalk) -> None:
    found = estimated(torn, torn.recording())
    off_m = _off_m(torn, found)
    blank = np.any([(found.times >= a) & (found.times < b) for a, b in _WALLS_S], axis=0)
    assert np.median(off_m) < 0.015
    assert blank.any(), "no keyframe before the walls was placed"
    assert off_m[blank].max() < 0.06


def test_without_an_imu_the_larger_piece_is_published_and_the_missing_seconds_are_named() -> None:
    """A blank wall at two thirds of the way, and another room behind it."""
    torn = SyntheticWalk(times=_HALF_S[:55], blank=((6.5, 7.5),), other_room_from_s=7.0)
    found = estimated(torn, torn.recording(imu=None, waypoints=()), PoseMethod.VISUAL)
    assert found.times.max() < 7
    assert found.report.missing
    last = found.report.missing[-1]
    assert last.start_s == pytest.approx(6.5, abs=1.0)
    assert last.end_s == pytest.approx(10.8, abs=0.3)
    assert "0:" in found.report.why
    to_truth = umeyama(found.T_map_camera[:, :3, 3], torn.T_map_camera[found.rows, :3, 3])
    off_m = np.linalg.norm(to_truth.points(found.T_map_camera[:, :3, 3]) - torn.T_map_camera[found.rows, :3, 3], axis=1)
    assert np.median(off_m) < 0.02


@pytest.mark.parametrize("useless", ["noise", "clock"])
def test_a_useless_imu_falls_back_to_pictures_and_says_so(useless: str) -> None:
    walk = SyntheticWalk(times=_HALF_S[:40])
    if useless == "noise":
        rng = np.random.default_rng(0)
        imu = replace(walk.imu, angular_velocity=rng.normal(0, 1.5, walk.imu.angular_velocity.shape))
    else:
        imu = replace(walk.imu, times=walk.imu.times + 1000)
    met = [Waypoint(f"W{row}", walk.times[row], tuple(walk.T_map_camera[row, :3, 3])) for row in (1, 12, 25, 38)]
    found = estimated(walk, walk.recording(imu=imu, waypoints=tuple(met)))
    assert np.median(_off_m(walk, found)) < 0.03
    reason = found.report.imu.not_observable["all"]
    assert "from the pictures alone" in reason


def test_a_recording_that_shows_nothing_fails_with_a_plain_reason() -> None:
    blank = SyntheticWalk(blank=((0.0, 99.0),))
    with pytest.raises(MappingFailed, match=r"[A-Z].*\. (Walk|Keep|Move)"):
        estimated(blank, blank.recording(waypoints=()))


def test_waypoints_of_another_walk_are_refused(walk: SyntheticWalk) -> None:
    places = ((0.0, 0.0, 0.0), (9.0, 0.0, 0.0), (0.0, 9.0, 0.0), (5.0, 5.0, 5.0), (-9.0, 2.0, 1.0))
    elsewhere = tuple(Waypoint(w.name, w.time, place) for w, place in zip(walk.waypoints, places, strict=True))
    with pytest.raises(MappingFailed, match="misses the waypoints"):
        estimated(walk, walk.recording(waypoints=elsewhere))
