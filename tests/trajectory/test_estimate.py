"""Recordings → frame poses: what is refused, and a small reconstruction from synthetic features."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from rholoc.trajectory.visual import structure_from_motion
from scipy.spatial.transform import Rotation

from rholoc.errors import InvalidRecording, InvalidWaypoints, MappingFailed
from rholoc.features import Channel, FeatureSet
from rholoc.geometry import ByteArray, Camera, FloatArray, align_poses, pose_matrix, rotation_angles
from rholoc.recordings import GivenPoses, MemoryFrames, Recording, Waypoint
from rholoc.trajectory import PoseMethod, Scale, estimate_trajectory

_CAMERA = Camera(640, 480, 500.0, 500.0, 319.5, 239.5, (-0.1, 0.02, 0.0, 0.0))


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


def test_given_poses_that_are_absent_are_refused_with_a_hint() -> None:
    with pytest.raises(InvalidRecording, match=r"without poses.*poses\.txt"):
        estimate_trajectory(_recording(_wall()), PoseMethod.GIVEN)


def test_a_blank_wall_fails_and_says_why() -> None:
    with pytest.raises(MappingFailed, match=r"0 of \d+ keyframes show enough texture.*blank walls"):
        estimate_trajectory(_recording(_wall()), PoseMethod.VISUAL)


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
    with pytest.raises(InvalidRecording, match="without an IMU"):
        estimate_trajectory(_recording(_wall()), PoseMethod.INERTIAL)


def test_a_rolling_shutter_is_corrected_before_structure_from_motion(monkeypatch: pytest.MonkeyPatch) -> None:
    """The image moves left by 180 px/s: rows above the middle were read earlier, further to the right than they are."""
    noise = np.random.default_rng(0).integers(0, 255, (240, 560, 3), dtype=np.uint8)
    wall = cv2.GaussianBlur(noise, (0, 0), 2)
    recording = _recording([wall[:, 6 * k : 6 * k + 320].copy() for k in range(40)])
    handed_over: list[FloatArray] = []

    def stop(function: object, features: list[FeatureSet], *_: object, **__: object) -> None:
        handed_over.append(features[1].pixels)
        raise MappingFailed("far enough")

    monkeypatch.setattr("rholoc.trajectory.estimate.run_in_child", stop)
    for readout_s in (None, 0.015):
        with pytest.raises(MappingFailed, match="far enough"):
            estimate_trajectory(replace(recording, readout_s=readout_s), PoseMethod.VISUAL)
    as_read, at_once = handed_over
    late_s = ((as_read[:, 1] + 0.5) / 240 - 0.5) * 0.015
    np.testing.assert_allclose(at_once[:, 0] - as_read[:, 0], 180 * late_s, atol=0.1)
    np.testing.assert_allclose(at_once[:, 1], as_read[:, 1], atol=0.1)


def _walk(count: int) -> FloatArray:
    """Cameras on an arc that look at the middle of a cloud of points."""
    angles = np.linspace(-0.5, 0.5, count)
    centres = np.column_stack([4 * np.sin(angles), 0.3 * np.sin(7 * angles), -4 * np.cos(angles)])
    return pose_matrix(Rotation.from_rotvec(np.outer(-angles, [0.0, 1.0, 0.0])).as_matrix(), centres)


def _features(T_world_camera: FloatArray, rng: np.random.Generator) -> list[FeatureSet]:
    points = rng.uniform(-1.3, 1.3, (400, 3))
    descriptors = rng.integers(0, 100, (400, 128), dtype=np.uint8)
    sets = []
    for T in T_world_camera:
        pixels = _CAMERA.project((points - T[:3, 3]) @ T[:3, :3]) + rng.normal(0, 0.3, (400, 2))
        seen = np.flatnonzero(_CAMERA.contains(pixels))
        rest = np.zeros(len(seen), np.float32)
        channels = np.full(len(seen), Channel.SIFT, np.uint8)
        sets.append(FeatureSet(pixels[seen].astype(np.float32), channels, descriptors[seen], rest, rest))
    return sets


def test_synthetic_features_give_back_the_poses() -> None:
    truth = _walk(24)
    found = structure_from_motion(_features(truth, np.random.default_rng(0)), _CAMERA, (640, 480))
    model = found.reconstruction
    aligned = align_poses(model.T_world_camera, truth[model.placed]).poses(model.T_world_camera)
    assert len(model.placed) == 24
    assert found.trusted
    assert np.linalg.norm(aligned[:, :3, 3] - truth[:, :3, 3], axis=1).max() < 0.02
    assert np.degrees(rotation_angles(aligned[:, :3, :3], truth[:, :3, :3])).max() < 0.3
    assert model.reprojection_error_px < 0.6
    np.testing.assert_allclose(model.parameters, [500, 500, 320, 240])  # what is known stays as it is


def test_an_unknown_camera_is_estimated() -> None:
    """Within its own uncertainty, the principal point included; and wrong by no more than a hundredth."""
    found = structure_from_motion(_features(_walk(24), np.random.default_rng(1)), None, (640, 480))
    assert found.calibration is not None
    assert found.calibration.observable
    assert found.camera.fx == pytest.approx(_CAMERA.fx, rel=0.01)
    assert abs(found.camera.fx - _CAMERA.fx) < 3 * found.calibration.focal_sigma_px
    assert found.camera.distortion[:2] == pytest.approx(_CAMERA.distortion[:2], abs=0.02)
    assert json.loads(json.dumps(found.calibration.report))["observable"]


def test_a_known_camera_is_left_as_it_is() -> None:
    found = structure_from_motion(_features(_walk(12), np.random.default_rng(1)), _CAMERA, (640, 480))
    assert found.camera == _CAMERA
    assert found.calibration is None


def test_unrelated_frames_fail_and_say_how_many_were_placed() -> None:
    rng = np.random.default_rng(2)
    sets = [_features(_walk(2), rng)[0] for _ in range(12)]
    with pytest.raises(MappingFailed, match=r"\d+ of 12 keyframes could be placed\. Walk slower"):
        structure_from_motion(sets, _CAMERA, (640, 480))
