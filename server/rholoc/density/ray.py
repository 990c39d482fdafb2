"""The ``ray`` density: equation (3) in s = (b, x), the bearing of a pixel and the camera's position.

The squared distance from a landmark m to the viewing ray of (b, x) is

    d²(b, x) = |m − x|² − (b · (m − x))²

a polynomial with powers ≤ 2 in every variable, so ρ_f(b, x) = max(0, 1 − d²/r²) is a member of equation (3) without
any fitting error. Its coefficients follow from m; m follows from information sums over the observations,

    Λ = Σ w (I − b bᵀ),   η = Σ w (I − b bᵀ) x,   m = Λ⁻¹ η,

which add: this is the observation-time estimation that the paper's conclusion wishes for (section 7).
"""

from __future__ import annotations

import numpy as np

from rholoc.geometry import FloatArray

_ALONG = 1e-9  # relative information along a direction below which a landmark has no place in it


def observation_information(
    bearings: FloatArray, positions: FloatArray, weights: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Each observation's own Λ (N, 3, 3) and η (N, 3).

    Args:
        bearings: (N, 3) unit vectors b in the map frame.
        positions: (N, 3) camera positions x, metres.
        weights: (N,) w, 1/m²: the inverse variance of the ray's distance from the landmark.
    """
    projectors = np.eye(3) - bearings[:, :, None] * bearings[:, None, :]
    information = weights[:, None, None] * projectors
    return information, np.einsum("nij,nj->ni", information, positions)


def landmarks_from_information(information: FloatArray, eta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """m = Λ⁻¹ η and its covariance Λ⁻¹, for F features at once.

    Args:
        information: (F, 3, 3), 1/m².
        eta: (F, 3), 1/m.

    Returns:
        Landmarks (F, 3), metres, and covariances (F, 3, 3), m². A feature whose rays are all parallel has no
        landmark: NaN in both.
    """
    values = np.linalg.eigvalsh(information)
    determined = values[:, 0] > _ALONG * values[:, 2]
    covariances = np.full_like(information, np.nan)
    covariances[determined] = np.linalg.inv(information[determined])
    return np.einsum("fij,fj->fi", covariances, eta), covariances


def squared_ray_distance(landmarks: FloatArray, bearings: FloatArray, positions: FloatArray) -> FloatArray:
    """d² of landmarks (..., 3) to the rays of bearings (..., 3) from positions (..., 3), m²."""
    to_landmark = landmarks - positions
    along = np.einsum("...i,...i->...", bearings, to_landmark)
    return np.einsum("...i,...i->...", to_landmark, to_landmark) - along**2


def ray_density(
    landmarks: FloatArray, bearings: FloatArray, positions: FloatArray, tolerances: FloatArray
) -> FloatArray:
    """ρ = max(0, 1 − d²/r²) (...) for tolerances r (...) in metres; 0 for landmarks behind the camera."""
    density = 1 - squared_ray_distance(landmarks, bearings, positions) / tolerances**2
    ahead = np.einsum("...i,...i->...", bearings, landmarks - positions) > 0
    return np.asarray(np.where(ahead, np.maximum(density, 0), 0))


def ray_density_gradient(
    landmarks: FloatArray, bearings: FloatArray, positions: FloatArray, tolerances: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """∂ρ/∂b (..., 3) and ∂ρ/∂x (..., 3, 1/m), equation (4); 0 where ρ is 0."""
    to_landmark = landmarks - positions
    along = np.einsum("...i,...i->...", bearings, to_landmark)[..., None]
    inside = ray_density(landmarks, bearings, positions, tolerances) > 0
    scale = np.where(inside, 2 / tolerances**2, 0)[..., None]
    return scale * along * to_landmark, scale * (to_landmark - along * bearings)
