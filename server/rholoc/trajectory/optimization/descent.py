"""Descent to the least cost of a factor graph: Gauss–Newton steps, points eliminated first."""

import contextlib
import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, C, D, E, G, L, S, V, X
from scipy.sparse import triu

from rholoc.errors import MappingFailed
from rholoc.geometry import BoolArray
from rholoc.lazy import lazy
from rholoc.trajectory.optimization.problem import State
from rholoc.trajectory.visual.tracks import Observations, shared_points

_FIRST_DAMPING = 10.0
_SHARES = (1.0, 0.5, 0.25)  # of a failed step, to retry with every point re-optimized
_POINTS = (ord("l"),)
_HOLDS = (1e-2, 0.3, 10.0)  # increasing strengths of the points' prior, each used if a step fails with the one before


@dataclass(frozen=True, eq=False)
class Descent:
    """Optimizer of one problem.

    Attributes:
        graph: its factors.
        ordering: elimination order of its unknowns.
        held: strength → prior that keeps the points near their present positions.
        settled: values → values with every point re-optimized alone.
    """

    graph: gtsam.NonlinearFactorGraph
    ordering: gtsam.Ordering
    held: Callable[[float], gtsam.GaussianFactorGraph]
    settled: Callable[[gtsam.Values], gtsam.Values]

    def solve(
        self, values: gtsam.Values, iterations: int, tolerance: float, progress: Callable[[float], None]
    ) -> tuple[gtsam.Values, float]:
        """Minimize the cost in at most ``iterations`` steps; returns values and cost.

        Stops at a relative decrease of at most ``tolerance``. Raises MappingFailed if the system is singular.
        """
        cost, weakest = self.graph.error(values), 0
        for done in range(iterations):
            before = cost
            values, cost, used = self._stepped(values, cost, weakest)
            weakest = max(used - 1, 0)
            progress((done + 1) / iterations)
            if before - cost <= tolerance * before:
                break
        return values, cost

    def _stepped(self, values: gtsam.Values, cost: float, weakest: int) -> tuple[gtsam.Values, float, int]:
        """Gauss–Newton step; if none lowers the cost, a Levenberg–Marquardt step, which takes three times as long. A
        long step mostly fails because the points lag behind: it is retried, whole and in part, with every point
        re-optimized. The points' prior has the strength ``weakest`` of ``_HOLDS`` or more. Returns values, cost and the
        strength used. Raises MappingFailed if the system is singular.
        """
        systems = with_points_held(self.graph.linearize(values), self.held, weakest)
        for firmness, system in enumerate(systems, weakest):
            try:
                step = self._solved(system)
            except RuntimeError:  # gtsam's word for a singular system
                continue
            for there in self._along(values, step):
                lower = self.graph.error(there)
                if lower < cost:
                    return there, lower, firmness
        parameters = gtsam.LevenbergMarquardtParams()
        parameters.setlambdaInitial(_FIRST_DAMPING)
        parameters.setOrdering(self.ordering)
        optimizer = gtsam.LevenbergMarquardtOptimizer(self.graph, values, parameters)
        try:
            optimizer.iterate()
        except RuntimeError:
            raise MappingFailed(
                "What was measured leaves the shape of the walk open.", "Walk further, and in loops."
            ) from None
        return optimizer.values(), optimizer.error(), weakest

    def _solved(self, system: gtsam.GaussianFactorGraph) -> gtsam.VectorValues:
        """Solution of a linear system. Points are eliminated one by one: a tree of them takes up to twice as long.
        Raises RuntimeError if the system is singular.
        """
        points, rest = self._points_and_rest
        eliminated, reduced = system.eliminatePartialSequential(points)
        return eliminated.optimize(reduced.optimize(rest))

    @lazy
    def _points_and_rest(self) -> tuple[gtsam.Ordering, gtsam.Ordering]:
        """Elimination order of the points, and that of all other unknowns."""
        points, rest = split(self.ordering, _POINTS)
        return ordered(points), ordered(rest)

    def _along(self, values: gtsam.Values, step: gtsam.VectorValues) -> Iterator[gtsam.Values]:
        """Iterate over the values after the whole step, then after it and parts of it with the points settled."""
        yield values.retract(step)
        for share in _SHARES:
            with contextlib.suppress(MappingFailed):  # impossible intrinsics
                yield self.settled(values.retract(step.scale(share)))


def optimized(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, iterations: int) -> gtsam.Values:
    """Values of least cost from ``values``, by at most so many steps of Levenberg–Marquardt. Raises RuntimeError if the
    system is singular.
    """
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(iterations)
    return gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()


def elimination_order(values: gtsam.Values, observations: Observations, used: BoolArray) -> gtsam.Ordering:
    """Elimination order: points, keyframes by nested dissection, shared unknowns. Ordering the whole graph would take
    longer than the step, because nearly every factor contains the intrinsics.
    """
    sightings = observations.at(used)
    count = int(sightings.keyframes.max(initial=-1)) + 1
    together = np.column_stack(triu(shared_points(count, sightings)).nonzero())
    inertial = [k for k in range(count) if values.exists(X(k))]
    joined = [sorted({C(a), C(b)}) for a, b in together.tolist()]
    joined += [[C(k), X(k), V(k), B(k)] for k in inertial]
    joined += [[X(a), V(a), B(a), X(b), V(b), B(b)] for a, b in itertools.pairwise(inertial)]
    graph = gtsam.SymbolicFactorGraph()
    for keys in joined:
        graph.push_back(gtsam.SymbolicFactor.FromKeys(keys))
    dissected = gtsam.Ordering.MetisSymbolicFactorGraph(graph)
    keys = [L(point) for point in np.unique(sightings.tracks).tolist()]
    keys += [dissected.at(i) for i in range(dissected.size())]
    rest = set(values.keys()) - set(keys)
    shared = [key for key in (G(0), S(0), E(0), D(0)) if key in rest]
    return ordered([*keys, *sorted(rest - set(shared)), *shared])


def ordered(keys: Sequence[int]) -> gtsam.Ordering:
    """gtsam's ordering of ``keys``."""
    ordering = gtsam.Ordering()
    for key in keys:
        ordering.push_back(key)
    return ordering


def split(ordering: gtsam.Ordering, kinds: Sequence[int]) -> tuple[list[int], list[int]]:
    """Keys of the unknowns of some ``kinds`` (the characters of their symbols) in their order, and of all others."""
    keys = [ordering.at(i) for i in range(ordering.size())]
    some = [key for key in keys if gtsam.symbolChr(key) in kinds]
    return some, [key for key in keys if gtsam.symbolChr(key) not in kinds]


def held_points(
    observations: Observations, state: State, used: BoolArray, firmness: float
) -> gtsam.GaussianFactorGraph:
    """Prior that keeps each point near its position relative to its distance: weak points would jump behind cameras.

    It is on the points of the observations ``used`` (O,); the distance is the largest to their cameras. ``firmness``
    should be small, because the prior also holds the walk's scale.
    """
    tracks, count = observations.tracks[used], observations.points
    away = np.zeros(count)
    np.maximum.at(
        away, tracks, np.linalg.norm(state.points[tracks] - state.positions[observations.keyframes[used]], axis=1)
    )
    held = gtsam.GaussianFactorGraph()
    noise, nowhere, same = gtsam.noiseModel.Unit.Create(3), np.zeros(3), np.eye(3)
    for track in np.unique(tracks).tolist():
        held.push_back(gtsam.JacobianFactor(L(track), firmness / max(away[track], 1e-9) * same, nowhere, noise))
    return held


def with_points_held(
    linear: gtsam.GaussianFactorGraph, held: Callable[[float], gtsam.GaussianFactorGraph], weakest: int = 0
) -> Iterator[gtsam.GaussianFactorGraph]:
    """Iterate over copies of the linear system with increasingly strong priors on its points."""
    for firmness in _HOLDS[weakest:]:
        system = gtsam.GaussianFactorGraph()
        system.push_back(linear)
        system.push_back(held(firmness))
        yield system
