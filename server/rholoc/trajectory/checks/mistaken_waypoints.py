"""Find mistaken waypoints: compare each with the walk estimated without it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rholoc.geometry import FloatArray

_CAUCHY = 3.0  # sigmas, as in the adjustment
_MISTAKEN_SIGMAS = 4.5  # distance of a mistaken waypoint from the walk without it
_MISTAKEN_M = 0.08
_MIN_INFORMATION = 1e-3  # of all other measurements, relative to the waypoint's own: less may be rounding
_ONE_AXIS = 0.9  # share of the error along one coordinate, for a message to name that coordinate


@dataclass(frozen=True, eq=False)
class LeftOut:
    """A waypoint compared with the walk estimated without it.

    Attributes:
        off_m: (3,) measured minus estimated position [m].
        sigmas: length of ``off_m`` in standard deviations of the difference; NaN if unknown.
    """

    off_m: FloatArray
    sigmas: float

    @property
    def mistaken(self) -> bool:
        """Whether a wrong waypoint is far more likely than a bent walk: off by more than 4.5 sigmas and 8 cm."""
        return self.sigmas > _MISTAKEN_SIGMAS and float(np.linalg.norm(self.off_m)) > _MISTAKEN_M


def leave_out(measured: FloatArray, estimated: FloatArray, covariance: FloatArray, sigma_m: float) -> LeftOut:
    """Compare a waypoint with the solution after removing the waypoint's own contribution.

    Subtracts the waypoint's information, weighted by its robust loss, from the estimate's: no new solution is needed.

    Args:
        measured: (3,) waypoint [m].
        estimated: (3,) camera position in the solution [m].
        covariance: (3, 3) of ``estimated`` [m²].
        sigma_m: standard deviation of each waypoint coordinate [m].
    """
    off = measured - estimated
    weight = 1 / (1 + (float(np.linalg.norm(off)) / (sigma_m * _CAUCHY)) ** 2) / sigma_m**2
    information = np.linalg.inv(covariance) - weight * np.eye(3)
    values, axes = np.linalg.eigh(information)
    without = (axes / np.maximum(values, _MIN_INFORMATION * weight)) @ axes.T
    return compare_unused(off + weight * without @ off, np.zeros(3), without, sigma_m)


def compare_unused(measured: FloatArray, estimated: FloatArray, covariance: FloatArray, sigma_m: float) -> LeftOut:
    """Compare a waypoint with a solution that did not use it; arguments as in :func:`leave_out`."""
    off = measured - estimated
    expected = covariance + sigma_m**2 * np.eye(3)
    return LeftOut(off, float(np.sqrt(off @ np.linalg.solve(expected, off))))


def explain(name: str, off_m: FloatArray) -> str:
    """One line on the mistaken waypoint ``name``, off by (3,) [m]; names a coordinate that has 90 % of the error."""
    size = float(np.linalg.norm(off_m))
    axis = int(np.argmax(np.abs(off_m)))
    if abs(off_m[axis]) >= _ONE_AXIS * size:
        return f"{name}: its {'xyz'[axis]} looks wrong by {abs(off_m[axis]):.2f} m; it was left out."
    return f"{name} is {size:.2f} m from where the walk has it; it was left out."


def worst(names: Sequence[str], found: Sequence[LeftOut]) -> int | None:
    """Number of the mistaken waypoint with the most sigmas; None if none is mistaken."""
    mistaken = [i for i in range(len(names)) if found[i].mistaken]
    return max(mistaken, key=lambda i: found[i].sigmas, default=None)
