"""Rooms that are furnished alike are told apart by the walk between them."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from rholoc.geometry import Camera, FloatArray, Pose, pose_matrix
from rholoc.trajectory.optimization.loop_verification import PlacedFeatures, loop_pose, loops_in_reach, place_features
from rholoc.trajectory.optimization.pose_graph import RelativePose, bend
from rholoc.trajectory.optimization.problem import Fix, InertialState, State
from rholoc.trajectory.visual.matching import VerifiedPair

_CAMERA = Camera(640, 480, 520.0, 520.0, 319.5, 239.5)
_POINTS = 30
_FIRST, _AGAIN, _ALIKE = range(0, 6), range(6, 12), range(12, 18)  # keyframes of a room, of it again, of its twin
_APART = np.array([3.0, 0.0, 0.0])  # from a room to the one like it


def _rooms(drift: FloatArray) -> tuple[State, list[FloatArray]]:
    """A walk whose second look at the room is off by ``drift`` (3,), and where in the pictures points appear."""
    rng = np.random.default_rng(2)
    room = rng.uniform([-1.5, 3.0, 0.4], [1.5, 5.0, 2.4], (_POINTS, 3))
    T, pixels = [], []
    for k in range(18):
        at = np.array([0.15 * (k % 6), 0.0, 1.4])
        pose = Pose.from_heading(at, np.array([0.0, 1.0, 0.0]))
        pixels.append(_CAMERA.project((room - at) @ pose.R_map_camera))
        moved = pose.T_map_camera.copy()
        moved[:3, 3] += _APART if k in _ALIKE else drift if k in _AGAIN else np.zeros(3)
        T.append(moved)
    return State(np.array(T), np.zeros((0, 3)), _CAMERA), pixels


def _pair(first: int, second: int) -> VerifiedPair:
    return VerifiedPair(first, second, np.tile(np.arange(_POINTS)[:, None], 2), np.eye(3))


def _neighbours() -> list[VerifiedPair]:
    return [_pair(k, k + step) for step in (1, 2) for k in range(18 - step) if k // 6 == (k + step) // 6]


def _judged(drift_m: float, sigma_m: float, pairs: Sequence[VerifiedPair]) -> list[bool]:
    state, pixels = _rooms(np.array([0.0, drift_m, 0.0]))
    return loops_in_reach(pairs, place_features(_neighbours(), pixels, state), np.full(18, sigma_m)).tolist()


@pytest.mark.parametrize("drift_m", [0.0, 0.08, 0.25])
def test_a_room_seen_again_is_told_from_one_like_it(drift_m: float) -> None:
    assert _judged(drift_m, 0.05, [_pair(2, 8), _pair(2, 14), _pair(8, 14)]) == [True, False, False]


def test_a_walk_that_is_known_less_well_allows_more() -> None:
    assert _judged(0.5, 0.02, [_pair(2, 8)]) == [False]
    assert _judged(0.5, 0.15, [_pair(2, 8)]) == [True]


def test_features_without_a_place_prove_nothing() -> None:
    state, pixels = _rooms(np.zeros(3))
    placed = place_features(_neighbours()[:2], pixels, state)
    assert loops_in_reach([_pair(2, 8)], placed, np.full(18, 0.1)).tolist() == [False]
    assert loop_pose(_pair(2, 8), place_features([], pixels, state)) is None


@pytest.mark.parametrize("drift_m", [0.0, 0.5, 3.0])
def test_where_a_loops_keyframes_stand_to_each_other_is_free_of_drift(drift_m: float) -> None:
    state, pixels = _rooms(np.array([0.0, drift_m, 0.0]))
    found = loop_pose(_pair(2, 9), place_features(_neighbours(), pixels, state))
    R = state.R_map_camera[found.first]
    moved = R @ found.T_first_second[:3, 3]
    np.testing.assert_allclose(np.sign(found.second - found.first) * moved, [0.15, 0.0, 0.0], atol=1e-3)
    np.testing.assert_allclose(found.T_first_second[:3, :3], np.eye(3), atol=1e-3)


def _placed(off_m: float, known: int) -> PlacedFeatures:
    """Two keyframes a hundred metres of way apart, whose thirty features are off by so much; so many are known."""
    state = State(np.tile(np.eye(4), (3, 1, 1)), np.zeros((0, 3)), _CAMERA)
    state.T_map_camera[1, 0, 3] = 50.0
    one = np.random.default_rng(0).uniform(-1, 1, (_POINTS, 3))
    points = np.concatenate([one, np.add(one, [0.0, 0.0, off_m])])
    numbers = np.arange(_POINTS)
    rays = [np.tile([0.0, 0.0, 1.0], (_POINTS, 1))] * 3
    is_known = np.tile(numbers < known, 2)
    return PlacedFeatures(points, is_known, [numbers, numbers, numbers + _POINTS], rays, state)


@pytest.mark.parametrize(
    ("off_m", "sigmas_m", "kept"),
    [
        (0.59, (0.0, 0.0, 0.0), True),  # a tenth of a metre, and half a metre for the way of a hundred
        (0.61, (0.0, 0.0, 0.0), False),
        (0.79, (0.05, 0.0, 0.01), True),  # and four sigmas of the less sure one
        (0.81, (0.05, 0.0, 0.01), False),
        (0.79, (0.01, 0.0, 0.05), True),
        (0.81, (0.01, 0.0, 0.05), False),
    ],
)
def test_how_far_a_loop_may_be_from_closing(off_m: float, sigmas_m: tuple[float, ...], kept: bool) -> None:
    pair = VerifiedPair(0, 2, np.tile(np.arange(_POINTS)[:, None], 2), np.eye(3))
    assert loops_in_reach([pair], _placed(off_m, 30), np.array(sigmas_m)).tolist() == [kept]


@pytest.mark.parametrize(("known", "kept"), [(4, False), (5, True)])
def test_five_features_must_have_a_place(known: int, kept: bool) -> None:
    pair = VerifiedPair(0, 2, np.tile(np.arange(_POINTS)[:, None], 2), np.eye(3))
    assert loops_in_reach([pair], _placed(0.0, known), np.zeros(3)).tolist() == [kept]


def test_features_are_known_where_they_are_seen_from_apart_and_fit() -> None:
    """From places a degree and a half apart; within four pixels everywhere."""
    state, pixels = _rooms(np.zeros(3))
    pair = _pair(0, 5)
    for moved_px, known in ((3.0, True), (12.0, False)):
        moved = [one.copy() for one in pixels]
        moved[5][4, 1] += moved_px
        placed = place_features([pair], moved, state)
        assert placed.known[placed.labels[0]].sum() >= _POINTS - 1
        assert placed.known[placed.labels[0][4]] == known
        assert placed.labels[0][4] == placed.labels[5][4]
        np.testing.assert_allclose(_CAMERA.project(placed.rays[5]), moved[5], atol=1e-3)
    near, far = state.T_map_camera.copy(), state.T_map_camera.copy()
    for T, step_m, known in ((near, 0.02, False), (far, 0.4, True)):
        T[1, :3, 3] = T[0, :3, 3] + [step_m, 0.0, 0.0]
        room = np.random.default_rng(2).uniform([-1.5, 3.0, 0.4], [1.5, 5.0, 2.4], (_POINTS, 3))
        seen = [_CAMERA.project((room - T[k, :3, 3]) @ T[k, :3, :3]) for k in (0, 1)]
        both = State(T[:2], np.zeros((0, 3)), _CAMERA)
        assert place_features([_pair(0, 1)], seen, both).known.all() == known


@pytest.mark.parametrize(("agreeing", "found"), [(8, False), (9, True)])
def test_nine_points_must_say_where_a_loops_keyframes_stand(agreeing: int, found: bool) -> None:
    state, pixels = _rooms(np.array([0.0, 0.5, 0.0]))
    placed = place_features(_neighbours(), pixels, state)
    few = VerifiedPair(2, 9, np.tile(np.arange(agreeing)[:, None], 2), np.eye(3))
    assert (loop_pose(few, placed) is not None) is found


def test_of_two_ways_to_a_loops_pose_the_one_with_more_points_is_taken() -> None:
    """One keyframe's neighbours have placed a third of what the other's have."""
    state, pixels = _rooms(np.array([0.0, 0.5, 0.0]))
    placed = place_features(_neighbours(), pixels, state)
    for poor in (2, 9):
        known = placed.known.copy()
        known[placed.labels[poor][10:]] = False
        found = loop_pose(_pair(2, 9), replace(placed, known=known))
        assert found.first == 11 - poor


_ROUND = 100  # keyframes of one of the two rounds
_COUNT = 2 * _ROUND + 1
_DRIFT_DEG, _LONGER = 10.0, 1.02


def _walk() -> FloatArray:
    """Two rounds (K, 4, 4) of a circle of 6 m, upright, z up, the camera's x axis to the right."""
    angle = 2 * np.pi * np.arange(_COUNT) / _ROUND
    ahead = np.column_stack([-np.sin(angle), np.cos(angle), np.zeros(_COUNT)])
    down = np.tile([0.0, 0.0, -1.0], (_COUNT, 1))
    R = np.stack([np.cross(down, ahead), down, ahead], axis=2)
    return pose_matrix(R, 6.0 * np.column_stack([np.cos(angle), np.sin(angle), 0.2 * np.sin(3 * angle)]))


def _drifted(T: FloatArray) -> FloatArray:
    """The same with steps that are too long, and a heading that turns away."""
    turn = Rotation.from_rotvec([0.0, np.radians(_DRIFT_DEG) / len(T), 0.0]).as_matrix()
    found = [T[0]]
    for k in range(1, len(T)):
        step = np.linalg.inv(T[k - 1]) @ T[k]
        step[:3, :3] = turn @ step[:3, :3]
        step[:3, 3] *= _LONGER
        found.append(found[-1] @ step)
    return np.array(found)


def _state(T: FloatArray) -> State:
    along = np.gradient(T[:, :3, 3], axis=0)
    inertial = InertialState(along, np.zeros((len(T), 6)), np.eye(4), 0.0, np.array([0.0, 0.0, -9.81]))
    return State(T, np.zeros((0, 3)), _CAMERA, inertial)


def _loop(T: FloatArray, first: int, second: int) -> RelativePose:
    return RelativePose(first, second, np.linalg.inv(T[first]) @ T[second])


def _loops(T: FloatArray) -> list[RelativePose]:
    return [_loop(T, k, k + _ROUND) for k in range(0, _ROUND + 1, 5)]


def _fixes(T: FloatArray) -> list[Fix]:
    return [Fix(k, (T[k, 0, 3], T[k, 1, 3], T[k, 2, 3]), 0.02) for k in range(0, _COUNT, 20)]


def _furthest_m(T: FloatArray, other: FloatArray) -> float:
    return float(np.linalg.norm(T[:, :3, 3] - other[:, :3, 3], axis=1).max())


def test_loops_take_a_walks_drift_back() -> None:
    true = _walk()
    drifted = _drifted(true)
    assert _furthest_m(drifted, true) > 1.0
    found = bend(_state(drifted), _loops(true)).T_map_camera
    closed = [
        _furthest_m((found[one.first] @ one.T_first_second)[None], found[one.second][None]) for one in _loops(true)
    ]
    assert max(closed) < 0.02
    assert _furthest_m(found[:1], true[:1]) < 1e-3
    np.testing.assert_allclose(found[:, 2, :3], true[:, 2, :3], atol=np.radians(0.1))  # upright as before


def test_fixes_are_met_wherever_the_walk_was() -> None:
    true = _walk()
    found = bend(_state(_drifted(true)), [], _fixes(true)).T_map_camera
    assert _furthest_m(found, true) < 0.15


def test_one_wrong_loop_among_many_does_not_bend_the_walk() -> None:
    true = _walk()
    twins = RelativePose(10, 60, np.eye(4))  # twelve metres apart
    found = bend(_state(true), [*_loops(true), twins]).T_map_camera
    assert _furthest_m(found, true) < 0.05


def test_a_walk_that_closes_stays_and_velocities_turn_with_the_cameras() -> None:
    true = _walk()
    still = bend(_state(true), _loops(true))
    np.testing.assert_allclose(still.T_map_camera, true, atol=1e-6)
    drifted = _state(_drifted(true))
    found = bend(drifted, [], _fixes(true))
    assert found.inertial is not None
    assert drifted.inertial is not None
    seen = [np.einsum("kji,kj->ki", one.R_map_camera, one.inertial.velocities) for one in (drifted, found)]
    np.testing.assert_allclose(seen[0], seen[1], atol=1e-9)


def _straight(count: int) -> FloatArray:
    """Cameras a metre apart along their own way, z up."""
    R = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    return pose_matrix(np.tile(R, (count, 1, 1)), np.outer(np.arange(count), [1.0, 0, 0]))


def _cauchy(sigmas: float) -> float:
    return float(4.5 * np.log1p(sigmas**2 / 9))


@pytest.mark.parametrize("longer_m", [0.1, 1.0])
def test_loops_and_fixes_are_weighed_against_steps(longer_m: float) -> None:
    """Along a straight line all is one number a keyframe: the lowest cost, with three sigmas before doubt."""
    step_m = 0.021

    def lowest(cost: object) -> FloatArray:
        return np.asarray(
            minimize(
                cost,
                np.arange(1.0, 4.0),
                method="Nelder-Mead",
                options={"xatol": 1e-7, "fatol": 1e-10, "maxiter": 4000},
            ).x
        )  # type: ignore[call-overload]

    def steps(x: FloatArray) -> float:
        return float(np.sum((np.diff(np.append(0.0, x)) - 1) ** 2)) / step_m**2 / 2

    true = _straight(4)
    longer = true[3].copy()
    longer[0, 3] += longer_m
    loop = RelativePose(0, 3, np.linalg.inv(true[0]) @ longer)
    found = bend(_state(true), [loop]).T_map_camera
    expected = lowest(lambda x: steps(x) + _cauchy((x[2] - 3 - longer_m) / 0.05))
    np.testing.assert_allclose(found[1:, 0, 3], expected, atol=2e-4)
    np.testing.assert_allclose(found[:, 1:3, 3], 0, atol=1e-6)

    fixes = [Fix(0, (0.0, 0.0, 0.0), 9.0), Fix(3, (3.0 + longer_m, 0.0, 0.0), 9.0)]
    met = bend(_state(true), [], fixes).T_map_camera[:, 0, 3]

    def cost(x: FloatArray) -> float:
        return steps(x[1:] - x[0]) + _cauchy(x[0] / 0.05) + _cauchy((x[3] - 3 - longer_m) / 0.05)

    best = minimize(
        cost, np.arange(4.0), method="Nelder-Mead", options={"xatol": 1e-7, "fatol": 1e-10, "maxiter": 6000}
    ).x
    np.testing.assert_allclose(met, best, atol=5e-4)


def test_a_loop_turns_a_walk_by_what_headings_and_levels_are_worth() -> None:
    """About the vertical by the steps' tenth of a degree against the loop's half; about the level next to nothing."""
    true = _straight(5)
    for axis, share in ((2, (4 * 0.0104) / (4 * 0.0104 + 0.25)), (1, None)):
        turned = true[4].copy()
        turned[:3, :3] = Rotation.from_rotvec(np.radians(0.3) * np.eye(3)[axis]).as_matrix() @ turned[:3, :3]
        loop = RelativePose(0, 4, np.linalg.inv(true[0]) @ turned)
        found = bend(_state(true), [loop]).T_map_camera
        angle_deg = np.degrees(Rotation.from_matrix(found[4, :3, :3] @ true[4, :3, :3].T).as_rotvec())[axis]
        if share is None:
            assert 0 < angle_deg < 0.003
        else:
            assert angle_deg == pytest.approx(0.3 * share, rel=0.05)
