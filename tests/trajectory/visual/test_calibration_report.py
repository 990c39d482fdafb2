"""What is said of a focal length that a walk was to show."""

from __future__ import annotations

import pytest

from rholoc.trajectory.visual.calibration_report import calibration_report
from rholoc.trajectory.visual.focal_guess import centred_camera


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
