"""The ascent: maximize Σ_f log(ε_f + ρ_f) over the pose, equations (1) and (2) made robust.

ρ_f is the ``ray`` density, 1 − d²/r² within the tolerance r, and ε_f the odds that the match is false. For rays in
the camera frame the transverse offset of landmark m from the ray is e = Eᵀ R_camera_map (m − x), E (3, 2) being a
basis across the ray, so that d² = |e|² and Gauss–Newton applies: each match weighs 1 / ((ε + ρ) r²) while ρ > 0.

That draws hardest at the density's edge, which is right on the way: a match there may yet come in. At the end it costs
accuracy: real errors have long tails, and the tail would decide. The last steps therefore climb Σ log(ε_f + ρ_f⁴): ρ⁴
is a polynomial too, its peak is where ρ's is, and its edge is soft.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from rholoc.geometry import FloatArray, IntArray, Pose, pose_matrix, rotation_from_heading
from rholoc.localization.types import Dof

_RAYLEIGH_MEDIAN = 1.177  # of the length of a two-dimensional offset, in standard deviations of one component
_SYSTEMATIC = 3.0  # measured on real recordings: errors against those that independent detections would make
_ROLL_SIGMA_RAD = np.deg2rad(1.5)  # of a camera that is held upright
_FALSE_DENSITY = 0.1  # how dense false matches lie near the truth, against true ones
_NEARLY_SETTLED, _SETTLED = 1e-3, 1e-5  # metres or radians: steps that end a tolerance, and the last one
_SHARP = 4  # the power of ρ in the last steps
_FOCAL_RANGE = (0.25, 4.0)  # of the focal length that an ascent starts with
_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Evidence:
    """What M matches say: rays of the camera, landmarks of the map.

    Attributes:
        rays: (M, 3) unit rays in the camera frame.
        across: (M, 3, 2) an orthonormal basis across each ray, camera frame.
        landmarks: (M, 3) metres, map frame.
        covariances: (M, 3, 3) m², map frame.
        epsilon: (M,) the odds that the match is false, in units of the density's peak.
        focal_px: the focal length, to turn pixels into angles.
    """

    rays: FloatArray
    across: FloatArray
    landmarks: FloatArray
    covariances: FloatArray
    epsilon: FloatArray
    focal_px: float

    @classmethod
    def of(
        cls, rays: FloatArray, landmarks: FloatArray, covariances: FloatArray, chances: FloatArray, focal_px: float
    ) -> Evidence:
        """From rays (M, 3), landmarks (M, 3), covariances (M, 3, 3) and the chances (M,) that matches are true."""
        epsilon = _FALSE_DENSITY * (1 - chances) / chances
        return cls(rays, _across(rays), landmarks, covariances, epsilon, focal_px)

    def refocused(self, scale: float) -> Evidence:
        """The same detections through a lens of ``scale`` times the focal length."""
        rays = self.rays * (1.0, 1.0, scale)
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        return replace(self, rays=rays, across=_across(rays), focal_px=self.focal_px * scale)

    def take(self, index: IntArray) -> Evidence:
        """The evidence of some of the matches."""
        return Evidence(
            self.rays[index],
            self.across[index],
            self.landmarks[index],
            self.covariances[index],
            self.epsilon[index],
            self.focal_px,
        )


def _across(rays: FloatArray) -> FloatArray:
    """(M, 3, 2) an orthonormal basis across each unit ray (M, 3)."""
    helper = np.where(np.abs(rays[:, :1]) < 0.7, [[1.0, 0, 0]], [[0, 1.0, 0]])
    first = _cross(rays, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, _cross(rays, first)], axis=2)


@dataclass(frozen=True, eq=False)
class Optimum:
    """Where an ascent ended.

    Attributes:
        T_map_camera: (4, 4).
        value: Σ log((ε + ρ) / ε), nats: how much likelier the matches are than by chance.
        density: (M,) ρ of each match there.
    """

    T_map_camera: FloatArray
    value: float
    density: FloatArray


def densities(evidence: Evidence, T_map_camera: FloatArray, tolerance_px: float) -> FloatArray:
    """ρ (H, M) of all matches at poses (H, 4, 4)."""
    R, x = T_map_camera[:, :3, :3], T_map_camera[:, :3, 3]
    # landmarks in every camera: (H, M, 3)
    points = evidence.landmarks @ R - np.einsum("hi,hij->hj", x, R)[:, None]
    along = np.einsum("hmi,mi->hm", points, evidence.rays)
    squared = np.einsum("hmi,hmi->hm", points, points) - along**2
    variance = _mean_variance(evidence.covariances)
    tolerance = (tolerance_px / evidence.focal_px * along) ** 2 + variance
    return np.asarray(np.where(along > 0, np.maximum(1 - squared / tolerance, 0), 0))


def gains(evidence: Evidence, T_map_camera: FloatArray, tolerance_px: float) -> FloatArray:
    """Σ log((ε + ρ) / ε) (H,) at poses (H, 4, 4), in nats."""
    density = densities(evidence, T_map_camera, tolerance_px)
    return np.asarray(np.log1p(density / evidence.epsilon).sum(axis=1))


def ascend(
    evidence: Evidence,
    T_map_camera: FloatArray,
    tolerances_px: tuple[float, ...],
    dof: Dof,
    iterations: int = 3,
    power: int = 1,
) -> Optimum:
    """Gauss–Newton from a pose (4, 4), the tolerance narrowing step by step; of Σ log(ε + ρ^power).

    A camera held upright still rolls by a degree or so, and a map's z axis is not plumb to a tenth. With
    ``Dof.UPRIGHT`` roll is therefore not forbidden but improbable: a nuisance with a prior about zero, so that the
    position does not pay for it. The optimum keeps it; the answer's pose leaves it out. See :func:`roll_prior`.
    """
    T = upright(T_map_camera) if dof is Dof.UPRIGHT else T_map_camera
    for tolerance_px in tolerances_px:
        for _ in range(iterations):
            step = _newton_step(evidence, T, tolerance_px, dof, power)
            if step is None:
                break
            T = moved(T, step, Dof.FREE)
            if np.abs(step).max() < (_SETTLED if tolerance_px == tolerances_px[-1] else _NEARLY_SETTLED):
                break
    return _optimum_at(evidence, T, tolerances_px[-1])


def ascend_with_focal(
    evidence: Evidence, T_map_camera: FloatArray, tolerances_px: tuple[float, ...], dof: Dof, iterations: int = 6
) -> tuple[Optimum, float, float]:
    """Gauss–Newton from a pose (4, 4) over the pose and the focal length together.

    Returns:
        The optimum; the focal length there, as a multiple of the evidence's; and one sigma of its logarithm.
    """
    T, scale = T_map_camera, 1.0
    curvature: FloatArray = np.eye(7)
    for tolerance_px in tolerances_px:
        for _ in range(iterations):
            focused = evidence.refocused(scale)
            slope, curvature = _focal_equations(focused, T, tolerance_px, dof)
            step = _bounded(slope, curvature)
            if step is None:
                break
            T = moved(T, step[:6], Dof.FREE)
            scale = float(np.clip(scale * np.exp(np.clip(step[6], -0.1, 0.1)), *_FOCAL_RANGE))
            if np.abs(step).max() < _NEARLY_SETTLED:
                break
    optimum = _optimum_at(evidence.refocused(scale), T, tolerances_px[-1])
    sigma = float(np.sqrt(np.linalg.inv(curvature + 1e-9 * np.eye(7))[6, 6]))
    return optimum, scale, sigma


def _focal_equations(evidence: Evidence, T: FloatArray, tolerance_px: float, dof: Dof) -> tuple[FloatArray, FloatArray]:
    """As :func:`_normal_equations`, with the focal length's logarithm for a seventh parameter: (7,) and (7, 7)."""
    residual, J, tolerance, density = _residuals(evidence, T, tolerance_px)
    inside = np.flatnonzero(density > 0)
    weight = _weights(evidence.epsilon[inside], density[inside], tolerance[inside], 1)
    J = np.concatenate([J[inside], _by_focal(evidence.take(inside), T)[:, :, None]], axis=2)
    weighted = J * weight[:, None, None]
    slope = -np.einsum("mrp,mr->p", weighted, residual[inside])
    curvature = np.einsum("mrp,mrq->pq", weighted, J)
    pull, stiffness = roll_prior(T, dof)
    slope[:6] += pull
    curvature[:6, :6] += stiffness
    return slope, curvature


def _by_focal(evidence: Evidence, T: FloatArray) -> FloatArray:
    """∂e/∂ln f (M, 2): a longer focal length draws rays to the axis, ∂b/∂ln f = −(bx, by, 0) across the ray."""
    along = np.einsum("mi,mi->m", (evidence.landmarks - T[:3, 3]) @ T[:3, :3], evidence.rays)
    drawn = np.einsum("mir,mi->mr", evidence.across, evidence.rays * (1.0, 1.0, 0.0))
    return np.asarray(along[:, None] * drawn)


def sharpen(evidence: Evidence, optimum: Optimum, among: IntArray, tolerance_px: float, dof: Dof) -> Optimum:
    """The last steps from an optimum, by the matches (K,) ``among`` alone, of which the nearest decide."""
    some = evidence.take(among)
    T = ascend(some, optimum.T_map_camera, (tolerance_px,), dof, iterations=5, power=_SHARP).T_map_camera
    return _optimum_at(evidence, T, tolerance_px)


def _optimum_at(evidence: Evidence, T_map_camera: FloatArray, tolerance_px: float) -> Optimum:
    density = densities(evidence, T_map_camera[None], tolerance_px)[0]
    return Optimum(T_map_camera, float(np.log1p(density / evidence.epsilon).sum()), density)


def covariance_at(evidence: Evidence, optimum: Optimum, tolerance_px: float, focal_free: bool = False) -> FloatArray:
    """The covariance (6, 6) of an optimum, from its curvature over the matches that agree with it.

    Position in metres and rotation in radians (a small rotation in the map frame from the left). The noise of a
    detection is read off the matches' own residuals; the landmark's covariance adds to it. ``_SYSTEMATIC`` is what no
    single frame shows: neighbouring landmarks rest on the same views and err together. ``focal_free``: the focal length
    was estimated along with the pose, which makes both less certain.
    """
    residual, J, _, _ = _residuals(evidence, optimum.T_map_camera, tolerance_px)
    agreeing = np.flatnonzero(optimum.density > 0)
    along = np.linalg.norm(evidence.landmarks[agreeing] - optimum.T_map_camera[:3, 3], axis=1)
    offset_px = evidence.focal_px * np.linalg.norm(residual[agreeing], axis=1) / along
    noise_px = max(float(np.median(offset_px)) / _RAYLEIGH_MEDIAN, 0.3) if len(agreeing) else tolerance_px
    variance = (noise_px * along / evidence.focal_px) ** 2 + _mean_variance(evidence.covariances[agreeing])
    J = J[agreeing]
    if focal_free:
        J = np.concatenate([J, _by_focal(evidence.take(agreeing), optimum.T_map_camera)[:, :, None]], axis=2)
    weighted = J / variance[:, None, None]
    information = np.einsum("mrp,mrq->pq", weighted, J)
    covariance = _SYSTEMATIC**2 * np.linalg.inv(information + 1e-6 * np.eye(len(information)))
    return np.asarray(covariance[:6, :6])


def upright(T_map_camera: FloatArray) -> FloatArray:
    """The pose (4, 4) with its roll taken away."""
    return pose_matrix(rotation_from_heading(T_map_camera[:3, 2]), T_map_camera[:3, 3])


def gradient(evidence: Evidence, T_map_camera: FloatArray, tolerance_px: float, power: int = 1) -> FloatArray:
    """∂ Σ log(ε + ρ^power) / ∂(position, rotation) (6,), the tolerances held: equation (4) through (2)."""
    residual, J, tolerance, density = _residuals(evidence, T_map_camera, tolerance_px)
    inside = np.flatnonzero(density > 0)
    weight = _weights(evidence.epsilon[inside], density[inside], tolerance[inside], power)
    return np.asarray(-np.einsum("m,mr,mrp->p", weight, residual[inside], J[inside]))


def _weights(epsilon: FloatArray, density: FloatArray, tolerance: FloatArray, power: int) -> FloatArray:
    """How strongly each match (M,) draws: −2 ∂ log(ε + ρ^power) / ∂d², for densities above 0."""
    return np.asarray(2 * power * density ** (power - 1) / ((epsilon + density**power) * tolerance))


def _newton_step(evidence: Evidence, T: FloatArray, tolerance_px: float, dof: Dof, power: int) -> FloatArray | None:
    return _bounded(*_normal_equations(evidence, T, tolerance_px, dof, power))


def _bounded(gradient_: FloatArray, hessian: FloatArray) -> FloatArray | None:
    """The Gauss–Newton step, no longer than half a metre or 0.3 rad; None where there is none."""
    damping = 1e-6 * np.trace(hessian) / len(hessian) + 1e-12
    try:
        step = np.linalg.solve(hessian + damping * np.eye(len(hessian)), gradient_)
    except np.linalg.LinAlgError:
        return None
    length = max(float(np.linalg.norm(step[:3])) / 0.5, float(np.linalg.norm(step[3:6])) / 0.3, 1.0)
    return np.asarray(step / length) if np.isfinite(step).all() else None


def _normal_equations(
    evidence: Evidence, T: FloatArray, tolerance_px: float, dof: Dof, power: int
) -> tuple[FloatArray, FloatArray]:
    residual, J, tolerance, density = _residuals(evidence, T, tolerance_px)
    inside = np.flatnonzero(density > 0)
    weight = _weights(evidence.epsilon[inside], density[inside], tolerance[inside], power)
    residual, J = residual[inside], J[inside]
    weighted = J * weight[:, None, None]
    gradient_, hessian = -np.einsum("mrp,mr->p", weighted, residual), np.einsum("mrp,mrq->pq", weighted, J)
    pull, stiffness = roll_prior(T, dof)
    return gradient_ + pull, hessian + stiffness


def roll_prior(T_map_camera: FloatArray, dof: Dof) -> tuple[FloatArray, FloatArray]:
    """The gradient (6,) and the curvature (6, 6) of the prior on a camera's roll, by a motion (position, rotation).

    ``UPRIGHT``: a Gaussian, which holds a camera upright whatever its matches say. ``AUTO``: Cauchy's distribution of
    the same width, which steadies a camera that is nearly upright and lets one go that clearly is not. ``FREE``: none.
    """
    pull, stiffness = np.zeros(6), np.zeros((6, 6))
    if dof is not Dof.FREE:
        heading, roll = T_map_camera[:3, 2], Pose(T_map_camera).roll
        scale = _ROLL_SIGMA_RAD**2 + (roll**2 if dof is Dof.AUTO else 0.0)
        pull[3:] = -roll / scale * heading
        stiffness[3:, 3:] = np.outer(heading, heading) / scale
    return pull, stiffness


def _residuals(
    evidence: Evidence, T: FloatArray, tolerance_px: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Offsets e (M, 2), their Jacobian (M, 2, 6), squared tolerances (M,) and densities (M,)."""
    R, x = T[:3, :3], T[:3, 3]
    offset = evidence.landmarks - x
    points = offset @ R
    along = np.einsum("mi,mi->m", points, evidence.rays)
    residual = np.einsum("mir,mi->mr", evidence.across, points)
    across_map = R @ evidence.across  # (M, 3, 2)
    # ∂e/∂x = −(R E)ᵀ; a rotation δ from the left turns m − x by −δ: ∂e/∂δ = (R E)ᵀ [m − x]×
    J = np.empty((len(offset), 2, 6))
    J[:, :, :3] = -across_map.transpose(0, 2, 1)
    J[:, :, 3:] = _cross(across_map.transpose(0, 2, 1), offset[:, None])
    variance = _mean_variance(evidence.covariances)
    tolerance = (tolerance_px / evidence.focal_px * along) ** 2 + variance
    density = np.where(along > 0, np.maximum(1 - (residual**2).sum(axis=1) / tolerance, 0), 0)
    return residual, J, tolerance, density


def upright_axes(T: FloatArray) -> FloatArray:
    """(3, 2) the axes an upright camera turns about: the vertical and its own x axis."""
    return np.column_stack([_UP, T[:3, 0]])


def moved(T: FloatArray, step: FloatArray, dof: Dof) -> FloatArray:
    """The pose (4, 4) after a ``step``: (6,), or (5,) with a rotation about the upright axes."""
    rotation = upright_axes(T) @ step[3:] if dof is Dof.UPRIGHT else step[3:]
    R = Rotation.from_rotvec(rotation).as_matrix() @ T[:3, :3]
    moved = pose_matrix(R, T[:3, 3] + step[:3])
    return upright(moved) if dof is Dof.UPRIGHT else moved


def _mean_variance(covariances: FloatArray) -> FloatArray:
    """The variance (M,) along an axis, on the mean over all axes, of covariances (M, 3, 3)."""
    return np.asarray(np.trace(covariances, axis1=1, axis2=2) / 3)


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """a × b of (..., 3); several times faster than NumPy's own on the few hundred vectors of a step."""
    ax, ay, az, bx, by, bz = a[..., 0], a[..., 1], a[..., 2], b[..., 0], b[..., 1], b[..., 2]
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    out[..., 0], out[..., 1], out[..., 2] = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    return out
