"""Recordings → frame poses: what is taken as it is, and what is refused."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from failing import fail
from synthetic_walk import DELAY_S, SyntheticWalk, estimated

from rholoc.errors import InvalidRecording, InvalidWaypoints, MappingFailed
from rholoc.geometry import ByteArray, Camera, FloatArray, align_poses, pose_distances, umeyama
from rholoc.progress import Stage, silent
from rholoc.recordings import GivenPoses, KnownLength, MemoryFrames, PoseKind, Recording, Waypoint, read_recording
from rholoc.simulation import PHONE_CAMERA, Renderer, Scene, make_walk
from rholoc.trajectory import PoseMethod, Scale, Trajectory
from rholoc.trajectory.checks.given_poses import PoseAxes, PoseCheck
from rholoc.trajectory.child import ReconstructionBroken, run_in_child
from rholoc.trajectory.estimate import estimate_trajectory
from rholoc.trajectory.reconstruction import Sights


def _recording(pictures: list[ByteArray], poses: GivenPoses | None = None) -> Recording:
    return Recording(MemoryFrames(pictures), "walk", Path("walk"), Camera(160, 120, 120, 120, 80, 60), poses=poses)


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
        estimate_trajectory(_recording(_wall(12)), PoseMethod.VISUAL)


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
    recording = _recording([wall[:, 6 * k : 6 * k + 320].copy() for k in range(24)])
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


def test_weak_features_count_in_a_set_of_dim_pictures_whose_given_poses_drift(monkeypatch: pytest.MonkeyPatch) -> None:
    """Poses by ARKit of a dim room were adjusted to the few features that such pictures show plainly."""
    noise = np.random.default_rng(0).normal(0, 1, (240, 400)).astype(np.float32)
    wall = (100 + 20 * cv2.GaussianBlur(noise, (0, 0), 2)).round().clip(0, 255).astype(np.uint8)
    pictures = [np.repeat(wall[:, 10 * k : 10 * k + 320, None], 3, axis=2) for k in range(6)]
    T = np.tile(np.eye(4), (6, 1, 1))
    T[:, 0, 3] = 0.1 * np.arange(6)
    drifting = _recording(pictures, GivenPoses(np.ones(6, bool), T, kind=PoseKind.ODOMETRY))
    found: list[int] = []

    def stop(function: object, sights: Sights, *_: object, **__: object) -> None:
        found.append(min(map(len, sights.features)))
        raise MappingFailed("far enough")

    usable = PoseCheck(PoseAxes.AS_DOCUMENTED, 0.005, 10)
    monkeypatch.setattr("rholoc.trajectory.estimate.check_given_poses", lambda *_: usable)
    monkeypatch.setattr("rholoc.trajectory.estimate.run_in_child", stop)
    for recording in (replace(drifting, poses=None), drifting):
        with pytest.raises(MappingFailed, match="far enough"):
            estimate_trajectory(recording, PoseMethod.AUTO)
    assert found[1] == found[0] > 200


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "The reconstruction stopped at an unexpected error: RuntimeError"),
        ("out of range", "The reconstruction stopped at an unexpected error: RuntimeError: out of range"),
        (
            "\nIndeterminant linear system detected while working near variable\n0 (Symbol: d0)",
            "What was measured leaves the shape of the walk open.",
        ),
    ],
)
def test_a_librarys_error_is_reported_in_words(text: str, message: str) -> None:
    with pytest.raises(MappingFailed) as raised:
        run_in_child(fail, text, progress=silent, stage=Stage.POSES)
    assert raised.value.message == message
    assert raised.value.hint
    assert isinstance(raised.value, ReconstructionBroken) == ("unexpected" in message)


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


@pytest.mark.slow
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


@pytest.mark.slow
def test_depth_pictures_make_a_walk_metric(site: Scene, tmp_path: Path) -> None:
    """Files as 7-Scenes has them, of a simulated room."""
    renderer = Renderer(site, [face.paint.albedo for face in site.faces])
    camera, depth_camera = PHONE_CAMERA, PHONE_CAMERA.resized(160, 120)
    poses = make_walk(1).poses(np.arange(0, 6, 0.4))
    for i, pose in enumerate(poses):
        name = tmp_path / f"frame-{i:06d}"
        depth = np.round(1000 * renderer.surface(depth_camera, pose).depth).astype(np.uint16)
        assert cv2.imwrite(f"{name}.color.png", renderer.radiance(camera, [pose] * 4))
        assert cv2.imwrite(f"{name}.depth.png", depth)
        np.savetxt(f"{name}.pose.txt", pose.T_map_camera)
    recording = read_recording(tmp_path)
    assert recording.depth is not None
    depth_images = replace(recording.depth, camera=depth_camera)
    found = estimate_trajectory(replace(recording, camera=camera, poses=None, depth=depth_images), PoseMethod.AUTO)
    assert found.scale is Scale.METRIC
    assert found.report.scale.startswith("Depth pictures fix the scale to 1.")
    T = np.array([poses[row].T_map_camera for row in found.rows])
    assert align_poses(found.T_map_camera, T).scale == pytest.approx(1.0, abs=0.02)
