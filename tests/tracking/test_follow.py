"""A camera is followed in a map on this machine: poses from the first recognized frame, answers whenever they come."""

from __future__ import annotations

import threading
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rholoc.errors import InvalidInput
from rholoc.geometry import pose_distances, pose_matrix
from rholoc.localization import Localizer
from rholoc.recordings import GivenPoses, PoseKind, Recording
from rholoc.recordings.frames.memory_frames import MemoryFrames
from rholoc.recordings.recording import Odometry
from rholoc.tracking import (
    AtOnce,
    InBackground,
    Motion,
    TableOfTrack,
    Tally,
    film_times,
    follow,
    odometry_of,
    paced,
    recorded_moments,
)
from rholoc_client.tracking import TrackStatus

FRAMES = 12


@pytest.fixture(scope="module")
def localizer(picture_world):
    return Localizer(picture_world.map_)


@pytest.fixture(scope="module")
def still(picture_world):
    """A camera at rest."""
    frames = MemoryFrames([picture_world.image] * FRAMES, frames_per_second=10.0)
    return Recording("still", None, frames, camera=picture_world.camera)


def steps(localizer, recording, motion=Motion.PICTURES, odometry=None, answering=None):
    moments = recorded_moments(recording, motion, odometry)
    return list(follow(localizer, recording.camera, motion, moments, answering))


def test_every_frame_from_the_second_answer_on_has_a_pose(localizer, still, picture_world):
    found = steps(localizer, still)
    assert [step.moment.number for step in found] == list(range(FRAMES))
    placed = [step for step in found if step.tracked.status is TrackStatus.TRACKING]
    assert len(placed) >= FRAMES - 5
    for step in placed:
        off_m, _ = pose_distances(np.array(step.tracked.pose.T_map_camera), picture_world.pose.T_map_camera)
        assert off_m < 0.02
        assert step.sigma_m < 0.1
    assert found[0].answer.localization.localized
    assert all((step.answer is not None) == step.asked for step in found)  # at once


def test_the_same_recording_gives_the_same_poses(localizer, still):
    tables = []
    for _ in range(2):
        table = TableOfTrack()
        for step in steps(localizer, still):
            table.take(step)
        tables.append(table.table())
    np.testing.assert_array_equal(tables[0].T_map_camera, tables[1].T_map_camera)
    assert len(tables[0]) == len(tables[0].frames) > 0


def test_an_answer_from_the_background_counts_when_it_comes(localizer, still):
    released = threading.Event()

    class Slow(InBackground):
        def ask(self, time_s, answer):
            super().ask(time_s, lambda: released.wait(60) and answer())

    answering, found = Slow(), []
    for step in follow(localizer, still.camera, Motion.PICTURES, recorded_moments(still, Motion.PICTURES), answering):
        found.append(step)
        if step.moment.number == 3:
            released.set()
            answering._pending[1].exception(60)  # it has come
    assert found[0].asked
    assert not any(step.asked for step in found[1:4])  # one question at a time
    assert found[4].answer.time_s == found[0].moment.time_s


def test_a_strange_picture_has_no_pose(localizer, still, picture_world):
    noise = np.random.default_rng(0).integers(0, 255, picture_world.image.shape).astype(np.uint8)
    strange = replace(still, frames=MemoryFrames([noise] * FRAMES, frames_per_second=10.0))
    tally, table = Tally(), TableOfTrack()
    for step in steps(localizer, strange):
        tally.take(step)
        table.take(step)
    assert tally.figures()["searching"] == FRAMES
    assert tally.figures()["answers_used"] == 0
    assert len(table.table()) == 0


def test_odometry_is_that_of_the_recording(localizer, still):
    T = pose_matrix(Rotation.from_rotvec([[0, 0, 0], [0, 0, 1.0]]).as_matrix(), np.array([[0, 0, 0], [1.0, 0, 0]]))
    ends = np.array([0.0, 1.0])
    with_odometry = replace(still, odometry=Odometry(ends, T, np.full(2, 0.01), np.full(2, 0.01)))
    poses = odometry_of(with_odometry)
    np.testing.assert_allclose(poses[5, :3, 3], [0.5, 0, 0], atol=1e-12)
    np.testing.assert_allclose(Rotation.from_matrix(poses[5, :3, :3]).as_rotvec(), [0, 0, 0.5], atol=1e-12)
    assert np.isnan(poses[11]).all()  # after its last row
    given = GivenPoses(np.ones(FRAMES, dtype=bool), np.repeat(np.eye(4)[None], FRAMES, axis=0))
    assert odometry_of(replace(still, poses=given)) is None
    assert odometry_of(replace(still, poses=replace(given, kind=PoseKind.ODOMETRY))) is given.T_map_camera
    found = steps(localizer, still, Motion.ODOMETRY, given.T_map_camera)
    assert found[-1].tracked.T_map_odom is not None


def test_odometry_that_is_no_motion_is_refused(localizer, still):
    with pytest.raises(InvalidInput, match="odometry"):
        steps(localizer, still, Motion.ODOMETRY, np.full((FRAMES, 4, 4), 2.0), AtOnce())


def test_pictures_without_times_are_a_film(still):
    assert film_times(still)[1] == pytest.approx(0.1)

    class Untimed(MemoryFrames):
        @property
        def timed(self):
            return False

    untimed = replace(still, frames=Untimed(still.frames.pictures, frames_per_second=1.0))
    assert film_times(untimed)[6] == pytest.approx(0.2)


def test_a_recording_is_played_at_its_own_pace(still, monkeypatch):
    now_s, slept = [100.0], []
    monkeypatch.setattr("time.monotonic", lambda: now_s[0])
    monkeypatch.setattr("time.sleep", slept.append)
    played = []
    for moment in paced(recorded_moments(still, Motion.PICTURES)):
        played.append(moment.number)
        now_s[0] += 0.35 if moment.number == 2 else 0.1
    assert played == [0, 1, 2, 5, 6, 7, 8, 9, 10, 11]  # what is more than a tenth of a second late is left out
    assert max(slept) <= 0.1 + 1e-9
