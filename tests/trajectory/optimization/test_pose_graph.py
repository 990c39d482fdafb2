"""A walk that drifted for metres is bent until its loops close and its waypoints are met."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from rholoc.geometry import Camera, FloatArray, pose_matrix
from rholoc.trajectory.optimization.adjustment import Fix, InertialState, State
from rholoc.trajectory.optimization.pose_graph import RelativePose, bend

_CAMERA = Camera(640, 480, 520.0, 520.0, 319.5, 239.5)
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
