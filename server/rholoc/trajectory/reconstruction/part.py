"""Some pictures of a walk without an IMU, adjusted together."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rholoc.geometry import BoolArray, Camera, FloatArray, IntArray
from rholoc.recordings import Waypoint
from rholoc.trajectory.checks.agreement import Agreement, compare
from rholoc.trajectory.optimization.adjustment import Adjusted, adjust
from rholoc.trajectory.optimization.problem import ANY, Fix, Problem, State
from rholoc.trajectory.optimization.resection import with_missing_placed
from rholoc.trajectory.optimization.rounds import (
    LAST_ITERATIONS,
    AdjustmentProgress,
    adjusted_in_rounds,
    camera_sigmas,
)
from rholoc.trajectory.reconstruction.figures import median_depth_of
from rholoc.trajectory.reconstruction.measured_scale import DEPTH_SIGMA, scaled_by_depth, scaled_by_steps, with_depths
from rholoc.trajectory.reconstruction.outcome import held_keyframes, right_sightings
from rholoc.trajectory.reconstruction.pair_fit import without_contradicted
from rholoc.trajectory.reconstruction.sights import FEATURES_PER_KEYFRAME, Evidence, Sights
from rholoc.trajectory.visual.tracks import MIN_SIGHTINGS, Observations

_FEWEST_OF_SET = 2  # sightings of a point: pictures far apart share few points with two others
_ROUNDS = 3  # two left wrong reconstructions uncontradicted

Start = tuple[State, IntArray]
"""State of some pictures, and their numbers (N,), increasing."""


@dataclass(frozen=True, eq=False)
class Pictured:
    """A walk without an IMU: what its pictures show, and what else was measured.

    Attributes:
        sights: sightings of K keyframes.
        camera: of the sights, or a first guess of it.
        evidence: of the sights.
        waypoints: assignments of times to the waypoints; a single one if times are known. Empty without waypoints.
        reason: one line on why the IMU was not used, or empty.
    """

    sights: Sights
    camera: Camera
    evidence: Evidence
    waypoints: Sequence[tuple[Waypoint, ...]] = ()
    reason: str = ""

    def observations(self) -> Observations:
        """Sightings of corners and matched features, with their depths where these were measured. Raises MappingFailed
        if there are none.
        """
        return self.observed(self.evidence, FEATURES_PER_KEYFRAME)

    def observed(self, evidence: Evidence, features: int) -> Observations:
        """Sightings by given evidence, with about ``features`` matched features per keyframe. Raises MappingFailed."""
        fewest = MIN_SIGHTINGS if self.sights.is_film else _FEWEST_OF_SET
        found = evidence.observations(self.sights, features, fewest)
        return with_depths(found, self.sights.depth, self.camera)

    def rays(self) -> list[FloatArray]:
        """Rays (F, 3) of each picture's features, in its camera's frame."""
        return [self.camera.rays(found.pixels) for found in self.sights.features]

    def matched(self, lens: int, other: int) -> list[tuple[FloatArray, FloatArray]]:
        """Matches of each clear pair of a picture by lens ``lens`` with one by lens ``other`` (or the same).

        Returns for each pair the pixels (M, 2) in the former and in the latter picture.
        """
        lenses = np.zeros(len(self.sights.rows)) if self.sights.lenses is None else self.sights.lenses
        places = [found.pixels.astype(np.float64) for found in self.sights.features]
        found: list[tuple[FloatArray, FloatArray]] = []
        for pair in self.evidence.sequential:
            seen = places[pair.first][pair.matches[:, 0]], places[pair.second][pair.matches[:, 1]]
            by = lenses[pair.first], lenses[pair.second]
            if by == (lens, other):
                found.append(seen)
            elif by == (other, lens):
                found.append(seen[::-1])
        return found


@dataclass(frozen=True, eq=False)
class Part:
    """An adjusted reconstruction of some of K pictures.

    Attributes:
        members: (N,) the pictures, increasing.
        problem, adjusted: of those.
        in_metres: whether depth pictures gave it its first poses, so that they check its shape.
        zooms: (N,) of each picture relative to the camera, which its sightings are corrected for; or None.
        apart: first poses of further pieces by the same mapper, each in a frame and scale of its own.
        by_waypoints: numbers of pictures of the pieces that the waypoints alone join: of the first, and those that each
            further one adds; empty if there is one piece.
    """

    members: IntArray
    problem: Problem
    adjusted: Adjusted
    in_metres: bool = False
    zooms: FloatArray | None = None
    apart: tuple[Start, ...] = ()
    by_waypoints: tuple[int, ...] = ()

    @property
    def start(self) -> Start:
        """Its pictures and their poses, without points."""
        return replace(self.adjusted.state, points=np.zeros((0, 3))), self.members

    @property
    def inliers(self) -> int:
        """Number of sightings that its poses explain."""
        return int(right_sightings(self.problem, self.adjusted).sum())

    def held_poses(self, count: int) -> tuple[FloatArray, BoolArray]:
        """Poses T (K, 4, 4) of K = ``count`` pictures, and which of them (K,) it holds by their sightings alone."""
        T, held = np.tile(np.eye(4), (count, 1, 1)), np.zeros(count, dtype=np.bool_)
        T[self.members], held[self.members] = (
            self.adjusted.state.T_map_camera,
            held_keyframes(self.problem, self.adjusted),
        )
        return T, held


def adjusted_part(
    walk: Pictured,
    whole: Observations,
    start: Start,
    progress: AdjustmentProgress,
    span: tuple[float, float],
    fixes: tuple[Fix, ...] = (),
) -> Part:
    """Adjust some pictures from their first poses ``start`` to those of the ``whole`` sightings they see, and to
    ``fixes``. Also to depths or odometry steps, in metres, if these fix the scale. Raises MappingFailed.
    """
    sights, (state, members) = walk.sights, start
    number = np.full(len(sights.rows), -1)
    number[members] = np.arange(len(members))
    numbered = replace(whole, keyframes=number[whole.keyframes])
    observations = numbered.take(numbered.keyframes >= 0)
    sigmas = camera_sigmas(sights.camera, ANY)
    problem = Problem(sights.times[members], observations, fixes=fixes, camera_sigmas=sigmas, camera_mean=walk.camera)
    problem, adjusted = adjusted_in_rounds(problem, state, progress, span, _ROUNDS)
    scaled = scaled_by_depth(problem, adjusted)
    if scaled is not None:
        problem = replace(problem, depth_sigma=DEPTH_SIGMA)
        adjusted = adjust(problem, scaled, LAST_ITERATIONS, progress)
    steps = sights.take(members).steps
    scaled = scaled_by_steps(steps, adjusted)
    if scaled is not None:
        problem = replace(problem, steps=steps)
        adjusted = adjust(problem, scaled, LAST_ITERATIONS, progress)
    return Part(members, problem, adjusted)


def extended(start: Start, walk: Pictured, whole: Observations) -> Start:
    """The pictures of ``start`` and those that they place by the ``whole`` sightings, without points. Pictures that the
    clear pairs contradict there are left out.
    """
    state, members = start
    found = with_missing_placed(whole, members, state, len(walk.sights.rows))
    if len(found[1]) == len(members):
        return found
    return without_contradicted(found, members, walk.evidence.sequential, walk.rays())


def agreement_of(part: Part, other: Part) -> Agreement:
    """Agreement of two reconstructions, over the pictures of the smaller one."""
    one, two = sorted((part, other), key=lambda some: len(some.members), reverse=True)
    count = int(max(one.members.max(), two.members.max())) + 1
    T, placed = one.held_poses(count)
    return comparison_with(T, placed, median_depth_of(one.problem.observations, one.adjusted), two)


def comparison_with(T: FloatArray, placed: BoolArray, median_depth: float, other: Part) -> Agreement:
    """Compare poses T (K, 4, 4), valid where ``placed`` (K,), with a part."""
    held = held_keyframes(other.problem, other.adjusted)
    return compare(T, placed, other.members, other.adjusted.state.T_map_camera, held, median_depth)
