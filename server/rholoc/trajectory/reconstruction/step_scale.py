"""The scale of a reconstruction by measured steps, as odometry has them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rholoc.geometry import Similarity
from rholoc.trajectory.frame.map_frame import ScaleMeasurement, ScaleSource
from rholoc.trajectory.optimization.adjustment import Adjusted, State, Step
from rholoc.trajectory.reconstruction.outcome import moved

_MIN_STEPS = 5
_LEAST_STEP = 0.2  # of the median step's length, below which a step says little
_MAX_MISFIT = 0.15  # of ratios from their median, in the median, above which odometry contradicts the pictures
_MAD_TO_SIGMA, _MEDIAN_TO_MEAN = 1.4826, 1.2533
_ODOMETRY_SIGMA = 0.01  # by which wheels and trackers are usually off as a whole


def scale_by_steps(steps: Sequence[Step], adjusted: Adjusted) -> ScaleMeasurement | None:
    """Median ratio of measured steps to those of a reconstruction; None where too few are long enough."""
    positions = adjusted.state.positions
    measured = np.array([np.linalg.norm(step.T_first_second[:3, 3]) for step in steps])
    found = np.array([np.linalg.norm(positions[step.second] - positions[step.first]) for step in steps])
    long = (measured > _LEAST_STEP * measured.mean()) & (found > 0) if steps else np.zeros(0, dtype=np.bool_)
    if long.sum() < _MIN_STEPS:
        return None
    ratios = measured[long] / found[long]
    ratio = float(np.median(ratios))
    misfit = float(np.median(np.abs(ratios / ratio - 1)))
    if misfit > _MAX_MISFIT:
        return ScaleMeasurement(ScaleSource.ODOMETRY, ratio, np.inf)
    sigma = _MEDIAN_TO_MEAN * _MAD_TO_SIGMA * misfit / np.sqrt(len(ratios))
    return ScaleMeasurement(ScaleSource.ODOMETRY, ratio, float(np.hypot(sigma, _ODOMETRY_SIGMA)))


def scaled_by_steps(steps: Sequence[Step], adjusted: Adjusted) -> State | None:
    """The reconstruction in metres, to be adjusted to steps; None where these do not fix its scale."""
    found = scale_by_steps(steps, adjusted)
    if found is None or not found.usable:
        return None
    return moved(adjusted.state, Similarity(found.ratio, np.eye(3), np.zeros(3)))
