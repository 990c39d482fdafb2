"""Which waypoint is mistaken: what all else says of its place, without itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rholoc.geometry import FloatArray

_CAUCHY = 3.0  # sigmas, as in the adjustment
_MISTAKEN_SIGMAS = 4.5  # off what all else says
_MISTAKEN_M = 0.08
_LEAST_SAY = 1e-3  # of all else in a waypoint's place, as a share of its own: less may be rounding
_ONE_AXIS = 0.9  # the share of the error that lies along the coordinate that is named


@dataclass(frozen=True, eq=False)
class LeftOut:
    """A waypoint held against what the walk says of its place without it.

    Attributes:
        off_m: (3,) where it was measured less where the walk has it.
        sigmas: how far that is, in standard deviations of the two.
    """

    off_m: FloatArray
    sigmas: float

    @property
    def mistaken(self) -> bool:
        """Whether it is far likelier that the waypoint is wrong than that the walk is bent."""
        return self.sigmas > _MISTAKEN_SIGMAS and float(np.linalg.norm(self.off_m)) > _MISTAKEN_M


def leave_out(measured: FloatArray, estimated: FloatArray, covariance: FloatArray, sigma_m: float) -> LeftOut:
    """Take a waypoint's own say out of an estimate that it took part in.

    From the estimate's information the waypoint's, as its loss weighed it, is subtracted; no new solution is needed.

    Args:
        measured: (3,) metres.
        estimated: (3,) the camera's place in the solution.
        covariance: (3, 3) of that, m².
        sigma_m: the waypoint's, in each coordinate.
    """
    off = measured - estimated
    weight = 1 / (1 + (float(np.linalg.norm(off)) / (sigma_m * _CAUCHY)) ** 2) / sigma_m**2
    information = np.linalg.inv(covariance) - weight * np.eye(3)
    values, axes = np.linalg.eigh(information)
    without = (axes / np.maximum(values, _LEAST_SAY * weight)) @ axes.T
    return held_against(off + weight * without @ off, np.zeros(3), without, sigma_m)


def held_against(measured: FloatArray, estimated: FloatArray, covariance: FloatArray, sigma_m: float) -> LeftOut:
    """Hold a waypoint against an estimate that it took no part in; arguments as in :func:`leave_out`."""
    off = measured - estimated
    expected = covariance + sigma_m**2 * np.eye(3)
    return LeftOut(off, float(np.sqrt(off @ np.linalg.solve(expected, off))))


def explain(name: str, off_m: FloatArray) -> str:
    """One line on a mistaken waypoint: which coordinate is wrong, where it is one alone."""
    size = float(np.linalg.norm(off_m))
    axis = int(np.argmax(np.abs(off_m)))
    if abs(off_m[axis]) >= _ONE_AXIS * size:
        return f"{name}: its {'xyz'[axis]} looks wrong by {abs(off_m[axis]):.2f} m; it was left out."
    return f"{name} is {size:.2f} m from where the walk has it; it was left out."


def worst(names: Sequence[str], found: Sequence[LeftOut]) -> int | None:
    """The mistaken waypoint that is furthest off, if any is."""
    mistaken = [i for i in range(len(names)) if found[i].mistaken]
    return max(mistaken, key=lambda i: found[i].sigmas, default=None)
