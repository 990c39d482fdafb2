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

from rholoc.geometry import FloatArray, IntArray

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
    return np.asarray(np.einsum("...i,...i->...", to_landmark, to_landmark) - along**2)


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


def ray_coefficients(landmarks: FloatArray, tolerances: FloatArray) -> FloatArray:
    """Equation (3)'s coefficients (F, 729) of 1 − d²/r² in s = (bx, by, bz, x, y, z), degree 2, in Table 5's order.

    Closed form, from |m − x|² = Σ (m_i² − 2 m_i x_i + x_i²) and (b · (m − x))² = Σ b_i b_j (m_i − x_i)(m_j − x_j).

    Args:
        landmarks: (F, 3) m, metres.
        tolerances: (F,) r, metres.
    """
    coefficients = np.zeros((len(landmarks), *(3,) * 6))
    unit = np.eye(3, dtype=np.int64)
    none = np.zeros(3, dtype=np.int64)

    def add(b_powers: IntArray, x_powers: IntArray, value: FloatArray | float) -> None:
        coefficients[(slice(None), *b_powers, *x_powers)] += value

    for i in range(3):
        m_i = landmarks[:, i]
        add(none, none, -(m_i**2))
        add(none, unit[i], 2 * m_i)
        add(none, 2 * unit[i], -1)
        for j in range(3):
            m_j, along = landmarks[:, j], unit[i] + unit[j]
            add(along, none, m_i * m_j)
            add(along, unit[i], -m_j)
            add(along, unit[j], -m_i)
            add(along, unit[i] + unit[j], 1)
    scaled = coefficients.reshape(len(landmarks), -1) / (tolerances**2)[:, None]
    scaled[:, 0] += 1
    return scaled
