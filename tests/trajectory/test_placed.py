"""Around the reconstruction: which keyframes it is asked for, and what is made of its answer."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hand_held import R_CAMERA_IMU
from scipy.spatial.transform import Rotation
from synthetic_walk import Frames, followed
from test_dead_reckoning import STOPS, walk, waypoints

from rholoc.errors import InvalidRecording, InvalidWaypoints, MappingFailed
from rholoc.features import FeatureSet
from rholoc.geometry import Camera, FloatArray, Similarity, pose_matrix, rotation_from_heading
from rholoc.progress import Stage
from rholoc.recordings import GivenPoses, Imu, Recording, Waypoint
from rholoc.reports import ImuReport
from rholoc.trajectory import PoseMethod, Scale, estimate
from rholoc.trajectory.checks.blame import LeftOut
from rholoc.trajectory.frame.map_frame import MapFrame
from rholoc.trajectory.inertial.gyroscope import GyroCalibration
from rholoc.trajectory.reconstruction import InertialFigures, Reconstruction, Sights
from rholoc.trajectory.visual.flow import Flow

_CAMERA = Camera(640, 480, 500.0, 500.0, 320.0, 240.0)
_DELAY_S = 0.4
_GYRO = GyroCalibration(_DELAY_S, 0.0, np.zeros(3), 0.0, R_CAMERA_IMU, False, 0.0, 0.1)
_FIGURES = InertialFigures(_GYRO, 0.01, np.zeros(3), np.zeros(3), 0.0, 1.0, 1.0, 1.0)


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


def _placed(monkeypatch: pytest.MonkeyPatch, found: Reconstruction, method: PoseMethod, **changes: Any) -> Any:
    asked: list[Any] = []

    def run(function: object, sights: Sights, imu: object, choices: object, **_: object) -> Reconstruction:
        asked.extend([imu, choices])
        return found

    monkeypatch.setattr(estimate, "run_in_child", run)
    count = len(found.placed)
    flow = _flow(2 * count)
    sights = Sights(flow, np.arange(0, 2 * count, 2), [FeatureSet.empty(0)] * count, _CAMERA)
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


def test_the_imu_is_reported_where_it_might_have_been_used(monkeypatch: pytest.MonkeyPatch) -> None:
    found = _found(20, 20, imu_reason="It is of no use.")
    imu, _, _ = walk()
    visual, *_ = _placed(monkeypatch, found, PoseMethod.VISUAL, imu=imu)
    assert visual.report.imu is None
    both, *_ = _placed(monkeypatch, found, PoseMethod.VISUAL_INERTIAL, imu=imu)
    assert both.report.imu == ImuReport(not_observable={"all": "It is of no use."})
    none, *_ = _placed(monkeypatch, found, PoseMethod.VISUAL_INERTIAL)
    assert "no IMU" in none.report.imu


def _compared(off_m: FloatArray, stops: tuple[int, ...] = (0, 1, 2, 3)) -> Any:
    """The paper's way against poses that are off the true path by so much, on a video's clock."""
    imu, path, R = walk()
    exact = replace(
        imu, times=imu.times + _DELAY_S, R_camera_imu=np.eye(3),
        acceleration=imu.acceleration - [0.03, -0.02, 0.02],
        angular_velocity=imu.angular_velocity - [0.002, -0.001, 0.001],
    )  # fmt: skip
    rows = np.arange(100, 3300, 100)
    frame = MapFrame(Similarity.identity(), Scale.METRIC, True, "", "", tuple(waypoints(stops)))
    every = np.zeros(40, np.bool_)
    every[: len(rows)] = True
    T = np.tile(np.eye(4), (40, 1, 1))
    T[: len(rows)] = pose_matrix(R[rows], path[rows] + off_m[: len(rows)])
    found = _found(40, len(rows), T_map_camera=T, frame=frame, imu=_FIGURES)
    recording = _recording(_flow(4), imu=exact)
    return estimate._comparison(recording, found, imu.times[rows], np.flatnonzero(every)), imu.times[rows]


def test_the_papers_way_is_compared_between_the_waypoints() -> None:
    off_m = np.zeros((40, 3))
    off_m[12] = [0.3, 0.0, -0.4]
    found, times = _compared(off_m)
    between = (times >= STOPS[0]) & (times <= STOPS[-1])
    assert found.frames == between.sum()
    assert found.worst_m == pytest.approx(0.5, abs=0.005)
    assert found.worst_time_s == times[12]
    assert found.rms_m == pytest.approx(np.sqrt(0.25 / between.sum()), abs=0.005)
    assert _compared(np.zeros((40, 3)))[0].rms_m < 0.005


def test_where_it_cannot_be_compared_it_says_why_or_nothing() -> None:
    flow, imu = _flow(4), walk()[0]
    frame = MapFrame(Similarity.identity(), Scale.METRIC, True, "", "", tuple(waypoints((0, 1, 2))))
    found = _found(4, 4, frame=frame, imu=_FIGURES)
    nothing: tuple[FloatArray, Any] = (np.zeros(0), np.zeros(0, np.int64))
    assert estimate._comparison(_recording(flow), found, *nothing) is None
    assert estimate._comparison(_recording(flow, imu=imu), replace(found, imu=None), *nothing) is None
    without = replace(found, frame=replace(frame, waypoints=()))
    assert estimate._comparison(_recording(flow, imu=imu), without, *nothing) is None
    late = replace(imu, times=imu.times + 50)
    says = estimate._comparison(_recording(flow, imu=late), found, *nothing)
    assert says is not None
    assert "does not cover" in says.why


def test_keyframes_are_those_of_the_motion_and_those_at_waypoints() -> None:
    flow = _flow(100)
    plain, choices = estimate._keyframes(_recording(flow), None, flow)
    assert choices == [()]
    at = tuple(Waypoint(str(t), t, (0.0, 0.0, 0.0)) for t in (1.12, 5.77, 3.0))
    rows, choices = estimate._keyframes(_recording(flow, waypoints=at), None, flow)
    assert rows.tolist() == sorted({*plain.tolist(), 11, 58, 30})
    assert choices == [at]
    assert estimate._rows_at(flow.times, [*at, Waypoint("?", float("nan"), (0.0, 0.0, 0.0))]) == {11, 58, 30}


def test_where_waypoints_have_no_times_every_pause_gets_a_keyframe() -> None:
    flow = _flow(120)
    rests = [(20, 35), (50, 65), (80, 100)]
    for first, last in rests:
        flow.motion[first:last] = 0.0
    unknown = tuple(Waypoint(name, float("nan"), (0.0, 0.0, 0.0)) for name in "AB")
    rows, choices = estimate._keyframes(_recording(flow, waypoints=unknown), None, flow)
    assert len(choices) == 3
    for first, last in rests:
        assert np.abs(rows - (first + last - 1) / 2).min() <= 1


@pytest.mark.parametrize(("frames", "enough"), [(3, False), (4, True)])
def test_four_keyframes_are_the_least(frames: int, enough: bool) -> None:
    flow = _flow(frames, motion=0.5)
    if enough:
        assert len(estimate._keyframes(_recording(flow), None, flow)[0]) == 4
    else:
        with pytest.raises(MappingFailed, match="3 pictures are too few"):
            estimate._keyframes(_recording(flow), None, flow)


def _inertial(monkeypatch: pytest.MonkeyPatch, **changes: Any) -> Any:
    flow = _flow(180, motion=0.03)
    asked: list[Any] = []

    def adjust(imu: Imu, measured: Any, times: FloatArray) -> FloatArray:
        asked.extend([measured, times])
        return np.tile(np.eye(4), (len(times), 1, 1))

    monkeypatch.setattr(estimate, "track_corners", lambda frames, progress, **_: flow)
    monkeypatch.setattr(estimate, "adjust_between_waypoints", adjust)
    recording = _recording(flow, **({"imu": walk()[0], "waypoints": tuple(waypoints((0, 1, 3)))} | changes))
    return estimate._inertial(recording, lambda *_: None), asked


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


def test_odometry_takes_neither_features_nor_waypoints(monkeypatch: pytest.MonkeyPatch) -> None:
    flow = _flow(100)
    asked: list[Any] = []
    monkeypatch.setattr(estimate, "_placed", lambda *what: asked.extend(what))
    imu = walk()[0]
    estimate.odometry_from_flow(_recording(flow, imu=imu, waypoints=tuple(waypoints((0, 1, 2)))), flow)
    recording, method, sights, used, choices, _ = asked
    assert (recording.waypoints, method, used, choices) == ((), PoseMethod.ODOMETRY, imu, [()])
    assert len(sights.features) == len(sights.rows) > 30
    assert not any(len(one) for one in sights.features)


def _given(count: int, tilt_deg: float = 0.0, metric: bool = True, turn: bool = True) -> Any:
    angles = np.linspace(0, 2.0 if turn else 0.0, count)
    headings = np.column_stack([np.cos(angles), np.sin(angles), 0.1 * np.sin(3 * angles)])
    R = np.stack([rotation_from_heading(one / np.linalg.norm(one), 0.0) for one in headings])
    T = pose_matrix(Rotation.from_euler("x", tilt_deg, degrees=True).as_matrix() @ R, np.zeros((count, 3)))
    flow = _flow(count)
    return estimate._given(_recording(flow, poses=GivenPoses(np.ones(count, np.bool_), T, metric)))


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


@pytest.mark.parametrize(("error_m", "says"), [(0.099, "right to 9.9 cm"), (0.0123, "right to 1.2 cm")])
def test_errors_are_said_in_centimetres(error_m: float, says: str) -> None:
    found = _found(10, 10, covariances=np.tile(error_m**2 / 3 * np.diag([1, 1, 1, 0, 0, 0]), (10, 1, 1)))
    assert says in estimate._report(found, PoseMethod.VISUAL, 10, np.arange(10), []).why
    assert estimate._doubts(found, 1.0, "") == []
    sure = replace(found, covariances=found.covariances * 1.1)
    assert bool(estimate._doubts(sure, 1.0, "")) is (error_m > 0.09)


@pytest.mark.parametrize(("error_deg", "doubted"), [(1.9, False), (2.1, True)])
def test_a_rotation_open_by_two_degrees_is_doubted(error_deg: float, doubted: bool) -> None:
    frame = MapFrame(Similarity.identity(), Scale.METRIC, True, "", "", tuple(waypoints((0, 1, 2))))
    covariances = np.tile(np.radians(error_deg) ** 2 / 3 * np.diag([0, 0, 0, 1, 1, 1]), (10, 1, 1))
    assert bool(estimate._doubts(_found(10, 10, frame=frame, covariances=covariances), 1.0, "")) is doubted


def test_a_waypoint_without_a_place_has_no_residual() -> None:
    frame = MapFrame(Similarity.identity(), Scale.METRIC, True, "", "", tuple(waypoints((0, 1))))
    found = _found(5, 5, frame=frame, left_out={"0": LeftOut(np.array([0.0, 0.03, 0.04]), 1.5)})
    assert estimate._residuals(found, lambda out: out.sigmas) == {"0": 1.5, "1": None}
    assert estimate._residuals(_found(5, 5), lambda out: out.sigmas) is None
