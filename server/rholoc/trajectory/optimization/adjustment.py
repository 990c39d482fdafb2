"""Joint least-squares adjustment of a walk's pictures, gyroscope, accelerometer and waypoints.

Unknowns: keyframe poses and points; with an IMU its pose, velocity and biases at every keyframe, gravity, its mounting
on the camera and its clock offset; the intrinsics if they were not given. IMU readings between keyframes are
preintegrated (Forster et al., 2017). Solved by gtsam; sightings and waypoints have Cauchy's loss.
"""

import contextlib
import functools
import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, C, D, E, G, L, S, V
from scipy.linalg import cho_factor, cho_solve

from rholoc.errors import InvalidCamera, MappingFailed
from rholoc.geometry import BoolArray, Camera, FloatArray
from rholoc.trajectory.optimization.descent import (
    Descent,
    elimination_order,
    held_points,
    ordered,
    split,
    with_points_held,
)
from rholoc.trajectory.optimization.factors import graph_of
from rholoc.trajectory.optimization.points import settled, usable_points
from rholoc.trajectory.optimization.problem import InertialState, Problem, State

_IMU_COORDINATES = 9  # of a preintegrated interval: rotation, displacement, velocity change
_COARSE, _FINE = 1e-3, 2e-4  # minimum relative cost decrease of a step before another one
_ELIMINATED = tuple(map(ord, "lxvb"))  # points and inertial states: what is left of the unknowns is small and dense
_MAX_DENSE = 4000  # unknowns left, up to which their information is inverted as a dense matrix


@dataclass(frozen=True, eq=False)
class Adjusted:
    """A solution.

    Attributes:
        state: the unknowns.
        used: (N,) mask of the sightings used.
        cost: half the robust sum of squares.
    """

    state: State
    used: BoolArray
    cost: float
    _graph: gtsam.NonlinearFactorGraph = field(repr=False)
    _values: gtsam.Values = field(repr=False)
    _ordering: gtsam.Ordering = field(repr=False)
    _held: Callable[[float], gtsam.GaussianFactorGraph] = field(repr=False)

    def covariances(self, keyframes: Sequence[int]) -> FloatArray:
        """Pose covariances (N, 6, 6) of some keyframes: x, y, z [m], then the rotation about the map's axes [rad].

        NaN if the measurements do not fix a pose.
        """
        to_map = np.zeros((len(keyframes), 6, 6))
        to_map[:, :3, 3:] = to_map[:, 3:, :3] = self.state.R_map_camera[list(keyframes)]
        found = np.array(self._marginals([C(k) for k in keyframes], 6)).reshape(-1, 6, 6)
        return np.asarray(to_map @ found @ to_map.transpose(0, 2, 1))

    def camera_sigmas(self) -> FloatArray:
        """Standard deviations (9,) of estimated fx, fy, skew, cx, cy, k1, k2, p1, p2; NaN if not fixed."""
        return np.asarray(np.sqrt(np.diag(self._marginals([D(0)], 9)[0])))

    def imu_misfit(self) -> float:
        """RMS of the IMU residuals in units of the assumed noise; 0 without an IMU."""
        factors = (self._graph.at(i) for i in range(self._graph.size()))
        squares = [
            2 * factor.error(self._values)
            for factor in factors
            if isinstance(factor, gtsam.CombinedImuFactorWithGravityVector)
        ]
        return float(np.sqrt(np.mean(squares) / _IMU_COORDINATES)) if squares else 0.0

    def _marginals(self, keys: Sequence[int], size: int) -> list[FloatArray]:
        """Covariances (size, size) of some unknowns, not points, with the weakest prior on the points that makes the
        system regular; NaN where it leaves them open, or if it is singular with every prior.
        """
        for system in with_points_held(self._graph.linearize(self._values), self._held):
            with contextlib.suppress(RuntimeError, np.linalg.LinAlgError):  # RuntimeError: gtsam's word for singular
                return self._marginals_of(system, keys, size)
        return [np.full((size, size), np.nan) for _ in keys]

    def _marginals_of(self, system: gtsam.GaussianFactorGraph, keys: Sequence[int], size: int) -> list[FloatArray]:
        """The same by one linear system: from the dense information of all but the points and the inertial states, or
        by a tree if that would be too large. Raises RuntimeError or LinAlgError if the system is singular.
        """
        gone, rest = split(self._ordering, _ELIMINATED)
        sizes = self._values.zeroVectors()
        *starts, total = itertools.accumulate((len(sizes.at(key)) for key in rest), initial=0)
        if total > _MAX_DENSE:
            tree = system.eliminateMultifrontal(self._ordering)
            return [_marginal(tree, key, size) for key in keys]
        _, reduced = system.eliminatePartialMultifrontal(ordered(gone))
        factor = cho_factor(reduced.hessian(ordered(rest))[0])
        own = np.zeros((total, len(keys), size))
        for k, key in enumerate(keys):
            start = starts[rest.index(key)]
            own[start : start + size, k] = np.eye(size)
        found = cho_solve(factor, own.reshape(total, -1)).reshape(own.shape)
        return [own[:, k].T @ found[:, k] for k in range(len(keys))]


def adjust(
    problem: Problem,
    state: State,
    iterations: int,
    progress: Callable[[float], None] = lambda fraction: None,
    coarsely: bool = False,
) -> Adjusted:
    """Optimize from a nearby state, mostly by Gauss–Newton steps.

    Points are triangulated from the state's poses. Points with at most 1.5° of parallax and outlier sightings are
    ignored in this call only.

    Args:
        iterations: maximum number.
        progress: called with the fraction of iterations done.
        coarsely: stop at a relative decrease of the cost below 1e-3 instead of 2e-4.

    Raises:
        MappingFailed: the measurements do not fix the shape of the walk, or the focal length becomes impossible.
    """
    points, used = usable_points(problem.observations, state, problem.pixel_sigma_px)
    state = replace(state, points=points)
    graph, values = graph_of(problem, state, used)
    ordering = elimination_order(values, problem.observations, used)
    held = functools.cache(lambda firmness: held_points(problem.observations, state, used, firmness))
    descent = Descent(graph, ordering, held, lambda values: _with_points_settled(values, problem, state, used))
    values, cost = descent.solve(values, iterations, _COARSE if coarsely else _FINE, progress)
    return Adjusted(_state_of(values, problem, state, used), used, cost, graph, values, ordering, held)


def _with_points_settled(values: gtsam.Values, problem: Problem, state: State, used: BoolArray) -> gtsam.Values:
    """The values with every point of a used sighting moved to its least reprojection error."""
    moved = _state_of(values, problem, state, used)
    sightings = problem.observations.at(used)
    points = settled(moved.points, sightings, moved, problem.pixel_sigma_px)
    there = gtsam.Values(values)
    for track in np.unique(sightings.tracks).tolist():
        there.update(L(track), points[track])
    return there


def _marginal(tree: gtsam.GaussianBayesTree, key: int, size: int) -> FloatArray:
    """Covariance (size, size) of one variable; NaN if it is unbounded."""
    with contextlib.suppress(RuntimeError):  # gtsam's word for a singular system
        return np.asarray(tree.marginalCovariance(key))
    return np.full((size, size), np.nan)


def _state_of(values: gtsam.Values, problem: Problem, state: State, used: BoolArray) -> State:
    """The ``state`` with the values of its unknowns; points without a used sighting stay."""
    T = np.array([values.atPose3(C(k)).matrix() for k in range(len(state.T_map_camera))])
    points = state.points.copy()
    for track in np.unique(problem.observations.tracks[used]).tolist():
        points[track] = values.atPoint3(L(track))
    camera = state.camera if problem.camera_sigmas is None else _from_gtsam(values.atCal3DS2(D(0)), state.camera)
    inertial = state.inertial
    if inertial is not None:
        velocities, biases = inertial.velocities.copy(), inertial.biases.copy()
        for k in range(len(T)):
            if values.exists(V(k)):
                bias = values.atConstantBias(B(k))
                velocities[k] = values.atVector(V(k))
                biases[k] = np.concatenate([bias.accelerometer(), bias.gyroscope()])
        clock_s = float(values.atVector(S(0))[0])
        inertial = InertialState(velocities, biases, values.atPose3(E(0)).matrix(), clock_s, values.atVector(G(0)))
    return State(T, points, camera, inertial)


def _from_gtsam(model: gtsam.Cal3DS2, camera: Camera) -> Camera:
    """The ``camera`` with gtsam's intrinsics. Raises MappingFailed if they are impossible."""
    fx, fy, _, cx, cy, k1, k2, p1, p2 = (float(value) for value in model.vector())
    try:
        return replace(camera, fx=fx, fy=fy, cx=cx, cy=cy, distortion=(k1, k2, p1, p2))
    except InvalidCamera as error:
        raise MappingFailed(
            "The pictures do not show what the camera's focal length is.",
            "Calibrate the camera (rholoc camera calibrate), or take pictures from places further apart.",
        ) from error
