"""What a trajectory's report says of a reconstruction, and why one is not trusted."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rholoc.geometry import Camera, Similarity
from rholoc.recordings import Imu, MemoryFrames, Recording, Waypoint
from rholoc.reports import ImuReport
from rholoc.trajectory import PoseMethod, Scale
from rholoc.trajectory.checks.agreement import Agreement
from rholoc.trajectory.checks.mistaken_waypoints import LeftOut
from rholoc.trajectory.frame.map_frame import MapFrame
from rholoc.trajectory.inertial.gyroscope import GyroCalibration
from rholoc.trajectory.reconstruction.outcome import InertialFigures, Reconstruction
from rholoc.trajectory.report import doubts_about, imu_report_on, report_on

_WAYPOINTS = tuple(Waypoint(name, time, (0.0, 0.0, 0.0)) for name, time in (("A", 1.0), ("B", 2.0), ("C", 3.0)))
_GYRO = GyroCalibration(0.02, 0.001, np.array([0.01, 0.0, -0.01]), 0.002, np.eye(3), False, 0.4, 0.1)
_IMU = InertialFigures(_GYRO, 0.004, np.array([0.1, 0.2, 0.3]), np.array([0.0, 0.01, 0.02]), 0.003, 1.0, 1.0, 1.2)
_SIGMA_M, _SIGMA_RAD = 0.01, 0.004


def _found(**changes: Any) -> Reconstruction:
    """Ten keyframes, eight of them placed; what is not placed is not known at all."""
    placed = np.arange(10) < 8
    one = np.diag([_SIGMA_M**2] * 3 + [_SIGMA_RAD**2] * 3)
    covariances = np.where(placed[:, None, None], one, 1e6 * np.eye(6))
    frame = MapFrame(Similarity.identity(), Scale.METRIC, True, "up", "scale", _WAYPOINTS, 0.7)
    left_out = {"A": LeftOut(np.array([0.03, 0.0, 0.04]), 1.5), "B": LeftOut(np.array([0.0, 0.5, 0.0]), 9.0)}
    camera = Camera(640, 480, 500.0, 500.0, 320.0, 240.0)
    T = np.tile(np.eye(4), (10, 1, 1))
    whole = Reconstruction(placed, T, covariances, camera, None, frame, _IMU, "", left_out, ("B",), 0.4, 123, 7, 2.5)
    return replace(whole, **changes)


def test_what_holds_together_raises_no_doubt() -> None:
    assert doubts_about(_found(), 0.9, "") == []


_OPEN = np.tile(np.diag([0.06**2] * 3 + [1e-6] * 3), (10, 1, 1))
_TURNED = np.tile(np.diag([1e-6] * 3 + [0.021**2] * 3), (10, 1, 1))
_MISSED = {"A": LeftOut(np.array([0.0, 0.11, 0.0]), 5.0)}
_FRAME = MapFrame(Similarity.identity(), Scale.METRIC, True, "up", "scale", _WAYPOINTS, doubts=("At odds.",))


@pytest.mark.parametrize(
    ("changes", "share", "says"),
    [
        ({}, 0.89, "Only 89% of the keyframes could be placed. 0:02 is missing."),
        ({"covariances": _OPEN}, 1.0, "uncertain by 10 cm"),
        ({"left_out": _MISSED, "mistaken": ()}, 1.0, "The waypoint A is missed by 0.11 m."),
        ({"imu": replace(_IMU, residual=8.1)}, 1.0, "The accelerometer contradicts the pictures."),
        ({"imu": replace(_IMU, misfit=2.6)}, 1.0, "by 3 times its noise"),
        ({"agreement": Agreement(0.5, 0.9, 1.0, 5, 5)}, 1.0, "Two reconstructions disagree"),
        ({"covariances": _TURNED}, 1.0, "rotation open by 2°"),
        ({"focal_sigma_px": 20.0}, 1.0, "focal length open by ±4.0%"),
        ({"focal_sigma_px": np.nan}, 1.0, "focal length open: turn"),
        ({"covariances": np.full((10, 6, 6), np.nan)}, 1.0, "not known how far its poses are off"),
        ({"frame": _FRAME}, 1.0, "At odds."),
    ],
)
def test_each_doubt_is_said_alone(changes: dict[str, Any], share: float, says: str) -> None:
    doubts = doubts_about(_found(**changes), share, "0:02 is missing.")
    assert len(doubts) == 1
    assert says in doubts[0]


@pytest.mark.parametrize(
    "changes",
    [
        {"covariances": _OPEN, "frame": replace(_FRAME, scale=Scale.ARBITRARY, waypoints=(), doubts=())},
        {"covariances": _TURNED, "frame": replace(_FRAME, waypoints=(), doubts=())},
        {"left_out": _MISSED, "mistaken": ("A",)},
        {"left_out": {"A": LeftOut(np.array([0.0, 0.11, 0.0]), 4.0)}, "mistaken": ()},
        {"left_out": {"A": LeftOut(np.array([0.0, 0.09, 0.0]), 9.0)}, "mistaken": ()},
        {"imu": replace(_IMU, residual=7.9, misfit=1.9)},
        {"imu": None},
        {"agreement": Agreement(0.0, 0.0, 0.1, 5, 5)},
        {"focal_sigma_px": 10.0},
    ],
)
def test_what_may_be_raises_no_doubt(changes: dict[str, Any]) -> None:
    assert doubts_about(_found(**changes), 1.0, "") == []


def test_the_report_says_what_was_found() -> None:
    report = report_on(_found(), PoseMethod.VISUAL_INERTIAL, [])
    assert (report.method, report.frames, report.keyframes) == ("visual-inertial", 8, 10)
    assert (report.landmarks, report.loop_pairs, report.reprojection_error_px) == (123, 7, 0.4)
    assert report.trusted
    assert report.expected_error_m == pytest.approx(np.sqrt(3) * _SIGMA_M)
    assert report.expected_error_deg == pytest.approx(np.degrees(np.sqrt(3) * _SIGMA_RAD))
    assert report.why == "Its poses are expected to be right to 1.7 cm."
    assert (report.up, report.scale, report.waypoints_tilt_deg) == ("up", "scale", 0.7)
    assert report.waypoint_times_s == {"A": 1.0, "B": 2.0, "C": 3.0}
    assert report.waypoint_residuals_m == pytest.approx({"A": 0.05, "B": 0.5, "C": None})
    assert report.waypoint_sigmas == {"A": 1.5, "B": 9.0, "C": None}
    assert report.waypoint_mistake is not None
    assert "B" in report.waypoint_mistake
    assert report.camera is None
    assert (report.disagreement_of_depth, report.disagreement_deg) == (None, None)


def test_without_a_scale_or_trust_the_report_says_so() -> None:
    frame = replace(_FRAME, scale=Scale.ARBITRARY, waypoints=(), doubts=())
    agreement = Agreement(np.nan, np.nan, 0.2, 1, 5)
    found = _found(frame=frame, agreement=agreement, left_out={}, mistaken=(), focal_sigma_px=5.0)
    report = report_on(found, PoseMethod.VISUAL, ["First.", "Second."])
    assert not report.trusted
    assert report.why == "First. Second."
    assert report.expected_error_m is None
    assert report.waypoint_times_s is None
    assert report.waypoint_residuals_m is None
    assert report.waypoint_mistake is None
    assert report.camera.focal_sigma_px == 5.0
    assert (report.disagreement_of_depth, report.disagreement_deg) == (None, 0.2)
    plain = report_on(_found(frame=frame, left_out={}, mistaken=()), PoseMethod.VISUAL, [])
    assert plain.why == "Pictures and IMU agree."


def test_what_is_known_of_the_imu() -> None:
    table = Imu(np.arange(2.0), np.zeros((2, 3)), np.zeros((2, 3)), True, None)
    pictures = [np.zeros((20, 20), np.uint8)] * 2
    recording = Recording(MemoryFrames(pictures), "walk", Path("walk"), None, table)
    report = imu_report_on(recording, _found())
    assert isinstance(report, ImuReport)
    assert report.time_offset_s == pytest.approx(0.023)
    assert report.not_observable == {}
    assert (report.scale_sigma, report.accelerometer_scale, report.mounting_sigma_deg) == (0.004, 1.0, 0.4)
    np.testing.assert_allclose(report.lever_m, [0, 0.01, 0.02])
    loose = imu_report_on(recording, _found(frame=replace(_FRAME, scale=Scale.ARBITRARY)))
    assert isinstance(loose, ImuReport)
    assert loose.not_observable == {"scale": "scale"}
    unused = imu_report_on(recording, _found(imu=None, imu_reason="It is of no use."))
    assert isinstance(unused, ImuReport)
    assert unused.not_observable == {"all": "It is of no use."}
    assert isinstance(imu_report_on(replace(recording, imu=None), _found()), str)
