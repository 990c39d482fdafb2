"""What the map's own uncertainty does to an answer.

A map is bent a little: each of its views is known to a covariance, and the landmarks around it err as it does. Where
the map is displaced, every landmark near a pose is displaced alike, so no number of matches averages it out: it adds to
the pose's covariance undiminished, and lowers the probability that the pose is right.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.special import gammainc, ndtri

from rholoc.geometry import FloatArray

RIGHT_M, RIGHT_RAD = 0.10, float(np.deg2rad(5.0))
"""What confidence speaks of: a pose is right within 10 cm and 5°."""
PLACE_M, PLACE_RAD = 0.50, float(np.deg2rad(20.0))
"""What ``recognized`` speaks of: a pose is of the right place within 50 cm and 20°."""

_GOLDEN = 1.1127756842787055  # the golden ratio's kin in six dimensions: g⁷ = g + 1
_DIRECTIONS = 512  # over which the probability is averaged; it is then good to a percent


def carried_covariances(covariances: FloatArray, positions: FloatArray, to: FloatArray) -> FloatArray:
    """What the uncertainty of poses (N, 6, 6) at ``positions`` (N, 3) makes of a pose at ``to`` (3,), each alone.

    The surroundings of a pose move with it as a rigid body: δx = δx_n + δθ_n × (to − x_n), δθ = δθ_n. Position in
    metres, rotation in radians, a small rotation in the map frame from the left.
    """
    x, y, z = (to - positions).T
    J = np.tile(np.eye(6), (len(positions), 1, 1))
    J[:, 0, 4], J[:, 0, 5] = z, -y
    J[:, 1, 3], J[:, 1, 5] = -z, x
    J[:, 2, 3], J[:, 2, 4] = y, -x
    return np.asarray(J @ covariances @ J.transpose(0, 2, 1))


def map_covariance_at(
    covariances: FloatArray, positions: FloatArray, weights: FloatArray, to: FloatArray
) -> FloatArray | None:
    """The covariance (6, 6) of the map itself at a place ``to`` (3,), by the views that an answer rests on.

    Neighbouring views err together, so theirs are averaged, not multiplied.

    Args:
        covariances: (K, 6, 6) of the views' poses; NaN where unknown.
        positions: (K, 3) of the views.
        weights: (K,) how much of the answer rests on each view.

    Returns:
        None where no view that the answer rests on has a known covariance.
    """
    used = np.flatnonzero((weights > 0) & np.isfinite(covariances).all(axis=(1, 2)))
    if len(used) == 0:
        return None
    carried = carried_covariances(covariances[used], positions[used], to)
    share = weights[used] / weights[used].sum()
    return np.asarray(np.einsum("k,kij->ij", share, carried))


def rms_position_error(covariance: FloatArray) -> float:
    """The expected position error (root mean square, metres) of a covariance (6, 6) of a pose."""
    return float(np.sqrt(np.trace(covariance[:3, :3])))


def worst_sigma(covariance: FloatArray) -> float:
    """Standard deviation along the worst axis of a covariance (3, 3), in the square root of its unit."""
    return float(np.sqrt(max(float(np.linalg.eigvalsh(covariance)[-1]), 0.0)))


def probability_right(covariance: FloatArray, within_m: float = RIGHT_M, within_rad: float = RIGHT_RAD) -> float:
    """The probability that a pose of this covariance (6, 6) is within both bounds of the truth.

    The error is ρ L u: u a uniform direction in six dimensions, ρ² of the χ² distribution with six degrees of freedom,
    L Lᵀ the covariance. Along a direction both bounds are one on ρ.
    """
    values, vectors = np.linalg.eigh(covariance)
    errors = _directions() @ (vectors * np.sqrt(np.maximum(values, 0))).T
    position, rotation = np.linalg.norm(errors[:, :3], axis=1), np.linalg.norm(errors[:, 3:], axis=1)
    farthest = np.minimum(within_m / np.maximum(position, 1e-12), within_rad / np.maximum(rotation, 1e-12))
    return float(gammainc(3.0, farthest**2 / 2).mean())


def trust_in_map(
    local: FloatArray, map_covariance: FloatArray | None, within_m: float = RIGHT_M, within_rad: float = RIGHT_RAD
) -> float:
    """0..1, by how much the map's own uncertainty lowers the probability that a pose is within both bounds.

    ``local`` (6, 6) is the pose's covariance in a map that is exact.
    """
    if map_covariance is None:
        return 1.0
    alone = probability_right(local, within_m, within_rad)
    return min(probability_right(local + map_covariance, within_m, within_rad) / alone, 1.0) if alone > 0 else 1.0


@cache
def _directions() -> FloatArray:
    """(N, 6) unit vectors, evenly spread, the same each time: by the additive recurrence of Roberts (2018).

    SciPy has sequences like it, in ``scipy.stats``, whose import is a tenth of the time that a server takes to start.
    """
    uniform = (0.5 + np.outer(np.arange(1, _DIRECTIONS + 1), _GOLDEN ** -np.arange(1.0, 7.0))) % 1
    normal = ndtri(uniform)
    return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))
