"""Six seconds of a walk, reconstructed whole: with IMU and waypoints, and by pictures alone."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic_walk import DELAY_S, SyntheticWalk, estimated

from rholoc.geometry import FloatArray, pose_distances, umeyama
from rholoc.recordings import Waypoint
from rholoc.trajectory import PoseMethod, Scale, Trajectory

_WRONG_M = 0.3


@pytest.fixture(scope="module")
def walk() -> SyntheticWalk:
    """The first six seconds of a walk."""
    return SyntheticWalk(times=np.arange(0, 6, 0.2))


def _waypoints(walk: SyntheticWalk) -> tuple[Waypoint, ...]:
    """Where the camera truly was, every second, the fourth measured wrong."""
    rows = np.arange(2, len(walk.times), 5)
    places = walk.T_map_camera[rows, :3, 3] + np.where(np.arange(len(rows)) == 3, _WRONG_M, 0.0)[:, None] * [0, 0, 1]
    return tuple(
        Waypoint(f"P{i}", float(walk.times[row]), tuple(place))
        for i, (row, place) in enumerate(zip(rows, places, strict=True))
    )


def _truth(walk: SyntheticWalk, found: Trajectory) -> FloatArray:
    return walk.T_map_camera[found.rows]


def test_with_imu_and_waypoints_one_of_which_is_wrong(walk: SyntheticWalk) -> None:
    found = estimated(walk, walk.recording(waypoints=_waypoints(walk)), PoseMethod.VISUAL_INERTIAL)
    off_m, off_rad = pose_distances(found.T_map_camera, _truth(walk, found))
    report = found.report
    assert found.scale is Scale.METRIC
    assert found.upright
    assert len(found.rows) == report.keyframes == report.frames > 25
    assert np.median(off_m) < 0.015
    assert off_m.max() < 0.05
    assert np.degrees(np.median(off_rad)) < 0.5
    assert report.waypoint_mistake is not None
    assert "P3" in report.waypoint_mistake
    assert report.waypoint_residuals_m["P3"] == pytest.approx(_WRONG_M, abs=0.05)
    assert max(off for name, off in report.waypoint_residuals_m.items() if name != "P3") < 0.05
    assert 0.2 < report.reprojection_error_px < 0.6
    assert report.imu.time_offset_s == pytest.approx(DELAY_S, abs=0.01)
    assert report.imu.accelerometer_scale == pytest.approx(1.0, abs=0.05)
    np.testing.assert_allclose(np.linalg.det(np.array(report.imu.R_camera_imu)), 1, atol=1e-6)
    assert 0.2 * np.median(off_m) < report.expected_error_m < 0.05
    assert found.covariances is not None
    assert np.linalg.eigvalsh(found.covariances).min() > 0


@pytest.mark.slow
def test_by_pictures_alone_the_shape_is_right(walk: SyntheticWalk) -> None:
    found = estimated(walk, walk.recording(imu=None, waypoints=()), PoseMethod.VISUAL)
    assert found.scale is Scale.ARBITRARY
    to_truth = umeyama(found.T_map_camera[:, :3, 3], _truth(walk, found)[:, :3, 3])
    off_m, off_rad = pose_distances(to_truth.poses(found.T_map_camera), _truth(walk, found))
    assert len(found.rows) > 25
    assert np.median(off_m) < 0.02
    assert np.degrees(np.median(off_rad)) < 1.0
    assert found.report.disagreement_of_depth < 0.02
    assert found.report.trusted, found.report.why
    assert found.report.expected_error_m is None
