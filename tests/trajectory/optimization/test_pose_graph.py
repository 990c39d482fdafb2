"""A walk that drifted for metres is bent until its loops close and its waypoints are met."""

from __future__ import annotations

import numpy as np
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
