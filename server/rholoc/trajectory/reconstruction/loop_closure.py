"""Loop closures, accepted where the walk without them allows."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rholoc.trajectory.optimization.adjustment import Adjusted
from rholoc.trajectory.optimization.loop_verification import PlacedFeatures, loop_pose, loops_in_reach, place_features
from rholoc.trajectory.optimization.pose_graph import bend
from rholoc.trajectory.optimization.problem import Problem, State
from rholoc.trajectory.optimization.rounds import FAR_M, ROUNDS, AdjustmentProgress, adjusted_in_rounds
from rholoc.trajectory.reconstruction.figures import spread_covariances
from rholoc.trajectory.reconstruction.sights import Evidence, Sights
from rholoc.trajectory.visual.matching import VerifiedPair

_JUDGING = 12  # keyframes with a computed covariance while loops are verified


def with_loops_closed(
    sights: Sights, evidence: Evidence, problem: Problem, adjusted: Adjusted, progress: AdjustmentProgress
) -> tuple[Evidence, Problem, Adjusted]:
    """Adjust with the loops that the walk without them allows; verify all loops again after the first closure.

    Returns the evidence with only these loops, the problem and the solution; unchanged if there are no candidates.
    Raises MappingFailed.
    """
    if not evidence.loops:
        return evidence, problem, adjusted
    pixels = [features.pixels.astype(np.float64) for features in sights.features]
    for span, rounds in (((0.6, 0.65), 1), ((0.65, 0.75), ROUNDS)):
        sigmas_m = np.sqrt(np.trace(spread_covariances(adjusted, len(pixels), _JUDGING)[:, :3, :3], axis1=1, axis2=2))
        placed = place_features(evidence.sequential, pixels, adjusted.state)
        in_reach = loops_in_reach(evidence.loops, placed, sigmas_m)
        kept = [pair for pair, keep in zip(evidence.loops, in_reach, strict=True) if keep]
        problem = replace(problem, observations=replace(evidence, loops=kept).observations(sights))
        problem, adjusted = adjusted_in_rounds(problem, _with_loops_met(kept, placed), progress, span, rounds)
    return replace(evidence, loops=kept), problem, adjusted


def _with_loops_met(loops: Sequence[VerifiedPair], placed: PlacedFeatures) -> State:
    """State of the walk: after a pose graph if that moves a keyframe by more than ``FAR_M``, else as it is."""
    poses = [pose for pair in loops if (pose := loop_pose(pair, placed)) is not None]
    bent = bend(placed.state, poses)
    moved_m = np.linalg.norm(bent.positions - placed.state.positions, axis=1)
    return bent if moved_m.max() > FAR_M else placed.state
