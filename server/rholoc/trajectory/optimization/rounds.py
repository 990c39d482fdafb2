"""Alternate between adjustment and outlier rejection."""

import itertools
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from rholoc.geometry import Camera, FloatArray, Lens
from rholoc.progress import ProgressListener, Stage
from rholoc.trajectory.optimization.adjustment import Adjusted, adjust
from rholoc.trajectory.optimization.points import residuals_px, triangulate
from rholoc.trajectory.optimization.problem import GIVEN, GUESSED, CameraSigmas, Problem, State
from rholoc.trajectory.visual.tracks import Observations

ITERATIONS = 12
LAST_ITERATIONS = 8
ROUNDS = 2  # of adjustment and outlier rejection
FAR_M = 0.15  # maximum gap of loops or waypoints that the adjustment closes without a pose graph
MIN_PX, OUTLIER = 2.5, 5.0  # residual of an outlier: at least this, and this many medians
_MIN_PIXEL_SIGMA_PX = 0.35
_MEDIAN_TO_SIGMA = 1 / 1.177  # sigma of one coordinate from the median norm of a normal two-vector
_MODELLED_DISTORTION = 4  # coefficients of a pinhole: k1, k2, p1, p2


class AdjustmentProgress:
    """Reports the progress of a chain of adjustments, which a fallback does not set back."""

    def __init__(self, progress: ProgressListener) -> None:
        self._progress = progress
        self._from, self._to, self._what = 0.4, 0.45, ""
        self._done = 0.0

    def step(self, start: float, end: float, what: str) -> Callable[[float], None]:
        """Listener of the next adjustment, named ``what``: maps its fraction to ``start`` … ``end``."""
        self._from, self._to, self._what = start, end, what
        self(0.0)
        return self

    def __call__(self, fraction: float) -> None:
        self._done = max(self._done, min(self._from + (self._to - self._from) * fraction, 0.99))
        self._progress(Stage.POSES, self._done, self._what)


def adjusted_in_rounds(
    problem: Problem, state: State, progress: AdjustmentProgress, span: tuple[float, float], rounds: int = ROUNDS
) -> tuple[Problem, Adjusted]:
    """Adjust ``rounds`` times, rejecting outliers in between; returns the problem with its inliers, and the solution.
    Raises MappingFailed.
    """
    everything = problem.observations
    edges = np.linspace(*span, rounds + 1).tolist()
    step = progress.step(edges[0], edges[1], "all measurements adjusted together")
    adjusted = adjust(problem, state, ITERATIONS, step, coarsely=True)
    for start, end in itertools.pairwise(edges[1:]):
        off = residuals_px(everything, adjusted.state, triangulate(everything, adjusted.state)[0])
        problem = _cleaned(problem, everything, off)
        again = progress.step(start, end, "adjusted anew")
        adjusted = adjust(problem, adjusted.state, ITERATIONS, again, coarsely=end < span[1])
    return problem, adjusted


def _cleaned(problem: Problem, observations: Observations, off_px: FloatArray) -> Problem:
    """The problem without outliers, its pixel noise estimated from the reprojection errors ``off_px`` (N,)."""
    typical = float(np.median(off_px[np.isfinite(off_px)]))
    kept = observations.take(off_px <= max(MIN_PX, OUTLIER * typical))
    sigma = max(_MIN_PIXEL_SIGMA_PX, _MEDIAN_TO_SIGMA * typical)
    return replace(problem, observations=kept, pixel_sigma_px=sigma)


def camera_sigmas(given: Camera | None, guessed: CameraSigmas = GUESSED) -> CameraSigmas | None:
    """Prior sigmas of intrinsics: ``guessed`` for None, ``GIVEN`` for a pinhole with up to four coefficients, else None
    (held).
    """
    if given is None:
        return guessed
    is_modelled = given.lens is Lens.PINHOLE and len(given.distortion) <= _MODELLED_DISTORTION
    return GIVEN if is_modelled else None
