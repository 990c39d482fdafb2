"""Around the reconstruction: which keyframes it is asked for, and what is made of its answer."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hand_held import STOPS, walk, waypoints
from scipy.spatial.transform import Rotation
from synthetic_walk import Frames, followed

from rholoc.errors import InvalidRecording, InvalidWaypoints, MappingFailed
from rholoc.features import FeatureSet
from rholoc.geometry import Camera, FloatArray, Similarity, pose_matrix, rotation_from_heading
from rholoc.progress import Stage
from rholoc.recordings import GivenPoses, Imu, Recording, Waypoint
from rholoc.reports import ImuReport
from rholoc.trajectory import PoseMethod, Scale, estimate
from rholoc.trajectory.frame.map_frame import MapFrame
from rholoc.trajectory.reconstruction import Reconstruction, Sights
from rholoc.trajectory.visual.flow import Flow

_CAMERA = Camera(640, 480, 500.0, 500.0, 320.0, 240.0)


def _flow(count: int, motion: float = 0.02, interval_s: float = 0.1) -> Flow:
    flow = followed(
        interval_s * np.arange(count), (640, 480), np.full((count, 5, 2), 9.0), np.ones((count, 5), np.bool_)
    )
    return replace(flow, motion=np.full(count, motion))


def _recording(flow: Flow, **changes: Any) -> Recording:
    return Recording(
        **{"name": "walk", "path": Path("walk"), "frames": Frames(flow.times, (640, 480)), "camera": _CAMERA} | changes
    )


def _found(count: int, placed: int, **changes: Any) -> Reconstruction:
    """So many keyframes, of which the first ones are placed."""
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, 0, 3] = np.arange(count)
    frame = MapFrame(Similarity.identity(), Scale.METRIC, True, "up", "scale")
    covariances = np.tile(1e-6 * np.eye(6), (count, 1, 1)) * np.arange(1, count + 1)[:, None, None]
    whole = Reconstruction(
        np.arange(count) < placed, T, covariances, _CAMERA, None, frame, None, "", {}, (), 0.4, 123, 7, 2.5
    )
    return replace(whole, **changes)


def _placed(
    monkeypatch: pytest.MonkeyPatch, found: Reconstruction, method: PoseMethod, is_film: bool = True, **changes: Any
) -> Any:
    asked: list[Any] = []

    def run(function: object, sights: Sights, imu: object, choices: object, **_: object) -> Reconstruction:
        asked.extend([imu, choices])
        return found

    monkeypatch.setattr(estimate, "run_in_child", run)
    count = len(found.placed)
    flow = _flow(2 * count)
    sights = Sights(flow, np.arange(0, 2 * count, 2), [FeatureSet.empty(0)] * count, _CAMERA, is_film)
    recording = _recording(flow, **changes)
    heard: list[tuple[Stage, float, str]] = []
    trajectory = estimate._placed(
        recording, method, sights, recording.imu, [recording.waypoints], lambda *what: heard.append(what)
    )
    return trajectory, asked, heard


def test_only_keyframes_that_have_a_place_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    trajectory, asked, heard = _placed(monkeypatch, _found(20, 19), PoseMethod.VISUAL)
    assert trajectory.rows.tolist() == list(range(0, 38, 2))
    np.testing.assert_allclose(trajectory.times, 0.2 * np.arange(19))
    np.testing.assert_array_equal(trajectory.T_map_camera[:, 0, 3], np.arange(19))
    np.testing.assert_allclose(trajectory.covariances[:, 0, 0], 1e-6 * np.arange(1, 20))
    assert (trajectory.scale, trajectory.upright, trajectory.rolling_shutter) == (Scale.METRIC, True, None)
    assert (trajectory.report.frames, trajectory.report.keyframes) == (19, 20)
    assert trajectory.report.trusted
    assert asked == [None, []]  # without waypoints none are asked for
    assert heard == [(Stage.POSES, 1.0, "19 of 20 keyframes placed")]


@pytest.mark.parametrize(("placed", "trusted"), [(18, True), (17, False), (10, False)])
def test_nine_in_ten_keyframes_must_be_placed_for_a_map_to_be_trusted(
    placed: int, trusted: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    trajectory, *_ = _placed(monkeypatch, _found(20, placed), PoseMethod.VISUAL)
    assert trajectory.report.trusted is trusted
    assert trajectory.report.missing


def test_half_of_the_keyframes_must_be_placed(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(MappingFailed, match=r"Only 9 of 20 keyframes could be placed\. 0:02–0:04 shows"):
        _placed(monkeypatch, _found(20, 9), PoseMethod.VISUAL)


@pytest.mark.parametrize(("count", "placed"), [(37, 8), (300, 8), (20, 5)])
def test_of_a_set_eight_pictures_or_a_quarter_make_a_map_that_names_what_is_missing(
    count: int, placed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Eight of 37 pictures of a corridor fit each other: the job failed, and showed none of them."""
    trajectory, *_ = _placed(monkeypatch, _found(count, placed), PoseMethod.VISUAL, is_film=False)
    assert len(trajectory.rows) == placed
    assert trajectory.report.missing
    assert not trajectory.report.trusted
    with pytest.raises(MappingFailed, match=f"Only {placed - 1} of {count} pictures could be placed"):
        _placed(monkeypatch, _found(count, placed - 1), PoseMethod.VISUAL, is_film=False)


def test_the_imu_is_reported_where_it_might_have_been_used(monkeypatch: pytest.MonkeyPatch) -> None:
    found = _found(20, 20, imu_reason="It is of no use.")
    imu, _, _ = walk()
    visual, *_ = _placed(monkeypatch, found, PoseMethod.VISUAL, imu=imu)
    assert visual.report.imu is None
    both, *_ = _placed(monkeypatch, found, PoseMethod.VISUAL_INERTIAL, imu=imu)
    assert both.report.imu == ImuReport(not_observable={"all": "It is of no use."})
    none, *_ = _placed(monkeypatch, found, PoseMethod.VISUAL_INERTIAL)
    assert "no IMU" in none.report.imu


def _inertial(monkeypatch: pytest.MonkeyPatch, **changes: Any) -> Any:
    flow = _flow(180, motion=0.03)
    asked: list[Any] = []

    def adjust(imu: Imu, measured: Any, times: FloatArray) -> FloatArray:
        asked.extend([measured, times])
        return np.tile(np.eye(4), (len(times), 1, 1))

    monkeypatch.setattr(estimate, "track_corners", lambda *_, **__: flow)
    monkeypatch.setattr(estimate, "adjust_between_waypoints", adjust)
    recording = _recording(flow, **({"imu": walk()[0], "waypoints": tuple(waypoints((0, 1, 3)))} | changes))
    return estimate.estimate_trajectory(recording, PoseMethod.INERTIAL), asked


def test_the_imu_alone_places_keyframes_between_the_waypoints(monkeypatch: pytest.MonkeyPatch) -> None:
    found, (measured, times) = _inertial(monkeypatch)
    assert [waypoint.name for waypoint in measured] == ["0", "1", "3"]
    assert STOPS[0] <= times.min() < STOPS[0] + 0.3
    assert STOPS[-1] - 0.3 < times.max() <= STOPS[-1]
    np.testing.assert_array_equal(found.times, times)
    np.testing.assert_allclose(found.times, 0.1 * found.rows)
    assert (found.scale, found.upright, found.camera) == (Scale.METRIC, True, _CAMERA)
    assert (found.report.method, found.report.frames, found.report.trusted) == ("inertial", len(times), False)
    assert found.report.waypoint_times_s == {"0": 1.0, "1": 6.0, "3": 16.0}


def test_the_imu_alone_needs_waypoints_and_keyframes_between_them(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InvalidWaypoints, match="needs waypoints"):
        _inertial(monkeypatch, waypoints=())
    near = tuple(Waypoint(str(i), 3 + 0.15 * i, (float(i == 1), float(i == 2), 0.0)) for i in range(3))
    with pytest.raises(MappingFailed, match=r"[0-3] keyframes lie between"):
        _inertial(monkeypatch, waypoints=near)


def _given(count: int, tilt_deg: float = 0.0, metric: bool = True, turn: bool = True) -> Any:
    angles = np.linspace(0, 2.0 if turn else 0.0, count)
    headings = np.column_stack([np.cos(angles), np.sin(angles), 0.1 * np.sin(3 * angles)])
    R = np.stack([rotation_from_heading(one / np.linalg.norm(one), 0.0) for one in headings])
    T = pose_matrix(Rotation.from_euler("x", tilt_deg, degrees=True).as_matrix() @ R, np.zeros((count, 3)))
    flow = _flow(count)
    return estimate.estimate_trajectory(
        _recording(flow, poses=GivenPoses(np.ones(count, np.bool_), T, metric)), PoseMethod.GIVEN
    )


@pytest.mark.parametrize(
    ("tilt_deg", "turn", "upright", "says"),
    [
        (0.0, True, True, "z is 0.0° off"),
        (4.9, True, True, "z is 4.9° off"),
        (5.1, True, False, "z is 5.1° off"),
        (0.0, False, False, "Unknown"),
    ],
)
def test_given_poses_are_upright_where_cameras_do_not_roll(
    tilt_deg: float, turn: bool, upright: bool, says: str
) -> None:
    found = _given(30, tilt_deg, turn=turn)
    assert found.upright is upright
    assert says in found.report.up
    assert found.report.trusted
    assert found.report.frames == 30


def test_three_given_poses_are_the_least_and_their_unit_may_be_unknown() -> None:
    assert len(_given(3).rows) == 3
    with pytest.raises(InvalidRecording, match="2 frames of the recording have a pose"):
        _given(2)
    assert _given(5, metric=False).scale is Scale.ARBITRARY
    assert _given(5).scale is Scale.METRIC
