"""Effect of the map's own uncertainty on an answer.

Each view's pose in the map has a covariance, and the landmarks around the view share its error. All landmarks near a
pose are displaced alike, so more matches do not average this error out: it is added to the pose's covariance in full,
and lowers the probability that the pose is right.
"""

from functools import cache

import numpy as np
from scipy.special import gammainc, ndtri

from rholoc.geometry import FloatArray

RIGHT_M, RIGHT_RAD = 0.10, float(np.deg2rad(5.0))
"""What confidence speaks of: a pose is right within 10 cm and 5°."""
PLACE_M, PLACE_RAD = 0.50, float(np.deg2rad(20.0))
"""What ``recognized`` speaks of: a pose is of the right place within 50 cm and 20°."""

INDEPENDENT_SHARE = 1 / 16
"""Share of a frame's own covariance, without the errors that its landmarks share.

A frame's own covariance allows, threefold, for what it cannot see: neighbouring landmarks err together. Most of that is
the map's own error; where that is counted apart, the factor three goes, and a little more: in simulated maps of exact
poses 1/22 of the variance covers 95 % of the errors, in those of estimated poses 1/16.
"""

_GOLDEN = 1.1127756842787055  # the golden ratio's kin in six dimensions: g⁷ = g + 1
_DIRECTIONS = 512  # over which the probability is averaged; it is then good to a percent


def carried_covariances(covariances: FloatArray, positions: FloatArray, to: FloatArray) -> FloatArray:
    """Carry the covariances of view poses over to another place, each on its own.

    The surroundings of a view move with it as a rigid body: δx = δx_n + δθ_n × (to − x_n), δθ = δθ_n.

    Args:
        covariances: (N, 6, 6) of the view poses: position [m], then a small rotation [rad] in the map frame from the
            left.
        positions: (N, 3) of the views [m].
        to: (3,) the other place [m].

    Returns:
        (N, 6, 6) covariances of the map at ``to``.
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
    """Covariance (6, 6) of the map at a place: weighted mean of the views' covariances, carried there by
    :func:`carried_covariances`.

    Errors of neighbouring views are correlated, so their covariances are averaged, not fused.

    Args:
        covariances: (K, 6, 6) of the view poses: position [m], then rotation [rad], map frame; NaN if unknown.
        positions: (K, 3) of the views, map frame [m].
        weights: (K,) how much the answer relies on each view.
        to: (3,) the place [m].

    Returns:
        None if no view with a positive weight has a known covariance.
    """
    used = np.flatnonzero((weights > 0) & np.isfinite(covariances).all(axis=(1, 2)))
    if len(used) == 0:
        return None
    carried = carried_covariances(covariances[used], positions[used], to)
    share = weights[used] / weights[used].sum()
    return np.asarray(np.einsum("k,kij->ij", share, carried))


def rms_position_error(covariance: FloatArray) -> float:
    """Expected position error (root mean square) [m] under a pose covariance (6, 6)."""
    return float(np.sqrt(np.trace(covariance[:3, :3])))


def worst_sigma(covariance: FloatArray) -> float:
    """Standard deviation along the worst axis of a covariance (3, 3), in the square root of its unit."""
    return float(np.sqrt(max(float(np.linalg.eigvalsh(covariance)[-1]), 0.0)))


def probability_right(covariance: FloatArray, within_m: float = RIGHT_M, within_rad: float = RIGHT_RAD) -> float:
    """Probability that a pose with this covariance (6, 6) is within both bounds of the truth.

    The error is ρ L u with u a uniform direction in six dimensions, ρ² χ²-distributed with six degrees of freedom, and
    L Lᵀ the covariance. Along each direction both bounds limit ρ; the probability is averaged over directions.

    Args:
        covariance: position [m], then rotation [rad].
        within_m: bound on the position error.
        within_rad: bound on the rotation error.
    """
    values, vectors = np.linalg.eigh(covariance)
    errors = _directions() @ (vectors * np.sqrt(np.maximum(values, 0))).T
    position, rotation = np.linalg.norm(errors[:, :3], axis=1), np.linalg.norm(errors[:, 3:], axis=1)
    farthest = np.minimum(within_m / np.maximum(position, 1e-12), within_rad / np.maximum(rotation, 1e-12))
    return float(gammainc(3.0, farthest**2 / 2).mean())


def widening_factor(
    own: FloatArray, others: FloatArray, within_m: float = RIGHT_M, within_rad: float = RIGHT_RAD
) -> float:
    """Factor 0 to 1 by which further errors lower the probability that a pose is within both bounds; 1 if it is 0
    already.

    Args:
        own: (6, 6) covariance of the pose.
        others: (6, 6) of the further errors.
        within_m: bound on the position error.
        within_rad: bound on the rotation error.
    """
    alone = probability_right(own, within_m, within_rad)
    return min(probability_right(own + others, within_m, within_rad) / alone, 1.0) if alone > 0 else 1.0


@cache
def _directions() -> FloatArray:
    """(512, 6) evenly spread unit vectors, deterministic: the additive recurrence of Roberts (2018). ``scipy.stats``
    has such sequences, but importing it takes a tenth of a server's start-up time.
    """
    uniform = (0.5 + np.outer(np.arange(1, _DIRECTIONS + 1), _GOLDEN ** -np.arange(1.0, 7.0))) % 1
    normal = ndtri(uniform)
    return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))
