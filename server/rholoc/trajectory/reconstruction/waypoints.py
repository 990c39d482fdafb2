"""Adjust a walk to its waypoints, except mistaken ones."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rholoc.geometry import FloatArray
from rholoc.recordings import Waypoint
from rholoc.recordings.tables.waypoints import DEFAULT_SIGMA_M
from rholoc.trajectory.checks.mistaken_waypoints import LeftOut, compare_unused, leave_out, worst
from rholoc.trajectory.frame.map_frame import (
    MapFrame,
    ScaleMeasurement,
    frame_of_first_camera,
    frame_of_waypoints,
)
from rholoc.trajectory.frame.waypoint_alignment import MAX_GAP_S, UpMeasurement
from rholoc.trajectory.optimization.adjustment import Adjusted, adjust
from rholoc.trajectory.optimization.pose_graph import RelativePose, bend
from rholoc.trajectory.optimization.problem import Fix, Problem, State
from rholoc.trajectory.optimization.rounds import FAR_M, ITERATIONS, LAST_ITERATIONS, AdjustmentProgress
from rholoc.trajectory.reconstruction.figures import median_depth_of
from rholoc.trajectory.reconstruction.outcome import Solved, moved
from rholoc.trajectory.visual.matching import VerifiedPair

_NOISE_PRIOR = 2.0  # weight of the assumed waypoint noise, in coordinates
_NOISE_FACTORS = (0.4, 2.0)
_MIN_TRUSTED = 3  # waypoints that must remain
_MAX_MISTAKES = 0.34  # maximum share of mistaken waypoints


def in_map_frame(
    problem: Problem,
    adjusted: Adjusted,
    waypoints: Sequence[tuple[Waypoint, ...]],
    up: tuple[UpMeasurement | None, str],
    scales: Sequence[ScaleMeasurement],
    loops: Sequence[VerifiedPair],
    progress: AdjustmentProgress,
) -> Solved:
    """The walk adjusted to the waypoints in their frame; without waypoints, in the first camera's, upright if ``up`` is
    known.

    Args:
        up: the upward direction, and one line on it.
        scales: measurements of the walk's scale.
        loops: loop closures.

    Raises:
        MappingFailed: the walk misses the waypoints.
    """
    T = adjusted.state.T_map_camera
    if not waypoints:
        depth = median_depth_of(problem.observations, adjusted)
        return Solved(problem, adjusted, frame_of_first_camera(T, *up, depth, scales))
    frame = frame_of_waypoints(problem.times, T, waypoints, *up, scales)
    problem = replace(
        problem,
        observations=problem.observations.scaled(frame.similarity.scale),
        level_sigma_rad=problem.level_sigma_rad if frame.upright else None,
    )
    return _held_by_waypoints(problem, adjusted.state, frame, loops, progress)


def _held_by_waypoints(
    problem: Problem,
    state: State,
    frame: MapFrame,
    loops: Sequence[VerifiedPair],
    progress: AdjustmentProgress,
) -> Solved:
    """Adjust with the waypoints; remove mistaken ones (at most a third, leaving three), the largest error first. Raises
    MappingFailed.
    """
    fixes = fixes_of(problem.times, frame.waypoints)
    state = _with_waypoints_met(moved(state, frame.similarity), tuple(fixes.values()), loops)
    most = _MAX_MISTAKES * len(fixes)
    mistaken: list[str] = []
    for attempt in range(int(most) + 2):
        trusted = [name for name in fixes if name not in mistaken]
        problem = replace(problem, fixes=tuple(fixes[name] for name in trusted))
        step = progress.step(0.75 + 0.05 * min(attempt, 2), 0.8 + 0.05 * min(attempt, 2), "adjusted to the waypoints")
        adjusted = adjust(problem, state, ITERATIONS, step)
        state = adjusted.state
        left_out = _each_left_out(fixes, mistaken, adjusted)
        wrong = worst(trusted, [left_out[name] for name in trusted])
        if wrong is None or len(trusted) <= _MIN_TRUSTED or len(mistaken) + 1 > most:
            break
        mistaken.append(trusted[wrong])
    factor = _noise_factor([left_out[name].sigmas for name in trusted])
    problem = replace(problem, fixes=tuple(_of_noise(fix, factor) for fix in problem.fixes))
    adjusted = adjust(problem, state, LAST_ITERATIONS, progress.step(0.9, 0.95, "adjusted to the waypoints"))
    return Solved(problem, adjusted, frame, True, left_out, tuple(mistaken))


def fixes_of(times: FloatArray, waypoints: Sequence[Waypoint]) -> dict[str, Fix]:
    """The keyframe (of ``times`` (K,) [s]) at each waypoint, by the waypoint's name; none where no keyframe is near."""
    nearest = {waypoint: int(np.abs(times - waypoint.time).argmin()) for waypoint in waypoints}
    return {
        waypoint.name: Fix(keyframe, waypoint.position, waypoint.sigma_m)
        for waypoint, keyframe in nearest.items()
        if abs(times[keyframe] - waypoint.time) <= MAX_GAP_S
    }


def _each_left_out(fixes: dict[str, Fix], mistaken: Sequence[str], adjusted: Adjusted) -> dict[str, LeftOut]:
    """Comparison of each waypoint with the walk estimated without it, by name.

    ``adjusted`` did not use the ``mistaken`` waypoints. Sigma is NaN if the walk's covariance is unknown there.
    """
    covariances = adjusted.covariances([fix.keyframe for fix in fixes.values()])[:, :3, :3]
    found = {}
    for (name, fix), covariance in zip(fixes.items(), covariances, strict=True):
        judge = compare_unused if name in mistaken else leave_out
        place = adjusted.state.positions[fix.keyframe]
        if not np.isfinite(covariance).all():
            found[name] = LeftOut(np.array(fix.position) - place, np.nan)
            continue
        found[name] = judge(np.array(fix.position), place, covariance, fix.sigma_m)
    return found


def _of_noise(fix: Fix, factor: float) -> Fix:
    """The fix with its sigma scaled by ``factor``, unless the sigma was stated (is not the default)."""
    return replace(fix, sigma_m=factor * fix.sigma_m) if fix.sigma_m == DEFAULT_SIGMA_M else fix


def _with_waypoints_met(state: State, fixes: tuple[Fix, ...], loops: Sequence[VerifiedPair]) -> State:
    """The walk after a pose graph if it has an IMU and misses the fixes by more than ``FAR_M`` in the median, else as
    it is.
    """
    missed_m = [np.linalg.norm(state.positions[fix.keyframe] - fix.position) for fix in fixes]
    if state.inertial is None or np.median(missed_m) <= FAR_M:
        return state
    T = state.T_map_camera
    closed = [RelativePose(a, b, np.linalg.inv(T[a]) @ T[b]) for a, b in ((pair.first, pair.second) for pair in loops)]
    return bend(state, closed, fixes)


def _noise_factor(sigmas: Sequence[float]) -> float:
    """Ratio of actual to assumed waypoint noise, 0.4 to 2, from each waypoint's error in sigmas (NaN is ignored). RMS
    over three coordinates each, with a prior at 1 because waypoints are few.
    """
    sigmas = [value for value in sigmas if np.isfinite(value)]
    squares = _NOISE_PRIOR + sum(value**2 for value in sigmas)
    return float(np.clip(np.sqrt(squares / (_NOISE_PRIOR + 3 * len(sigmas))), *_NOISE_FACTORS))
