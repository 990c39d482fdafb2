"""A phone's simulated walk: what its camera and its IMU measure → poses, with waypoints and without."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from rholoc.trajectory.imu_evidence import ImuEvidence, compare_with_inertial, weigh_imu
from scipy.spatial.transform import Rotation

from rholoc.features import Channel, FeatureSet
from rholoc.geometry import ByteArray, FloatArray, IntArray, pose_matrix, umeyama
from rholoc.recordings import Recording, Waypoint
from rholoc.simulation import PHONE_CAMERA, Walk, make_walk, measure_imu, measure_waypoints
from rholoc.trajectory import PoseMethod, Scale, estimate
from rholoc.trajectory.map_frame import frame_of_first_camera, frame_of_waypoints

_DELAY_S = 0.03
_SECONDS = 30.0


def _reconstruction(walk: Walk, seed: int) -> tuple[FloatArray, FloatArray]:
    """Times (N,) and poses (N, 4, 4) of a frame and scale of their own, good to a millimetre and a tenth degree."""
    rng = np.random.default_rng(seed)
    times = np.sort(rng.choice(np.arange(0.0, _SECONDS, 1 / 30), 150, replace=False))
    T = walk.T_map_camera(times)
    frame = Rotation.random(rng=rng).as_matrix()
    noise = Rotation.from_rotvec(np.radians(rng.normal(0, 0.1, (len(times), 3)))).as_matrix()
    positions = T[:, :3, 3] + rng.normal(0, 0.001, (len(times), 3))
    return times, pose_matrix(frame @ T[:, :3, :3] @ noise, 0.4 * positions @ frame.T)


def _weighed(walk: Walk, seed: int) -> tuple[FloatArray, FloatArray, ImuEvidence]:
    times, own = _reconstruction(walk, seed)
    imu = measure_imu(walk, _SECONDS, time_offset_s=_DELAY_S, seed=seed)
    return times, own, weigh_imu(times, own, imu)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_imu_alone_gives_scale_and_gravity(seed: int) -> None:
    walk = make_walk(1, _SECONDS, seed)
    times, own, evidence = _weighed(walk, seed)
    assert not evidence.doubts
    assert evidence.report["time_offset_s"] == pytest.approx(_DELAY_S, abs=0.005)
    frame = frame_of_first_camera(own, 1.0, evidence.alignment)
    assert frame.scale is Scale.METRIC
    assert frame.upright
    found = frame.similarity.poses(own)
    similarity = umeyama(found[:, :3, 3], walk.positions(times))
    assert similarity.scale == pytest.approx(1, abs=0.03)
    assert np.degrees(np.arccos(similarity.rotation[2, 2])) < 1
    np.testing.assert_allclose(found[0, :3, 3], 0, atol=1e-9)


def test_waypoints_before_the_imu_and_the_imu_beside_them() -> None:
    walk = make_walk(1, _SECONDS, 4)
    times, own, evidence = _weighed(walk, 4)
    waypoints = measure_waypoints(walk, _SECONDS, seed=4)
    frame = frame_of_waypoints(times, own, [waypoints], evidence.alignment)
    assert not frame.doubts
    found = frame.similarity.poses(own)
    assert np.linalg.norm(found[:, :3, 3] - walk.positions(times), axis=1).max() < 0.03
    imu = measure_imu(walk, _SECONDS, time_offset_s=_DELAY_S, seed=4)
    assert evidence.gyro is not None
    beside = compare_with_inertial(times, found, waypoints, imu, evidence.gyro)
    assert 0.005 < beside["rms_m"] < 0.3
    in_feet = tuple(
        Waypoint(w.name, w.time, (3.28 * x, 3.28 * y, 3.28 * z)) for w in waypoints for x, y, z in [w.position]
    )
    doubtful = frame_of_waypoints(times, own, [in_feet], evidence.alignment)
    assert any("accelerometer says that the walk is 0.3" in doubt for doubt in doubtful.doubts)


@dataclass(frozen=True, eq=False)
class _Frames:
    """Frames of which only the times matter: their features are given."""

    times: FloatArray
    size: tuple[int, int] = (PHONE_CAMERA.width, PHONE_CAMERA.height)

    @property
    def numbers(self) -> IntArray:
        return np.arange(len(self.times))

    def images(self, rows: Sequence[int]) -> Iterator[ByteArray]:
        raise AssertionError("no image is needed")


def _features(T_map_camera: FloatArray) -> list[FeatureSet]:
    """Points on the walls of a room about the walk, as cameras (N, 4, 4) see them."""
    rng = np.random.default_rng(6)
    points = rng.uniform(-1, 1, (3000, 3)) * [4.0, 3.5, 1.5] + [1.5, 1.5, 0.0]
    walls = rng.integers(0, 2, 3000)
    points[np.arange(3000), walls] = np.where(
        rng.random(3000) < 0.5, np.array([-2.5, -2.0])[walls], np.array([5.5, 5.0])[walls]
    )
    descriptors = rng.integers(0, 100, (3000, 128), dtype=np.uint8)
    sets = []
    for T in T_map_camera:
        inside = (points - T[:3, 3]) @ T[:3, :3]
        pixels = PHONE_CAMERA.project(inside) + rng.normal(0, 0.3, (3000, 2))
        seen = np.flatnonzero((inside[:, 2] > 0.2) & PHONE_CAMERA.contains(pixels))[:300]
        zeros = np.zeros(len(seen), np.float32)
        channels = np.full(len(seen), Channel.SIFT, np.uint8)
        sets.append(FeatureSet(pixels[seen].astype(np.float32), channels, descriptors[seen], zeros, zeros))
    return sets


@pytest.mark.slow
def test_a_recording_with_waypoints_in_order_and_an_imu_of_unknown_mounting(monkeypatch: pytest.MonkeyPatch) -> None:
    walk = make_walk(1, _SECONDS, 0)
    times = np.arange(0.0, _SECONDS, 0.1)
    truth = walk.T_map_camera(times)
    measured = measure_waypoints(walk, _SECONDS)
    resting = np.array([np.abs(walk.pause_times - t).min() < 0.6 for t in times])
    motion, sharpness = np.where(resting, 0.0, 0.008), np.ones(len(times))
    monkeypatch.setattr(estimate, "measure_motion", lambda frames, progress: (motion, sharpness))
    monkeypatch.setattr(estimate, "extract_keyframe_features", lambda frames, rows, progress: _features(truth[rows]))
    recording = Recording(
        "walk",
        Path("walk"),
        _Frames(times),
        PHONE_CAMERA,
        replace(measure_imu(walk, _SECONDS, time_offset_s=_DELAY_S), R_camera_imu=None),
        tuple(Waypoint(w.name, float("nan"), w.position) for w in measured),
    )

    found = estimate.estimate_trajectory(recording, PoseMethod.VISUAL_INERTIAL)

    error_m = np.linalg.norm(found.T_map_camera[:, :3, 3] - truth[found.rows, :3, 3], axis=1)
    assert found.report.trusted, found.report.why
    assert found.report.frames == len(found.rows) >= 55
    assert np.median(error_m) < 0.015
    assert error_m.max() < 0.05
    taken = list(found.report.waypoint_times_s.values())
    np.testing.assert_allclose(taken, walk.pause_times, atol=0.4)
    assert list(found.report.waypoint_times_s) == ["START", "W1", "W2", "W3", "E"]
    assert found.report.imu.time_offset_s == pytest.approx(_DELAY_S, abs=0.005)
    assert found.report.inertial.rms_m < 0.3
    assert found.upright
