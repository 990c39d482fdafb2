"""Pauses, and waypoints of which only the order is known."""

from __future__ import annotations

import numpy as np
import pytest

from rholoc.errors import InvalidWaypoints
from rholoc.geometry import BoolArray, FloatArray, pose_matrix
from rholoc.recordings import Imu, Waypoint
from rholoc.trajectory.frame.map_frame import frame_of_waypoints
from rholoc.trajectory.frame.waypoint_times import choices_of_pauses, find_pauses, times_are_known

_TIMES = np.arange(0.0, 40.0, 1 / 30)
_RESTS = np.array([[0.0, 1.5], [8.0, 9.5], [16.0, 18.0], [25.0, 26.4], [38.0, 39.9]])
_PLACES = ((0.0, 0.0, 1.4), (2.0, 0.0, 1.4), (2.5, 2.0, 1.3), (0.5, 3.0, 1.4), (-1.0, 1.0, 1.5))


def _resting(times: FloatArray) -> BoolArray:
    return np.array([bool(np.any((_RESTS[:, 0] <= t) & (t <= _RESTS[:, 1]))) for t in times])


def _motion(tremor: float = 0.0) -> FloatArray:
    return np.where(_resting(_TIMES), tremor, 0.25) / 30


def _imu() -> Imu:
    t = np.arange(-0.5, 40.5, 0.01)
    moving = ~_resting(t)
    shaking = np.where(moving, 1.0, 0.0)[:, None] * np.random.default_rng(0).normal(0, 1, (len(t), 3))
    return Imu(t, np.add(shaking, [0.0, 0.0, 9.81]), 0.3 * shaking, True, None)


def _unnamed(*numbers: int) -> tuple[Waypoint, ...]:
    return tuple(Waypoint(f"W{i}", float("nan"), _PLACES[i]) for i in numbers)


@pytest.mark.parametrize("tremor", [0.0, 0.05])
def test_images_alone_show_the_pauses(tremor: float) -> None:
    np.testing.assert_allclose(find_pauses(_TIMES, _motion(tremor), None), _RESTS, atol=0.25)


def test_the_imu_and_the_images_must_both_rest() -> None:
    found = find_pauses(_TIMES, _motion(0.12), _imu())
    np.testing.assert_allclose(found, _RESTS, atol=0.5)
    motion = _motion()
    motion[(_TIMES > 16) & (_TIMES < 18)] = 0.3 / 30  # the image moves while the IMU rests
    assert len(find_pauses(_TIMES, motion, _imu())) == 4


def test_as_many_pauses_as_waypoints_leave_no_choice() -> None:
    waypoints = _unnamed(0, 1, 2, 3, 4)
    assert not times_are_known(waypoints)
    (chosen,) = choices_of_pauses(waypoints, _RESTS)
    assert times_are_known(chosen)
    np.testing.assert_allclose([waypoint.time for waypoint in chosen], _RESTS.mean(axis=1))
    assert [waypoint.name for waypoint in chosen] == ["W0", "W1", "W2", "W3", "W4"]


def test_too_few_pauses_are_reported() -> None:
    with pytest.raises(InvalidWaypoints, match=r"2 pauses .* but there are 3 waypoints"):
        list(choices_of_pauses(_unnamed(0, 1, 2), _RESTS[:2]))


def test_of_more_pauses_those_are_taken_that_fit_the_waypoints() -> None:
    at = np.concatenate([[-1.0], _RESTS.mean(axis=1), [41.0]])
    path = np.column_stack([np.interp(_TIMES, _RESTS.mean(axis=1), column) for column in np.array(_PLACES).T])
    T = pose_matrix(np.tile(np.eye(3), (len(_TIMES), 1, 1)), path / 3)
    frame = frame_of_waypoints(_TIMES, T, choices_of_pauses(_unnamed(0, 1, 2, 4), _RESTS), None, "")
    assert [waypoint.name for waypoint in frame.waypoints] == ["W0", "W1", "W2", "W4"]
    taken = [waypoint.time for waypoint in frame.waypoints]
    np.testing.assert_allclose(taken, at[[1, 2, 3, 5]], atol=1e-6)
    assert not frame.doubts
    np.testing.assert_allclose(frame.similarity.points(path / 3), path, atol=0.02)
    square = tuple(Waypoint(str(i), float("nan"), (float(i == 1), float(i == 2), 0.0)) for i in range(3))
    alike = np.column_stack([np.sin(_TIMES), np.cos(_TIMES), 0 * _TIMES])
    pauses = np.add.outer(np.arange(5) * np.pi / 2, [-0.5, 0.5]) + 2
    doubtful = frame_of_waypoints(_TIMES, pose_matrix(T[:, :3, :3], alike), choices_of_pauses(square, pauses), None, "")
    assert any("Other pauses" in doubt for doubt in doubtful.doubts)


def test_of_very_many_pauses_the_longest_are_taken() -> None:
    begin = np.arange(40) * 10.0
    pauses = np.column_stack([begin, begin + 1 + np.arange(40) / 100])
    choices = list(choices_of_pauses(_unnamed(0, 1, 2, 3, 4), pauses))
    assert len(choices) <= 2000
    np.testing.assert_allclose([waypoint.time for waypoint in choices[0]], pauses[35:].mean(axis=1))


@pytest.mark.parametrize(
    ("rate", "imu", "still"), [(0.09, False, True), (0.11, False, False), (0.14, True, True), (0.16, True, False)]
)
def test_how_fast_a_picture_at_rest_may_tremble(rate: float, imu: bool, still: bool) -> None:
    """A tenth of its width in a second, and half as much again where the IMU rests, too."""
    resting = Imu(np.arange(-1.0, 41.0, 0.01), np.zeros((4200, 3)), np.zeros((4200, 3)), True, None)
    found = find_pauses(_TIMES, np.full(len(_TIMES), rate / 30), resting if imu else None)
    assert (len(found) == 1) is still
    if still:
        np.testing.assert_allclose(found, [[0.0, _TIMES[-1]]])


def test_pictures_are_judged_by_a_moment_and_outside_of_its_table_the_imu_does_not_rest() -> None:
    times = np.arange(0.0, 20.0, 0.1)
    motion = np.zeros(200)
    motion[100] = 0.025  # in a tenth of a second: spread over three frames, less than a tenth of the width a second
    assert len(find_pauses(times, motion, None)) == 1
    motion[100] = 0.035
    assert len(find_pauses(times, motion, None)) == 2
    half = Imu(np.arange(5.0, 12.0, 0.01), np.zeros((700, 3)), np.zeros((700, 3)), True, None)
    np.testing.assert_allclose(find_pauses(times, np.zeros(200), half), [[5.0, 12.0]], atol=0.11)


@pytest.mark.parametrize(("pauses", "choices"), [(14, 1001), (16, 1820), (17, 1820), (30, 1820)])
def test_no_more_than_two_thousand_choices_are_tried(pauses: int, choices: int) -> None:
    """Four of sixteen can be taken in 1820 ways, four of seventeen in 2380."""
    spans = np.column_stack([10.0 * np.arange(pauses), 10.0 * np.arange(pauses) + 2])
    assert len(list(choices_of_pauses(_unnamed(0, 1, 2, 3), spans))) == choices


def test_two_pauses_are_too_few_for_three_waypoints_and_three_are_not() -> None:
    assert len(list(choices_of_pauses(_unnamed(0, 1, 2), _RESTS[:3]))) == 1
