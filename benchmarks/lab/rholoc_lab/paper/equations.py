"""The paper's equations as they stand, which the product computes in other ways."""

import numpy as np

from rholoc.density import Densities, Evidence, TensorDensities
from rholoc.density.polynomial import monomial_derivatives, tensor_powers
from rholoc.density.recursive_least_squares import RecursiveFit
from rholoc.density.tensor import LocalVariables
from rholoc.geometry import FloatArray
from rholoc.localization.pose.ascent import normal_equations
from rholoc.localization.types import Dof


def polynomial_values(coefficients: FloatArray, degree: int, s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Values (F,), equation (3), and gradients (F, n), equation (4), at one point (n,) of polynomials with coefficients
    (F, (degree + 1)ⁿ) in the order of Table 5.
    """
    both = coefficients @ monomial_derivatives(tensor_powers(len(s), degree), s)
    return both[:, 0], both[:, 1:]


def squared_ray_distance(landmarks: FloatArray, bearings: FloatArray, positions: FloatArray) -> FloatArray:
    """d² of landmarks (..., 3) to the rays of bearings (..., 3) from positions (..., 3), m²."""
    away = landmarks - positions
    return np.asarray((away**2).sum(axis=-1) - (bearings * away).sum(axis=-1) ** 2)


def ray_density(
    landmarks: FloatArray, bearings: FloatArray, positions: FloatArray, tolerances: FloatArray
) -> FloatArray:
    """ρ = max(0, 1 − d²/r²) (...) for tolerances r (...) in metres; 0 for landmarks behind the camera."""
    ahead = (bearings * (landmarks - positions)).sum(axis=-1) > 0
    inside = np.maximum(1 - squared_ray_distance(landmarks, bearings, positions) / tolerances**2, 0)
    return np.asarray(inside * ahead)


def batch_fit(phi: FloatArray, values: FloatArray, ridge: float, forgetting: float = 1.0) -> RecursiveFit:
    """All observations (N, X) with values (N, K) at once: what :meth:`RecursiveFit.observe` arrives at."""
    count = len(phi)
    weights = forgetting ** np.arange(count - 1, -1, -1.0)
    information = (phi * weights[:, None]).T @ phi + forgetting**count * ridge * np.eye(phi.shape[1])
    return RecursiveFit(np.linalg.solve(information, (phi * weights[:, None]).T @ values), np.linalg.inv(information))


def variables_at(densities: TensorDensities, plane: FloatArray, T_map_camera: FloatArray) -> FloatArray:
    """s (T, 8) of pixels ``plane`` (T, 2) on the plane z = 1, each for its density, of a camera at (4, 4)."""
    local = LocalVariables.of(densities, plane, T_map_camera)
    return np.column_stack([local.plane, local.position, local.heading])


def gradient(densities: Densities, evidence: Evidence, T_map_camera: FloatArray, tolerance_px: float) -> FloatArray:
    """∂ Σ log(ε + ρ) / ∂(position, rotation) (6,) at fixed tolerances: equation (4) through (2)."""
    local = densities.near(evidence, T_map_camera, tolerance_px)
    return normal_equations(local, evidence.epsilon, T_map_camera, tolerance_px, Dof.FREE)[0]
