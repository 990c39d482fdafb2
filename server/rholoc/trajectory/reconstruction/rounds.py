"""An adjustment, judging all sightings anew by what came out, and again."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from rholoc.geometry import Camera, FloatArray, Lens
from rholoc.progress import ProgressListener, Stage
from rholoc.trajectory.optimization.adjustment import (
    GIVEN,
    GUESSED,
    Adjusted,
    CameraSigmas,
    Problem,
    State,
    adjust,
    residuals_px,
    triangulate,
)
from rholoc.trajectory.visual.tracks import Observations

ITERATIONS = 12
LAST_ITERATIONS = 8
ROUNDS = 2  # of adjusting and judging sightings anew …
FAR_M = 0.15  # by which a walk is bent at most where an adjustment alone closes its loops, or meets its waypoints
FEWEST_PX, OUTLIER = 2.5, 5.0  # a sighting this far off is left out, or so many times the median
_LEAST_PIXEL_SIGMA_PX = 0.35
_MEDIAN_TO_SIGMA = 1 / 1.177  # of a coordinate, from the median length of a two-vector of normal errors
_MODELLED_DISTORTION = 4  # coefficients of a pinhole: k1, k2, p1, p2


class AdjustmentProgress:
    """Reports how far a chain of adjustments is."""

    def __init__(self, progress: ProgressListener) -> None:
        self._progress = progress
        self._from, self._to, self._what = 0.4, 0.45, ""

    def step(self, start: float, end: float, what: str) -> Callable[[float], None]:
        """The next one goes from one fraction to another."""
        self._from, self._to, self._what = start, end, what
        self(0.0)
        return self

    def __call__(self, fraction: float) -> None:
        done = self._from + (self._to - self._from) * fraction
        self._progress(Stage.POSES, min(done, 0.99), self._what)


def adjusted_in_rounds(
    problem: Problem, state: State, progress: AdjustmentProgress, span: tuple[float, float], rounds: int = ROUNDS
) -> tuple[Problem, Adjusted]:
    """Adjust, and judge all sightings anew by what comes out; the problem with those that are right."""
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
    typical = float(np.median(off_px[np.isfinite(off_px)]))
    kept = observations.take(off_px <= max(FEWEST_PX, OUTLIER * typical))
    sigma = max(_LEAST_PIXEL_SIGMA_PX, _MEDIAN_TO_SIGMA * typical)
    return replace(problem, observations=kept, pixel_sigma_px=sigma)


def camera_sigmas(given: Camera | None) -> CameraSigmas | None:
    """How far the walk may correct the intrinsics: not at all where the adjustment's model could not hold them."""
    if given is None:
        return GUESSED
    is_modelled = given.lens is Lens.PINHOLE and len(given.distortion) <= _MODELLED_DISTORTION
    return GIVEN if is_modelled else None
