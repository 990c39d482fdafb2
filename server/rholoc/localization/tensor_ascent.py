"""The ascent on ``tensor`` densities: maximize Σ_f log(ε_f + ρ_f), equations (1) and (2), by equation (4)'s gradients.

A fitted polynomial is off by a little everywhere, and the height of its bump more than the place of it: at a given
pose its peak over (u, v) is not quite 1. A pixel must be somewhere, so ρ counts from that peak:

    ρ_f = max(0, 1 − (max_{u,v} q_f − q_f) / t)

where q_f is the polynomial and t the fall that the tolerance allows. Both are equation (3)'s values and the gradients
are equation (4)'s, of first and mixed order. The landmark's position only tells how wide the tolerance is in metres,
and spares the features whose bump is far away.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rholoc.density.tensor import TARGET_RADIUS, Peaks, TensorDensities
from rholoc.geometry import FloatArray, IntArray
from rholoc.localization.ascent import Evidence, Optimum, moved, roll_prior, upright, upright_axes
from rholoc.localization.matches import Matches
from rholoc.localization.types import Dof

_ITERATIONS = 4
_REACH = 2.0  # in tolerances: how far off a feature may be to be listened to while one tolerance holds
_STEP_M, _STEP_RAD = 0.5, 0.3
_NEARLY_SETTLED, _SETTLED = 1e-4, 1e-5  # metres or radians: steps that end a tolerance, and the last one


@dataclass(frozen=True, eq=False)
class TensorIndex:
    """A map's tensor densities, found by feature.

    Attributes:
        densities: all T of them, sorted by feature.
        first: (F + 1,) feature f's are rows first[f] : first[f + 1].
    """

    densities: TensorDensities
    first: IntArray

    @classmethod
    def of(cls, densities: TensorDensities, count: int) -> TensorIndex:
        """The index of the densities of a map with ``count`` features."""
        return cls(densities, np.searchsorted(densities.features, np.arange(count + 1)))

    def choose(self, features: IntArray, T_map_camera: FloatArray) -> tuple[IntArray, IntArray]:
        """For which of ``features`` (M,) there is a density valid at a pose (4, 4), and its row: (K,) and (K,).

        Of several valid ones it is that whose direction is nearest to the heading.
        """
        position, heading = T_map_camera[:3, 3], T_map_camera[:3, 2]
        starts, ends = self.first[features], self.first[features + 1]
        best, row = np.full(len(features), -np.inf), np.full(len(features), -1)
        for step in range(int((ends - starts).max(initial=0))):
            has = np.flatnonzero(starts + step < ends)
            candidates = starts[has] + step
            fit = np.where(
                self.densities.valid_at(position, heading, candidates),
                self.densities.directions[candidates] @ heading,
                -np.inf,
            )
            better = fit > best[has]
            best[has[better]], row[has[better]] = fit[better], candidates[better]
        chosen = np.flatnonzero(row >= 0)
        return chosen, row[chosen]


@dataclass(frozen=True, eq=False)
class _Voices:
    """The matches that have a valid density.

    Attributes:
        matches: (K,) their rows among all M matches.
        densities: K densities.
        plane: (K, 2) their pixels on the plane z = 1.
        epsilon: (K,) ε.
        variances: (K,) m², of the landmarks.
        focal_px: of the camera.
    """

    matches: IntArray
    densities: TensorDensities
    plane: FloatArray
    epsilon: FloatArray
    variances: FloatArray
    focal_px: float

    @classmethod
    def of(
        cls, index: TensorIndex, matches: Matches, evidence: Evidence, T_map_camera: FloatArray, reach_px: float
    ) -> _Voices:
        """The matches that may speak near a pose (4, 4): those whose landmark is within ``reach_px`` of the pixel."""
        points = (evidence.landmarks - T_map_camera[:3, 3]) @ T_map_camera[:3, :3]
        along = np.einsum("mi,mi->m", points, evidence.rays)
        aside = np.einsum("mi,mi->m", points, points) - along**2
        variances = np.trace(evidence.covariances, axis1=1, axis2=2) / 3
        deviation = np.maximum(reach_px / evidence.focal_px * along, 0) ** 2 + 4 * variances
        near = np.flatnonzero((along > 0) & (evidence.rays[:, 2] > 0) & (aside < deviation))
        chosen, rows = index.choose(matches.landmarks[near], T_map_camera)
        near = near[chosen]
        rays = evidence.rays[near]
        return cls(
            near,
            index.densities.take(rows),
            rays[:, :2] / rays[:, 2:],
            evidence.epsilon[near],
            variances[near],
            evidence.focal_px,
        )

    def at(self, T_map_camera: FloatArray, tolerance_px: float) -> tuple[Peaks, FloatArray, FloatArray]:
        """The peaks at a pose (4, 4), the falls t (K,) that the tolerance allows, and ρ (K,)."""
        peaks = self.densities.at(self.plane, T_map_camera)
        distance = np.linalg.norm(self.densities.landmarks - T_map_camera[:3, 3], axis=1)
        allowed_m2 = (tolerance_px / self.focal_px * distance) ** 2 + self.variances
        fall = allowed_m2 / (TARGET_RADIUS * self.densities.distances) ** 2
        return peaks, fall, np.where(peaks.peaked, np.maximum(1 - peaks.drop / fall, 0), 0)


def ascend_tensors(
    index: TensorIndex,
    matches: Matches,
    evidence: Evidence,
    T_map_camera: FloatArray,
    tolerances_px: tuple[float, ...],
    dof: Dof,
) -> Optimum:
    """Ascend from a pose (4, 4), the tolerance narrowing step by step; the densities are chosen anew at each.

    A step divides the exact gradient by the curvature that the polynomials' own peaks have (Gauss–Newton).
    """
    T = upright(T_map_camera) if dof is Dof.UPRIGHT else T_map_camera
    for stage, tolerance_px in enumerate(tolerances_px, start=1):
        settled = _SETTLED if stage == len(tolerances_px) else _NEARLY_SETTLED
        voices = _Voices.of(index, matches, evidence, T, _REACH * tolerance_px)
        for _ in range(_ITERATIONS):
            step = _step(voices, T, tolerance_px, dof)
            T = moved(T, step, dof)
            if np.abs(step).max() < settled:
                break
    voices = _Voices.of(index, matches, evidence, T, _REACH * tolerances_px[-1])
    density = np.zeros(len(matches))
    density[voices.matches] = voices.at(T, tolerances_px[-1])[2]
    return Optimum(T, float(np.log1p(density / evidence.epsilon).sum()), density)


def tensor_gradient(
    index: TensorIndex, matches: Matches, evidence: Evidence, T_map_camera: FloatArray, tolerance_px: float
) -> tuple[float, FloatArray]:
    """Σ log(ε + ρ) and its gradient (6,) by a motion (position, rotation) at a pose, the tolerances held."""
    voices = _Voices.of(index, matches, evidence, T_map_camera, _REACH * tolerance_px)
    peaks, fall, density = voices.at(T_map_camera, tolerance_px)
    weight = _weights(voices, fall, density)
    return float(np.log(voices.epsilon + density).sum()), np.asarray(-weight @ peaks.drop_gradient)


def _weights(voices: _Voices, fall: FloatArray, density: FloatArray) -> FloatArray:
    """∂ Σ log(ε + ρ) / ∂ρ · 1/t (K,): how much each fall from a peak matters."""
    return np.asarray(np.where(density > 0, 1 / ((voices.epsilon + density) * fall), 0))


def _step(voices: _Voices, T: FloatArray, tolerance_px: float, dof: Dof) -> FloatArray:
    """The motion (6,), or (5,) for an upright camera, to take next."""
    axes = np.eye(6)
    if dof is Dof.UPRIGHT:
        axes = np.zeros((6, 5))
        axes[:3, :3], axes[3:, 3:] = np.eye(3), upright_axes(T)
    peaks, fall, density = voices.at(T, tolerance_px)
    weight = _weights(voices, fall, density)
    pull, stiffness = roll_prior(T, dof) if dof is Dof.AUTO else (np.zeros(6), np.zeros((6, 6)))
    slope = (pull - weight @ peaks.drop_gradient) @ axes
    J = peaks.offset_jacobian @ axes
    size = J.shape[2]
    weighted = (2 * weight[:, None, None]) * (peaks.fall @ J)
    curvature = J.reshape(-1, size).T @ weighted.reshape(-1, size) + axes.T @ stiffness @ axes
    step = np.linalg.solve(curvature + (1e-6 * np.trace(curvature) / size + 1e-12) * np.eye(size), slope)
    length = max(float(np.linalg.norm(step[:3])) / _STEP_M, float(np.linalg.norm(step[3:])) / _STEP_RAD, 1.0)
    return np.asarray(step / length)
