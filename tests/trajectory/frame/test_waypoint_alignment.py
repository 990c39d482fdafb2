"""Similarities: round trips; pauses, and waypoints of which only the order is known."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from rholoc.errors import InvalidWaypoints, MappingFailed
from rholoc.geometry import UP, BoolArray, FloatArray, Similarity, align_poses, angles_between, pose_matrix, umeyama
from rholoc.recordings import Imu, Waypoint
from rholoc.trajectory.frame.map_frame import frame_of_waypoints
from rholoc.trajectory.frame.waypoint_alignment import (
    UpMeasurement,
    WaypointAlignment,
    align_to_waypoints,
    fix_frame,
    positions_at,
)
from rholoc.trajectory.frame.waypoint_times import choices_of_pauses, find_pauses, times_are_known

_TIMES = np.arange(0.0, 10.0, 0.1)


def _similarity(seed: int, scale: float) -> Similarity:
    rng = np.random.default_rng(seed)
    return Similarity(scale, Rotation.random(rng=rng).as_matrix(), rng.uniform(-5, 5, 3))


def _walk() -> FloatArray:
    return np.column_stack([2 * np.sin(_TIMES / 3), _TIMES / 4, 0.2 * np.cos(_TIMES / 2)])


def _waypoints(path: FloatArray, rows: list[int]) -> list[Waypoint]:
    x = path[rows]
    return [Waypoint(f"W{i}", float(_TIMES[row]), tuple(p)) for i, (row, p) in enumerate(zip(rows, x, strict=True))]


@given(seed=st.integers(0, 1000), scale=st.floats(0.05, 20), count=st.integers(4, 30))
def test_umeyama_gives_back_the_similarity(seed: int, scale: float, count: int) -> None:
    truth = _similarity(seed, scale)
    points = np.random.default_rng(seed).uniform(-1, 1, (count, 3))
    found = umeyama(points, truth.points(points))
    np.testing.assert_allclose(found.points(points), truth.points(points), atol=1e-8)
    assert found.scale == pytest.approx(scale, rel=1e-8)
    assert np.linalg.det(found.rotation) == pytest.approx(1)


def test_umeyama_of_mirrored_points_is_a_rotation() -> None:
    points = np.random.default_rng(1).uniform(-1, 1, (10, 3))
    assert np.linalg.det(umeyama(points, points * [1, 1, -1]).rotation) == pytest.approx(1)


def test_a_minority_of_wrong_poses_does_not_move_the_alignment() -> None:
    truth = _similarity(3, 2.0)
    poses = pose_matrix(np.tile(np.eye(3), (100, 1, 1)), _walk())
    target = truth.poses(poses)
    target[:20, :3, 3] += [3.0, 0, 0]
    found = align_poses(poses, target, rounds=20)
    assert found.scale == pytest.approx(2.0, rel=0.01)


@given(seed=st.integers(0, 50), scale=st.floats(0.1, 10))
def test_three_waypoints_fix_the_frame(seed: int, scale: float) -> None:
    path = _walk()
    own = _similarity(seed, scale).points(path)
    found = align_to_waypoints(_TIMES, own, _waypoints(path, [0, 45, 90]))
    np.testing.assert_allclose(found.similarity.points(own), path, atol=1e-5)
    assert found.worst_m < 1e-5


def test_one_mistyped_coordinate_of_five_is_found() -> None:
    path = _walk()
    own = _similarity(5, 0.3).points(path)
    waypoints = _waypoints(path, [0, 20, 45, 70, 99])
    for wrong in range(5):
        for axis, metres in ((0, 1.0), (1, -0.3), (2, 9.0)):
            said = list(waypoints[wrong].position)
            said[axis] += metres
            x, y, z = said
            mistyped = [*waypoints[:wrong], replace(waypoints[wrong], position=(x, y, z)), *waypoints[wrong + 1 :]]
            found = align_to_waypoints(_TIMES, own, mistyped)
            assert found.mistake == wrong
            assert np.linalg.norm(found.similarity.points(own) - path, axis=1).max() < 0.01
            assert found.residuals_m[wrong] == pytest.approx(abs(metres), abs=0.01)
            assert found.worst_m < 0.01


def test_waypoints_that_are_merely_imprecise_are_all_used() -> None:
    path = _walk()
    noise = np.random.default_rng(2).normal(0, 0.02, path.shape)
    found = align_to_waypoints(_TIMES, path, _waypoints(path + noise, [0, 20, 45, 70, 99]))
    assert found.mistake is None
    assert np.linalg.norm(found.similarity.points(path) - path, axis=1).max() < 0.08


def test_gravity_mends_what_noisy_waypoints_tilt() -> None:
    path = _walk()
    truth = _similarity(7, 1.0)
    own = truth.points(path)
    waypoints = _waypoints(path, [0, 45, 90])
    middle = waypoints[1]
    waypoints[1] = Waypoint(middle.name, middle.time, (*middle.position[:2], middle.position[2] + 0.05))
    up = UpMeasurement(truth.rotation @ [0.0, 0.0, 1.0], 0.1)
    tilts = []
    for measurement in (None, up):
        found = align_to_waypoints(_TIMES, own, waypoints, measurement).similarity
        tilts.append(np.degrees(angles_between(found.rotation @ up.direction, UP)))
    assert tilts[1] < 0.3 * tilts[0]


def test_waypoints_on_a_line_are_refused() -> None:
    own = _walk()
    line = [Waypoint(str(i), float(i), (float(i), 2.0 * i, 0.0)) for i in range(5)]
    with pytest.raises(InvalidWaypoints, match="line"):
        align_to_waypoints(_TIMES, own, line)


def test_two_waypoints_are_refused() -> None:
    with pytest.raises(InvalidWaypoints, match="2 waypoints"):
        align_to_waypoints(_TIMES, _walk(), _waypoints(_walk(), [0, 50]))


def test_waypoints_of_another_walk_fail() -> None:
    elsewhere = [Waypoint("a", 0.0, (0, 0, 0)), Waypoint("b", 3.0, (9, 0, 0)), Waypoint("c", 6.0, (0, 9, 0))]
    with pytest.raises(MappingFailed, match="misses the waypoints"):
        align_to_waypoints(_TIMES, _walk(), elsewhere)


def test_waypoints_far_from_any_posed_frame_are_left_out() -> None:
    path = _walk()
    waypoints = [*_waypoints(path, [0, 45, 90]), Waypoint("late", 30.0, (0.0, 0.0, 0.0))]
    found = align_to_waypoints(_TIMES, path, waypoints)
    assert found.similarity.scale == pytest.approx(1, rel=1e-5)
    assert np.isnan(found.residuals_m[3])
    with pytest.raises(MappingFailed, match="late"):
        align_to_waypoints(_TIMES, path, [waypoints[0], waypoints[1], waypoints[3]])
    assert fix_frame(_TIMES, waypoints)
    assert not fix_frame(_TIMES, [waypoints[0], waypoints[1], waypoints[3]])


def _moved(waypoints: list[Waypoint], offs: dict[int, tuple[float, float, float]]) -> list[Waypoint]:
    found = list(waypoints)
    for i, off in offs.items():
        x, y, z = np.add(waypoints[i].position, off)
        found[i] = replace(waypoints[i], position=(x, y, z))
    return found


@pytest.mark.parametrize(("miss_m", "refused"), [(0.23, False), (0.27, True)])
def test_a_quarter_of_a_metre_may_be_missed(miss_m: float, refused: bool) -> None:
    """In the root mean square of four waypoints, two of which are too high, and two too low."""
    path = 4 * _walk()
    waypoints = _waypoints(path, [0, 33, 66, 99])
    own = path.copy()
    corners = np.array([waypoint.position for waypoint in waypoints])
    shape = np.array([[0, 0, 1.0], [0, 0, -1.0], [0, 0, 1.0], [0, 0, -1.0]])
    found = 0.0
    for size in np.linspace(0, 2, 400):  # until so much is missed
        fitted = umeyama(corners, corners + size * shape)
        found = float(np.sqrt(np.mean(np.sum((fitted.points(corners) - corners - size * shape) ** 2, axis=1))))
        if found >= miss_m:
            break
    assert found == pytest.approx(miss_m, abs=0.01)
    moved = _moved(waypoints, {i: tuple(size * shape[i]) for i in range(4)})
    if refused:
        with pytest.raises(MappingFailed, match=r"misses the waypoints by 0.2[5-9]"):
            align_to_waypoints(_TIMES, own, moved)
    else:
        align_to_waypoints(_TIMES, own, moved)


def test_long_ways_may_miss_more() -> None:
    """By half a hundredth of the way between the waypoints, here of half a kilometre and more."""
    path = 250 * _walk()
    rng = np.random.default_rng(3)
    shifts = {i: tuple(rng.normal(0, 0.8, 3)) for i in range(3)}
    align_to_waypoints(_TIMES, path, _moved(_waypoints(path, [0, 45, 90]), shifts))
    near = _waypoints(path, [0, 2, 4])
    with pytest.raises(MappingFailed, match="misses the waypoints"):
        align_to_waypoints(_TIMES, path, _moved(near, {1: (0.0, 0.0, 6.0)}))


def test_between_frames_a_place_lies_on_a_smooth_path() -> None:
    times = np.array([0.0, 1.0, 2.0, 3.0, 4.0])
    line = np.outer(times, [1.0, -2.0, 0.5]) + 3
    np.testing.assert_allclose(
        positions_at(times, line, np.array([0.5, 3.25])), np.outer([0.5, 3.25], [1, -2, 0.5]) + 3
    )
    np.testing.assert_allclose(positions_at(times, line, np.array([-9.0, 9.0])), line[[0, -1]])  # and not beyond
    np.testing.assert_array_equal(positions_at(times[:1], line[:1], np.array([0.3, 7.0])), line[[0, 0]])
    np.testing.assert_allclose(positions_at(times[:2], line[:2], np.array([0.5])), [[3.5, 2.0, 3.25]])


@pytest.mark.parametrize(("late_s", "near"), [(0.45, True), (0.55, False)])
def test_a_waypoint_half_a_second_from_any_frame_has_no_place(late_s: float, near: bool) -> None:
    path = _walk()
    waypoints = [*_waypoints(path, [0, 45, 70]), Waypoint("late", _TIMES[-1] + late_s, tuple(path[-1]))]
    assert np.isfinite(align_to_waypoints(_TIMES, path, waypoints).residuals_m[3]) == near


def test_the_worst_of_the_waypoints_that_were_used() -> None:
    off = np.array([0.1, np.nan, 0.5, 0.2])
    assert WaypointAlignment(Similarity.identity(), off).worst_m == 0.5
    assert WaypointAlignment(Similarity.identity(), off, mistake=2).worst_m == 0.2


def test_a_camera_that_did_not_move_has_no_scale() -> None:
    path = _walk()
    with pytest.raises(MappingFailed, match="did not move"), np.errstate(invalid="ignore"):
        align_to_waypoints(_TIMES, np.zeros_like(path), _waypoints(path, np.array([0, 20, 45])))


_FRAME_TIMES = np.arange(0.0, 40.0, 1 / 30)
_RESTS = np.array([[0.0, 1.5], [8.0, 9.5], [16.0, 18.0], [25.0, 26.4], [38.0, 39.9]])
_PLACES = ((0.0, 0.0, 1.4), (2.0, 0.0, 1.4), (2.5, 2.0, 1.3), (0.5, 3.0, 1.4), (-1.0, 1.0, 1.5))


def _resting(times: FloatArray) -> BoolArray:
    return np.array([bool(np.any((_RESTS[:, 0] <= t) & (t <= _RESTS[:, 1]))) for t in times])


def _motion(tremor: float = 0.0) -> FloatArray:
    return np.where(_resting(_FRAME_TIMES), tremor, 0.25) / 30


def _imu() -> Imu:
    t = np.arange(-0.5, 40.5, 0.01)
    moving = ~_resting(t)
    shaking = np.where(moving, 1.0, 0.0)[:, None] * np.random.default_rng(0).normal(0, 1, (len(t), 3))
    return Imu(t, np.add(shaking, [0.0, 0.0, 9.81]), 0.3 * shaking, True, None)


def _unnamed(*numbers: int) -> tuple[Waypoint, ...]:
    return tuple(Waypoint(f"W{i}", float("nan"), _PLACES[i]) for i in numbers)


@pytest.mark.parametrize("tremor", [0.0, 0.05])
def test_images_alone_show_the_pauses(tremor: float) -> None:
    np.testing.assert_allclose(find_pauses(_FRAME_TIMES, _motion(tremor), None), _RESTS, atol=0.25)


def test_the_imu_and_the_images_must_both_rest() -> None:
    found = find_pauses(_FRAME_TIMES, _motion(0.12), _imu())
    np.testing.assert_allclose(found, _RESTS, atol=0.5)
    motion = _motion()
    motion[(_FRAME_TIMES > 16) & (_FRAME_TIMES < 18)] = 0.3 / 30  # the image moves while the IMU rests
    assert len(find_pauses(_FRAME_TIMES, motion, _imu())) == 4


def test_a_single_frame_has_no_pause() -> None:
    assert find_pauses(np.zeros(1), np.zeros(1), None).shape == (0, 2)


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
    path = np.column_stack([np.interp(_FRAME_TIMES, _RESTS.mean(axis=1), column) for column in np.array(_PLACES).T])
    T = pose_matrix(np.tile(np.eye(3), (len(_FRAME_TIMES), 1, 1)), path / 3)
    frame = frame_of_waypoints(_FRAME_TIMES, T, choices_of_pauses(_unnamed(0, 1, 2, 4), _RESTS), None, "")
    assert [waypoint.name for waypoint in frame.waypoints] == ["W0", "W1", "W2", "W4"]
    taken = [waypoint.time for waypoint in frame.waypoints]
    np.testing.assert_allclose(taken, at[[1, 2, 3, 5]], atol=1e-6)
    assert not frame.doubts
    np.testing.assert_allclose(frame.similarity.points(path / 3), path, atol=0.02)
    square = tuple(Waypoint(str(i), float("nan"), (float(i == 1), float(i == 2), 0.0)) for i in range(3))
    alike = np.column_stack([np.sin(_FRAME_TIMES), np.cos(_FRAME_TIMES), 0 * _FRAME_TIMES])
    pauses = np.add.outer(np.arange(5) * np.pi / 2, [-0.5, 0.5]) + 2
    doubtful = frame_of_waypoints(
        _FRAME_TIMES, pose_matrix(T[:, :3, :3], alike), choices_of_pauses(square, pauses), None, ""
    )
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
    found = find_pauses(_FRAME_TIMES, np.full(len(_FRAME_TIMES), rate / 30), resting if imu else None)
    assert (len(found) == 1) is still
    if still:
        np.testing.assert_allclose(found, [[0.0, _FRAME_TIMES[-1]]])


def test_pictures_are_judged_by_a_moment_and_outside_of_its_table_the_imu_does_not_rest() -> None:
    times = np.arange(0.0, 20.0, 0.1)
    motion = np.zeros(200)
    motion[100] = 0.025  # in a tenth of a second: spread over three frames, less than a tenth of the width a second
    assert len(find_pauses(times, motion, None)) == 1
    motion[100] = 0.035
    assert len(find_pauses(times, motion, None)) == 2
    half = Imu(np.arange(5.0, 12.0, 0.01), np.zeros((700, 3)), np.zeros((700, 3)), True, None)
    np.testing.assert_allclose(find_pauses(times, np.zeros(200), half), [[5.0, 12.0]], atol=0.11)


@pytest.mark.parametrize(("pauses", "choices"), [(16, 1820), (17, 1820), (30, 1820)])
def test_no_more_than_two_thousand_choices_are_tried(pauses: int, choices: int) -> None:
    """Four of sixteen can be taken in 1820 ways, four of seventeen in 2380."""
    spans = np.column_stack([10.0 * np.arange(pauses), 10.0 * np.arange(pauses) + 2])
    assert len(list(choices_of_pauses(_unnamed(0, 1, 2, 3), spans))) == choices
