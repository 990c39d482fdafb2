"""Reports to JSON and back."""

import json
import math

import numpy as np
import pytest

from rholoc.reports import (
    Advice,
    AdviceKind,
    CalibrationReport,
    ImuReport,
    InertialComparison,
    MapReport,
    TrajectoryReport,
    report_from_json,
    report_to_json,
)

FULL = TrajectoryReport(
    method="visual-inertial",
    frames=60,
    trusted=False,
    why="A waypoint is missed by 0.20 m.",
    disagreement_deg=0.3,
    camera=CalibrationReport(525.0, 2.0, None, True, "Known."),
    imu=ImuReport(
        not_observable={"mounting": "It hardly turns."},
        time_offset_s=0.01,
        gyro_bias_rad_per_s=(0.1, 0.2, 0.3),
        R_camera_imu=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    ),
    inertial=InertialComparison(frames=50, rms_m=0.1, worst_m=0.2, worst_time_s=3.0),
    waypoint_times_s={"A": 1.5},
    waypoint_residuals_m={"A": 0.01, "B": None},
)


def test_a_report_comes_back_from_its_json() -> None:
    assert report_from_json(TrajectoryReport, json.loads(json.dumps(report_to_json(FULL)))) == FULL


def test_a_reason_in_place_of_imu_figures_comes_back() -> None:
    without = TrajectoryReport("visual", imu="The recording has no IMU; the poses are visual alone.")
    assert report_from_json(TrajectoryReport, report_to_json(without)) == without


def test_members_without_a_value_are_left_out_and_required_ones_are_null() -> None:
    assert report_to_json(TrajectoryReport("given", 3)) == {"method": "given", "frames": 3, "why": ""}
    assert report_to_json(CalibrationReport(1.0, 2.0, None, True, ""))["centre_sigma_px"] is None


def test_unknown_members_are_left_out() -> None:
    later = {"method": "given", "a_later_version_knows": [1]}
    assert report_from_json(TrajectoryReport, later) == TrajectoryReport("given")


def test_numbers_of_numpy_become_plain_and_what_is_not_finite_becomes_null() -> None:
    plain = report_to_json({"a": np.float32(0.5), "b": [math.nan, np.inf], "c": np.arange(2)})
    assert json.dumps(plain) == '{"a": 0.5, "b": [null, null], "c": [0, 1]}'


@pytest.mark.parametrize("broken", [{}, {"method": 3}, {"method": "given", "frames": "many"}, [1], None])
def test_json_that_is_no_report_is_refused(broken: object) -> None:
    with pytest.raises(ValueError, match=r"TrajectoryReport|method|frames"):
        report_from_json(TrajectoryReport, broken)


def test_what_was_walked_later_is_still_read() -> None:
    later = {"kind": "a_later_kind", "text": "Walk backwards.", "figure": 1.0, "limit": 0.5}
    assert report_from_json(Advice, later).kind == "a_later_kind"
    assert report_from_json(Advice, later | {"kind": "too_fast"}).kind is AdviceKind.TOO_FAST


def test_the_example_of_a_report_is_a_report_and_what_is_sent(openapi) -> None:
    example = openapi["components"]["schemas"]["MapReportOut"]["example"]["report"]
    assert json.loads(json.dumps(report_to_json(report_from_json(MapReport, example)))) == example
