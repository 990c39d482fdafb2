"""Recordings → frame poses: what is taken as it is, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from rholoc.errors import InvalidRecording, InvalidWaypoints, MappingFailed
from rholoc.geometry import ByteArray, Camera, FloatArray
from rholoc.recordings import GivenPoses, KnownLength, MemoryFrames, Recording, Waypoint
from rholoc.trajectory import PoseMethod, Scale
from rholoc.trajectory.estimate import estimate_trajectory
from rholoc.trajectory.reconstruction import Sights


def _recording(pictures: list[ByteArray], poses: GivenPoses | None = None) -> Recording:
    return Recording("walk", Path("walk"), MemoryFrames(pictures), Camera(160, 120, 120, 120, 80, 60), poses=poses)


def _wall(count: int = 40) -> list[ByteArray]:
    return [np.full((120, 160, 3), 200, np.uint8) for _ in range(count)]


def test_given_poses_are_taken_as_they_are() -> None:
    known = np.ones(40, bool)
    known[5:10] = False
    T = np.tile(np.eye(4), (40, 1, 1))
    T[:, 0, 3] = np.arange(40)
    found = estimate_trajectory(_recording(_wall(), GivenPoses(known, T)), PoseMethod.GIVEN)
    assert found.rows.tolist() == np.flatnonzero(known).tolist()
    np.testing.assert_array_equal(found.T_map_camera, T[known])
    assert found.scale is Scale.METRIC


def test_a_known_length_makes_poses_of_no_stated_unit_metric() -> None:
    T = np.tile(np.eye(4), (40, 1, 1))
    T[:, 0, 3] = np.arange(40)
    recording = _recording(_wall(), GivenPoses(np.ones(40, bool), T, metric=False))
    assert estimate_trajectory(recording, PoseMethod.GIVEN).scale is Scale.ARBITRARY
    known = replace(recording, lengths=(KnownLength(10, 30, 5.0),))
    found = estimate_trajectory(known, PoseMethod.GIVEN)
    assert found.scale is Scale.METRIC
    np.testing.assert_allclose(found.T_map_camera[:, 0, 3], np.arange(40) / 4)
    np.testing.assert_array_equal(found.T_map_camera[:, :3, :3], T[:, :3, :3])


def test_given_poses_that_are_absent_are_refused_with_a_hint() -> None:
    with pytest.raises(InvalidRecording, match=r"has no poses.*poses\.txt"):
        estimate_trajectory(_recording(_wall()), PoseMethod.GIVEN)


def test_a_blank_wall_fails_and_says_why() -> None:
    with pytest.raises(MappingFailed, match=r"nothing that could be followed.*keep more texture in view"):
        estimate_trajectory(_recording(_wall()), PoseMethod.VISUAL)


@pytest.mark.parametrize("method", [PoseMethod.VISUAL, PoseMethod.ODOMETRY])
def test_too_few_pictures_are_not_taken_for_a_camera_at_rest(method: PoseMethod) -> None:
    noise = np.random.default_rng(0).integers(0, 255, (3, 120, 160, 3), dtype=np.uint8)
    with pytest.raises(MappingFailed, match=r"3 pictures are too few for a map\. Take a dozen or more"):
        estimate_trajectory(_recording(list(noise)), method)


def test_a_camera_at_rest_fails_and_says_why() -> None:
    noise = np.random.default_rng(0).integers(0, 255, (120, 160, 3), dtype=np.uint8)
    with pytest.raises(MappingFailed, match="hardly moves"):
        estimate_trajectory(_recording([noise] * 40), PoseMethod.VISUAL)


def test_collinear_waypoints_are_refused_before_any_work() -> None:
    recording = _recording(_wall())
    line = tuple(Waypoint(str(i), 0.1 * i, (float(i), 0.0, 0.0)) for i in range(4))
    with pytest.raises(InvalidWaypoints):
        estimate_trajectory(Recording(**{**vars(recording), "waypoints": line}), PoseMethod.VISUAL)


def test_the_imus_way_needs_an_imu() -> None:
    with pytest.raises(InvalidRecording, match="has no IMU"):
        estimate_trajectory(_recording(_wall()), PoseMethod.INERTIAL)


def test_a_rolling_shutter_is_corrected_before_the_reconstruction(monkeypatch: pytest.MonkeyPatch) -> None:
    """The image moves left by 180 px/s: rows above the middle were read earlier, further to the right than they are."""
    noise = np.random.default_rng(0).integers(0, 255, (240, 560, 3), dtype=np.uint8)
    wall = cv2.GaussianBlur(noise, (0, 0), 2)
    recording = _recording([wall[:, 6 * k : 6 * k + 320].copy() for k in range(40)])
    handed_over: list[FloatArray] = []

    def stop(function: object, sights: Sights, *_: object, **__: object) -> None:
        handed_over.append(sights.features[1].pixels)
        raise MappingFailed("far enough")

    monkeypatch.setattr("rholoc.trajectory.estimate.run_in_child", stop)
    for readout_s in (None, 0.015):
        with pytest.raises(MappingFailed, match="far enough"):
            estimate_trajectory(replace(recording, readout_s=readout_s), PoseMethod.VISUAL)
    as_read, at_once = handed_over
    late_s = ((as_read[:, 1] + 0.5) / 240 - 0.5) * 0.015
    np.testing.assert_allclose(at_once[:, 0] - as_read[:, 0], 180 * late_s, atol=0.1)
    np.testing.assert_allclose(at_once[:, 1], as_read[:, 1], atol=0.1)
