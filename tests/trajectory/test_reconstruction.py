"""A phone's simulated walk without pictures: corners and features, IMU and waypoints → poses."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from synthetic_walk import DELAY_S, SyntheticWalk

from rholoc.errors import MappingFailed
from rholoc.geometry import FloatArray
from rholoc.progress import ProgressListener
from rholoc.recordings import Recording
from rholoc.trajectory import PoseMethod, Scale, Trajectory, estimate

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def walk() -> SyntheticWalk:
    """A walk that sees something all the time."""
    return SyntheticWalk()


def _estimated(
    walk: SyntheticWalk, recording: Recording, method: PoseMethod = PoseMethod.VISUAL_INERTIAL
) -> Trajectory:
    """The trajectory, its front end replaced by the walk's and its child process by a call."""

    def call(function: Callable[..., Any], *args: Any, progress: ProgressListener, stage: object) -> Any:
        return function(*args, progress)

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(estimate, "track_corners", walk.track_corners)
        patched.setattr(estimate, "extract_keyframe_features", walk.extract_keyframe_features)
        patched.setattr(estimate, "run_in_child", call)
        return estimate.estimate_trajectory(recording, method)


def _off_m(walk: SyntheticWalk, found: Trajectory) -> FloatArray:
    return np.linalg.norm(found.T_map_camera[:, :3, 3] - walk.T_map_camera[found.rows, :3, 3], axis=1)


@pytest.fixture(scope="module")
def measured(walk: SyntheticWalk) -> Trajectory:
    """With IMU and waypoints at their times."""
    return _estimated(walk, walk.recording())


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


def test_its_covariance_holds_its_errors(walk: SyntheticWalk, measured: Trajectory) -> None:
    assert measured.covariances is not None
    off = measured.T_map_camera[:, :3, 3] - walk.T_map_camera[measured.rows, :3, 3]
    squared = np.einsum("ni,nij,nj->n", off, np.linalg.inv(measured.covariances[:, :3, :3]), off)
    assert np.mean(squared < 7.8) > 0.7  # 95 % are expected, but they err together
    assert 0.3 * np.median(_off_m(walk, measured)) < measured.report.expected_error_m < 0.03


def test_a_recording_that_shows_nothing_fails_with_a_plain_reason() -> None:
    blank = SyntheticWalk(blank=((0.0, 99.0),))
    with pytest.raises(MappingFailed, match=r"[A-Z].*\. (Walk|Keep|Move)"):
        _estimated(blank, blank.recording(waypoints=()))
