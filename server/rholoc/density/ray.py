"""The ``ray`` density: equation (3) in s = (b, x), the bearing of a pixel and the camera's position.

The squared distance from a landmark m to the viewing ray of (b, x) is

    d²(b, x) = |m − x|² − (b · (m − x))²

a polynomial with powers ≤ 2 in every variable, so ρ_f(b, x) = max(0, 1 − d²/r²) is a member of equation (3) without
any fitting error. Its coefficients follow from m; m follows from information sums over the observations,

    Λ = Σ w (I − b bᵀ),   η = Σ w (I − b bᵀ) x,   m = Λ⁻¹ η,

which add: this is the observation-time estimation that the paper's conclusion asks for (section 7).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from rholoc.density.density import TARGET_RADIUS, Arrays, DensityKind, DensityRows, Sightings, Slopes
from rholoc.density.evidence import Evidence
from rholoc.geometry import FloatArray, IntArray, Similarity, cross

_AGREE = 1e-6  # relative, of written coefficients with those that follow from the landmark
_ALONG = 1e-9  # relative information along a direction below which a landmark is undetermined along it


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


def range_information(
    bearings: FloatArray, positions: FloatArray, ranges_m: FloatArray, weights: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Λ (N, 3, 3) [1/m²] and η (N, 3) [1/m] of measured distances, to add to :func:`observation_information`.

    Args:
        bearings, positions: as of :func:`observation_information`.
        ranges_m: (N,) distances of the landmarks from the cameras; where NaN, nothing is added.
        weights: (N,) 1/m²: the inverse variance of the distance.
    """
    known = np.isfinite(ranges_m)
    along = np.where(known, weights, 0.0)[:, None, None] * (bearings[:, :, None] * bearings[:, None, :])
    at = positions + np.where(known, ranges_m, 0.0)[:, None] * bearings
    return along, np.einsum("nij,nj->ni", along, at)


def landmarks_from_information(information: FloatArray, eta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """m = Λ⁻¹ η and its covariance Λ⁻¹, for F features at once.

    Args:
        information: (F, 3, 3), 1/m².
        eta: (F, 3), 1/m.

    Returns:
        Landmarks (F, 3), metres, and covariances (F, 3, 3), m². NaN in both for a feature with parallel rays only
        (smallest eigenvalue of Λ at most 1e-9 × the largest).
    """
    values = np.linalg.eigvalsh(information)
    determined = values[:, 0] > _ALONG * values[:, 2]
    covariances = np.full_like(information, np.nan)
    covariances[determined] = np.linalg.inv(information[determined])
    return np.einsum("fij,fj->fi", covariances, eta), covariances


def _along_and_aside(
    landmarks: FloatArray, bearings: FloatArray, positions: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Signed distance (...) [m] of a landmark (..., 3) along the ray, and its squared distance d² [m²] from it."""
    to_landmark = landmarks - positions
    along = np.einsum("...i,...i->...", bearings, to_landmark)
    return along, np.einsum("...i,...i->...", to_landmark, to_landmark) - along**2


def ray_densities(evidence: Evidence, T_map_camera: FloatArray, tolerance_px: float) -> FloatArray:
    """ρ (H, M) of all matches at poses (H, 4, 4), for a pixel tolerance plus each landmark's variance."""
    bearings = evidence.rays @ T_map_camera[:, :3, :3].transpose(0, 2, 1)
    along, aside = _along_and_aside(evidence.landmarks, bearings, T_map_camera[:, None, :3, 3])
    density = 1 - aside / _squared_tolerances(evidence, along, tolerance_px)
    return np.asarray(np.where(along > 0, np.maximum(density, 0), 0))


def squared_tolerances(evidence: Evidence, T_map_camera: FloatArray, tolerance_px: float) -> FloatArray:
    """r² (M,) [m²] of all matches at a pose (4, 4): (tolerance in metres at the landmark's depth)² + its variance."""
    bearings = evidence.rays @ T_map_camera[:3, :3].T
    along = np.einsum("mi,mi->m", bearings, evidence.landmarks - T_map_camera[:3, 3])
    return _squared_tolerances(evidence, along, tolerance_px)


def _squared_tolerances(evidence: Evidence, along: FloatArray, tolerance_px: float) -> FloatArray:
    """r² (..., M) [m²]: (tolerance in metres at the distances ``along`` (..., M))² + the landmarks' variances."""
    return np.asarray((tolerance_px / evidence.focal_px * along) ** 2 + evidence.variances)


@dataclass(frozen=True, eq=False)
class RayOffsets:
    """The offsets of M landmarks from the rays that they are matched with, at one pose.

    Attributes:
        offset: (M, 2) e = Eᵀ R_camera_map (m − x), metres: d² = |e|².
        jacobian: (M, 2, 6) of e by a small motion of the camera (position, rotation from the left; map frame).
    """

    offset: FloatArray
    jacobian: FloatArray

    @classmethod
    def of(cls, evidence: Evidence, T_map_camera: FloatArray) -> RayOffsets:
        """Offsets of evidence at a pose (4, 4)."""
        return cls.between(evidence.landmarks, evidence.across, T_map_camera)

    @classmethod
    def between(cls, landmarks: FloatArray, basis: FloatArray, T_map_camera: FloatArray) -> RayOffsets:
        """Offsets at a pose (4, 4) of landmarks (M, 3), map frame, from rays.

        ``basis`` (M, 3, 2) has two unit vectors perpendicular to each ray, camera frame.
        """
        to_landmark = landmarks - T_map_camera[:3, 3]
        rows = basis.transpose(0, 2, 1).reshape(-1, 3) @ T_map_camera[:3, :3].T  # at once: twice as fast as one by one
        across = rows.reshape(-1, 2, 3)  # map frame
        # ∂e/∂x = −(R E)ᵀ; a rotation δ from the left turns m − x by −δ: ∂e/∂δ = (R E)ᵀ [m − x]×
        jacobian = np.empty((len(to_landmark), 2, 6))
        jacobian[:, :, :3] = -across
        jacobian[:, :, 3:] = cross(across, to_landmark[:, None])
        return cls(np.einsum("mri,mi->mr", across, to_landmark), jacobian)

    def whitened(self, covariances: FloatArray, variance: FloatArray) -> tuple[FloatArray, FloatArray]:
        """L⁻¹ e (M, 2) and L⁻¹ ∂e (M, 2, 6).

        L Lᵀ = S (M, 2, 2), the landmarks' ``covariances`` (M, 3, 3) across their rays + ``variance`` (M,) I, m².
        """
        e, J = self.offset, self.jacobian
        moving = J[:, :, :3]  # a landmark that moves does what a camera does that moves the other way
        spread = moving @ covariances @ moving.transpose(0, 2, 1)
        first = np.sqrt(spread[:, 0, 0] + variance)
        mixed = spread[:, 1, 0] / first
        second = np.sqrt(spread[:, 1, 1] + variance - mixed**2)
        white, roots = np.empty_like(e), np.empty_like(J)
        white[:, 0], roots[:, 0] = e[:, 0] / first, J[:, 0] / first[:, None]
        white[:, 1] = (e[:, 1] - mixed * white[:, 0]) / second
        roots[:, 1] = (J[:, 1] - mixed[:, None] * roots[:, 0]) / second[:, None]
        return white, roots


@dataclass(frozen=True, eq=False)
class RayDensities:
    """The ``ray`` densities of a map: a function of its landmarks and their covariances alone."""

    kind: ClassVar[DensityKind] = DensityKind.RAY
    has_exact_peaks: ClassVar[bool] = True
    variables: ClassVar[tuple[str, ...]] = ("bx", "by", "bz", "x", "y", "z")
    degrees: ClassVar[tuple[int, ...]] = (2,)
    domain_columns: ClassVar[tuple[str, ...]] = ("tolerance",)

    @property
    def degree(self) -> int:
        """Always 2."""
        return 2

    def near(self, evidence: Evidence, T_map_camera: FloatArray, tolerance_px: float) -> LocalRayDensities:
        """Densities of all matches, because a ray density is valid at every pose."""
        return LocalRayDensities(evidence)

    def problem(self, features: int) -> str:
        """Always empty: any map can have them."""
        return ""

    def rows(self, sightings: Sightings, variances: FloatArray) -> DensityRows:
        """A row for each feature. Its domain is the tolerance r (1,) [m], with r² = a² + variance.

        a is 60 px (at a focal length of 525 px) at the mean distance of its views, or at 1 m without views.
        """
        count = len(sightings.landmarks)
        away = np.linalg.norm(sightings.positions - sightings.landmarks[sightings.features], axis=1)
        seen = np.bincount(sightings.features, minlength=count)
        total = np.bincount(sightings.features, weights=away, minlength=count)
        distance = np.where(seen > 0, total / np.maximum(seen, 1), 1.0)
        tolerances = np.sqrt((TARGET_RADIUS * distance) ** 2 + variances)
        return DensityRows(np.arange(count), tolerances[:, None].astype(np.float32))

    def coefficients_of(self, row: int, landmark: FloatArray, domain: FloatArray) -> FloatArray:
        """All coefficients (729,), in Table 5's order, of the density of a landmark (3,) in the map frame;
        ``domain`` (1,) is its tolerance r [m], ``row`` is not used.
        """
        return np.asarray(ray_coefficients(landmark[None].astype(np.float64), domain.astype(np.float64))[0])

    @classmethod
    def kept_coefficients(
        cls, coefficients: FloatArray, degree: int, landmark: FloatArray, domain: FloatArray
    ) -> FloatArray:
        """Empty: ray coefficients follow from the landmark and the tolerance.

        Raises:
            ValueError: the tolerance is not positive, or the given ones differ from those by over 1e-6 × the largest.
        """
        if domain[0] <= 0:
            raise ValueError("has a tolerance that is not positive")
        exact = ray_coefficients(landmark[None], domain)[0]
        if np.abs(coefficients - exact).max() > _AGREE * np.abs(exact).max():
            raise ValueError("has coefficients that contradict its landmark and tolerance")
        return coefficients[:0]

    @classmethod
    def from_rows(
        cls, degree: int, rows: DensityRows, landmarks: FloatArray, kept: Sequence[FloatArray]
    ) -> RayDensities:
        """The densities. Nothing is read from the arguments: landmarks determine the densities."""
        return cls()

    def arrays(self) -> dict[str, NDArray[Any]]:
        """No arrays: landmarks determine the densities."""
        return {}

    @classmethod
    def from_arrays(cls, arrays: Arrays, landmarks: FloatArray) -> RayDensities:
        """The densities; there is nothing to read."""
        return cls()

    def moved(self, similarity: Similarity) -> RayDensities:
        """These densities; they move with the landmarks."""
        return self

    @classmethod
    def fit(cls, sightings: Sightings, degree: int, progress: Callable[[float, str], None]) -> RayDensities:
        """Densities without data; there is nothing to fit."""
        return cls()


@dataclass(frozen=True, eq=False)
class LocalRayDensities:
    """The ``ray`` densities of all matches of some evidence."""

    evidence: Evidence

    @property
    def matches(self) -> IntArray:
        """Rows (M,) of all matches."""
        return np.arange(len(self.evidence))

    def at(self, T_map_camera: FloatArray, tolerance_px: float) -> Slopes:
        """ρ and its slopes at a pose (4, 4), d being eᵀ S⁻¹ e.

        e (2,) [m] is the offset of the landmark across the ray, S (2, 2) [m²] the landmark's covariance across the ray
        plus the squared tolerance at its depth.
        """
        evidence, R = self.evidence, T_map_camera[:3, :3]
        bearings = evidence.rays @ R.T
        along, aside = _along_and_aside(evidence.landmarks, bearings, T_map_camera[:3, 3])
        squared_px = (tolerance_px / evidence.focal_px * along) ** 2
        near = np.flatnonzero((along > 0) & (aside < squared_px + 3 * evidence.variances))  # whatever the axes are
        offsets = RayOffsets.between(evidence.landmarks[near], evidence.across[near], T_map_camera)
        whitened, roots = offsets.whitened(evidence.covariances[near], squared_px[near])
        values = 1 - (whitened**2).sum(axis=1)
        is_inside = values > 0
        density, inside = np.zeros(len(evidence)), near[is_inside]
        density[inside] = values[is_inside]
        roots = roots[is_inside]
        gradient = 2 * (whitened[is_inside][:, None] @ roots)[:, 0]
        return Slopes(density, inside, gradient, roots)


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
