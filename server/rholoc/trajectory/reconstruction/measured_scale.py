"""Scale of a reconstruction from depth pictures, known lengths, and the steps that odometry measured."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rholoc.geometry import Camera, FloatArray, Similarity
from rholoc.recordings.frames.depth import DepthImages
from rholoc.trajectory.frame.map_frame import ScaleMeasurement, ScaleSource
from rholoc.trajectory.optimization.adjustment import Adjusted
from rholoc.trajectory.optimization.problem import Problem, State, Step
from rholoc.trajectory.reconstruction.outcome import moved, right_sightings
from rholoc.trajectory.visual.tracks import Observations

DEPTH_SIGMA = 0.02  # of a depth, relative, including errors shared by neighbours
_MIN_SIGHTINGS = 8  # with a depth, for a keyframe to be used
_MIN_KEYFRAMES = 4
_PARTS = 12  # of the walk; ratios within a part are correlated, because its keyframes see the same points
_MAX_MISFIT = 0.1  # median relative deviation of the ratios from their median …
_MAX_START_SIGMA = 0.25  # … and sigma of the scale, for the reconstruction to be adjusted to depths
_LENGTH_SIGMA_M = 0.03  # of a measured distance between two hand-held camera positions
_SENSOR_SIGMA = 0.01  # scale error of depth cameras
_MIN_STEPS = 5
_MIN_STEP = 0.2  # of the mean step's length, below which a step says little
_MAX_STEP_MISFIT = 0.15  # as _MAX_MISFIT, of odometry
_MAX_STEP_ASIDE = 0.5  # median deviation of a step's end, as a share of its length
_ODOMETRY_SIGMA = 0.01  # scale error of wheels, trackers and mountings
_MAD_TO_SIGMA = 1.4826
_MEDIAN_TO_MEAN = 1.2533  # standard deviation of a median relative to that of a mean


def with_depths(observations: Observations, depth: DepthImages | None, camera: Camera) -> Observations:
    """The observations with measured depths along the optical axis [m], NaN where unknown; unchanged without depth
    pictures.

    Args:
        depth: depth pictures of the keyframes, or None.
        camera: of the keyframes.
    """
    if depth is None:
        return observations
    rays = camera.rays(observations.pixels)
    found = np.full(len(observations), np.nan)
    for keyframe in np.unique(observations.keyframes).tolist():
        image = depth.of_frame(keyframe, camera)
        if image is not None:
            rows = observations.keyframes == keyframe
            found[rows] = image.at(rays[rows])
    return replace(observations, depths=found)


def scaled_by_depth(problem: Problem, adjusted: Adjusted) -> State | None:
    """The reconstruction scaled to metres by its depths; None without a measurement of a sigma of at most 25 %."""
    found = scale_by_depth(problem, adjusted)
    if found is None or found.sigma > _MAX_START_SIGMA:
        return None
    return _in_metres(adjusted.state, found)


def scale_by_depth(problem: Problem, adjusted: Adjusted) -> ScaleMeasurement | None:
    """Median ratio of measured depths to depths of the reconstruction's points; None unless four keyframes have eight
    depths each.

    If ratios deviate by more than 10 % in the median, that is the sigma. Otherwise it combines the spread over
    consecutive parts of the walk with the depth camera's scale error.
    """
    if problem.observations.depths is None:
        return None
    right = right_sightings(problem, adjusted)
    ratios = _ratios(problem.observations, adjusted.state, adjusted.state.points)
    known = np.isfinite(ratios) & right
    keyframes = problem.observations.keyframes
    often = np.flatnonzero(np.bincount(keyframes[known]) >= _MIN_SIGHTINGS)
    if len(often) < _MIN_KEYFRAMES:
        return None
    ratio, misfit = _median(ratios[known])
    if misfit > _MAX_MISFIT:
        return ScaleMeasurement(ScaleSource.DEPTH, ratio, misfit)
    parts = np.array_split(often, min(_PARTS, len(often)))
    medians = np.array([np.median(ratios[known & np.isin(keyframes, part)]) for part in parts])
    spread = _MAD_TO_SIGMA * float(np.median(np.abs(medians / ratio - 1)))
    sigma = float(np.hypot(_MEDIAN_TO_MEAN * spread / np.sqrt(len(parts)), _SENSOR_SIGMA))
    return ScaleMeasurement(ScaleSource.DEPTH, ratio, sigma)


def scales_by_lengths(lengths: Sequence[tuple[int, int, float]], adjusted: Adjusted) -> list[ScaleMeasurement]:
    """One scale measurement for each known length.

    Args:
        lengths: two keyframes and the distance between them [m].
        adjusted: the reconstruction of these keyframes.
    """
    positions = adjusted.state.positions
    apart = [float(np.linalg.norm(positions[a] - positions[b])) for a, b, _ in lengths]
    return [
        ScaleMeasurement(ScaleSource.LENGTH, length_m / max(one, 1e-9), _LENGTH_SIGMA_M / length_m)
        for one, (_, _, length_m) in zip(apart, lengths, strict=True)
    ]


def scaled_by_steps(steps: Sequence[Step], adjusted: Adjusted) -> State | None:
    """The reconstruction scaled to metres by measured steps; None if these do not fix its scale to 10 %."""
    found = scale_by_steps(steps, adjusted)
    return _in_metres(adjusted.state, found) if found is not None and found.usable else None


def scale_by_steps(steps: Sequence[Step], adjusted: Adjusted) -> ScaleMeasurement | None:
    """Median ratio of measured steps to those of a reconstruction, over steps longer than 0.2 × the mean measured step.

    None with fewer than five such steps. Sigma is infinite if the lengths deviate by more than 15 % in the median, or
    the steps' ends by more than half their length.
    """
    T, positions = adjusted.state.T_map_camera, adjusted.state.positions
    source = ScaleSource.MOUNTING if all(step.is_mounting for step in steps) else ScaleSource.ODOMETRY
    measured = np.array([np.linalg.norm(step.T_first_second[:3, 3]) for step in steps])
    found = np.array([np.linalg.norm(positions[step.second] - positions[step.first]) for step in steps])
    long = (measured > _MIN_STEP * measured.mean()) & (found > 0) if steps else np.zeros(0, dtype=np.bool_)
    if long.sum() < _MIN_STEPS:
        return None
    ratio, misfit = _median(measured[long] / found[long])
    ends = [
        (step.first, step.second, step.T_first_second[:3, 3]) for step, used in zip(steps, long, strict=True) if used
    ]
    aside = [np.linalg.norm(ratio * T[a, :3, :3].T @ (positions[b] - positions[a]) - there) for a, b, there in ends]
    if misfit > _MAX_STEP_MISFIT or float(np.median(aside / measured[long])) > _MAX_STEP_ASIDE:
        return ScaleMeasurement(source, ratio, np.inf)
    sigma = _MEDIAN_TO_MEAN * _MAD_TO_SIGMA * misfit / np.sqrt(long.sum())
    return ScaleMeasurement(source, ratio, float(np.hypot(sigma, _ODOMETRY_SIGMA)))


def _in_metres(state: State, scale: ScaleMeasurement) -> State:
    return moved(state, Similarity(scale.ratio, np.eye(3), np.zeros(3)))


def _median(ratios: FloatArray) -> tuple[float, float]:
    """Median of ratios (N,), and their median relative deviation from it."""
    ratio = float(np.median(ratios))
    return ratio, float(np.median(np.abs(ratios / ratio - 1)))


def _ratios(observations: Observations, state: State, points: FloatArray) -> FloatArray:
    """Ratio (N,) of each sighting's measured depth to its point's depth; NaN if either is unknown."""
    assert observations.depths is not None
    T = state.T_map_camera[observations.keyframes]
    reached = np.einsum("ni,ni->n", points[observations.tracks] - T[:, :3, 3], T[:, :3, 2])
    return np.where(reached > 0, observations.depths, np.nan) / np.where(reached > 0, reached, 1.0)
