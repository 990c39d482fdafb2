"""The ascent: maximize Σ_f log(ε_f + ρ_f) over the pose, equations (1) and (2) made robust.

ρ_f = max(0, 1 − d_f) is the density of :mod:`rholoc.density`, in whatever form the map has, and ε_f the odds that the
match is false. d_f is a square in the form's own terms, so that Gauss–Newton applies: each match weighs 1 / (ε + ρ)
while ρ > 0.

Matches at the density's edge thus have the largest weight. That helps on the way, because they may become inliers. At
the optimum it costs accuracy, because real errors have long tails. For densities with exact peaks, the last steps
therefore maximize 1 / (1 + d_f) instead of 1 − d_f, with the tolerance of a detection: a density without an edge
(:func:`refined`). The landmark's covariance then counts as well as the detection's.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from rholoc.density import Densities, Evidence, LocalDensities, RayDensities
from rholoc.density.ray import RayOffsets, ray_densities, squared_tolerances
from rholoc.geometry import FloatArray, Pose, pose_matrix, rotation_from_heading
from rholoc.localization.types import Dof

_RAYLEIGH_MEDIAN = 1.177  # of the length of a two-dimensional offset, in standard deviations of one component
_MIN_NOISE_PX = 0.3  # of a detection
SYSTEMATIC = 3.0  # measured on real recordings: errors against those that independent detections would make
_ROLL_SIGMA_RAD = np.deg2rad(1.5)  # of a camera that is held upright
_NEARLY_SETTLED, _SETTLED = 1e-3, 1e-5  # metres or radians: steps that end a tolerance, and the last one
_ROUGHLY_SETTLED = 1e-2  # the same where the focal length is free, which makes steps long, but for the last tolerance
_DETECTED_PX = 1.0  # how exactly features are detected, for the last steps
_TAIL = 1.5  # the power of 1 / (1 + d²) that is a distribution over two dimensions, Cauchy's
_FOCAL_RANGE = (0.25, 4.0)  # of the focal length that an ascent starts with


@dataclass(frozen=True, eq=False)
class Optimum:
    """End of an ascent.

    Attributes:
        T_map_camera: (4, 4).
        value: Σ log((ε + ρ) / ε) [nats]: log-likelihood ratio of the matches against chance.
        density: (M,) ρ of each match at the optimum.
    """

    T_map_camera: FloatArray
    value: float
    density: FloatArray


@dataclass(frozen=True, eq=False)
class Step:
    """A pose (4, 4) along the ascent, and the pixel tolerance under which it was reached."""

    T_map_camera: FloatArray
    tolerance_px: float


def gains(evidence: Evidence, T_map_camera: FloatArray, tolerance_px: float) -> FloatArray:
    """Log-likelihood ratio Σ log((ε + ρ) / ε) (H,) [nats] of all matches at each of the poses (H, 4, 4), with ``ray``
    densities.
    """
    density = ray_densities(evidence, T_map_camera, tolerance_px)
    return np.asarray(np.log1p(density / evidence.epsilon).sum(axis=1))


def ascend(
    densities: Densities,
    evidence: Evidence,
    T_map_camera: FloatArray,
    tolerances_px: tuple[float, ...],
    dof: Dof,
    iterations: int = 3,
) -> Optimum:
    """Maximize Σ log(ε + ρ) by Gauss–Newton from a pose (4, 4), with a decreasing sequence of tolerances [px], each for
    at most ``iterations`` steps. Returns the end, rated at the last tolerance.

    Densities that are valid only locally are chosen anew for each tolerance.

    A camera held upright still rolls by a degree or so, and a map's z axis is plumb only to a tenth of a degree. With
    ``Dof.UPRIGHT`` roll is therefore a nuisance parameter with a zero-mean prior, so that position does not absorb it.
    The optimum keeps the roll; the answer's pose drops it. See :func:`roll_prior`.
    """
    T = end_of_climb(densities, evidence, T_map_camera, tolerances_px, dof, iterations)
    return optimum_at(densities, evidence, T, tolerances_px[-1])


def end_of_climb(
    densities: Densities,
    evidence: Evidence,
    T_map_camera: FloatArray,
    tolerances_px: tuple[float, ...],
    dof: Dof,
    iterations: int = 3,
) -> FloatArray:
    """Final pose (4, 4) of :func:`ascend`, without its likelihood and densities."""
    T = T_map_camera
    for step in climb(densities, evidence, T_map_camera, tolerances_px, dof, iterations):
        T = step.T_map_camera
    return T


def climb(
    densities: Densities,
    evidence: Evidence,
    T_map_camera: FloatArray,
    tolerances_px: tuple[float, ...],
    dof: Dof,
    iterations: int = 3,
) -> Iterator[Step]:
    """Iterate over the poses of :func:`ascend`, from the start on; ``Dof.UPRIGHT`` removes the start's roll."""
    T = upright(T_map_camera) if dof is Dof.UPRIGHT else T_map_camera
    yield Step(T, tolerances_px[0])
    for tolerance_px in tolerances_px:
        local = densities.near(evidence, T, tolerance_px)
        for _ in range(iterations):
            step = _bounded(*normal_equations(local, evidence.epsilon, T, tolerance_px, dof))
            if step is None:
                break
            T = moved(T, step)
            yield Step(T, tolerance_px)
            if np.abs(step).max() < (_SETTLED if tolerance_px == tolerances_px[-1] else _NEARLY_SETTLED):
                break


def ascend_with_focal(
    evidence: Evidence, T_map_camera: FloatArray, tolerances_px: tuple[float, ...], dof: Dof, iterations: int = 6
) -> tuple[Optimum, float, float]:
    """Gauss–Newton over pose and focal length together, from a pose (4, 4), with ``ray`` densities and decreasing
    tolerances [px].

    Returns:
        The optimum; its focal length as a multiple of the evidence's, ¼ to 4; the standard deviation of that factor's
        logarithm by the curvature.
    """
    T, scale = T_map_camera, 1.0
    for tolerance_px in tolerances_px:
        for _ in range(iterations):
            focused = evidence.refocused(scale)
            slope, curvature = _focal_equations(focused, T, tolerance_px, dof)
            step = _bounded(slope, curvature)
            if step is None:
                break
            T = moved(T, step[:6])
            scale = float(np.clip(scale * np.exp(np.clip(step[6], -0.1, 0.1)), *_FOCAL_RANGE))
            if np.abs(step).max() < (_NEARLY_SETTLED if tolerance_px == tolerances_px[-1] else _ROUGHLY_SETTLED):
                break
    optimum = optimum_at(RayDensities(), evidence.refocused(scale), T, tolerances_px[-1])
    return optimum, scale, focal_sigma(curvature)


def freed_focal(evidence: Evidence, T_map_camera: FloatArray, tolerance_px: float, dof: Dof) -> tuple[float, float]:
    """Effect of freeing the focal length at an optimum: pose displacement [m] and gain in log-likelihood [nats].

    Compares one Gauss–Newton step with the focal length free to one without (Rao's score test). Cheap, and reliable if
    it reports little change.
    """
    slope, curvature = _focal_equations(evidence, T_map_camera, tolerance_px, dof)
    curvature = curvature + 1e-9 * np.eye(7)
    free, held = np.linalg.solve(curvature, slope), np.linalg.solve(curvature[:6, :6], slope[:6])
    return math.hypot(*(free[:3] - held[:3])), float(slope @ free - slope[:6] @ held) / 2


def _focal_equations(evidence: Evidence, T: FloatArray, tolerance_px: float, dof: Dof) -> tuple[FloatArray, FloatArray]:
    """Gradient (7,) and Gauss–Newton curvature (7, 7) as of :func:`normal_equations`, with ln(focal length) as seventh
    parameter.
    """
    offsets, allowed = RayOffsets.of(evidence, T), squared_tolerances(evidence, T, tolerance_px)
    along = (evidence.landmarks - T[:3, 3]) @ T[:3, :3]  # of the camera frame
    density = np.maximum(1 - (offsets.offset**2).sum(axis=1) / allowed, 0) * (_dot(along, evidence.rays) > 0)
    J = np.concatenate([offsets.jacobian, _by_focal(evidence, T)[:, :, None]], axis=2).reshape(-1, 7)
    weight = np.where(density > 0, 2 / (evidence.epsilon + density) / allowed, 0.0)
    weighted = J * np.repeat(weight, 2)[:, None]
    slope, curvature = -offsets.offset.ravel() @ weighted, weighted.T @ J
    pull, stiffness = roll_prior(T, dof)
    slope[:6] += pull
    curvature[:6, :6] += stiffness
    return slope, curvature


def _by_focal(evidence: Evidence, T: FloatArray) -> FloatArray:
    """∂e/∂ln f (M, 2): a longer focal length draws rays to the axis, ∂b/∂ln f = −(bx, by, 0) across the ray."""
    along = _dot((evidence.landmarks - T[:3, 3]) @ T[:3, :3], evidence.rays)
    drawn = np.einsum("mir,mi->mr", evidence.across, evidence.rays * (1.0, 1.0, 0.0))
    return np.asarray(along[:, None] * drawn)


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """Inner products (M,) of vectors (M, 3)."""
    return np.asarray(np.einsum("mi,mi->m", a, b))


def refined(evidence: Evidence, T_map_camera: FloatArray, dof: Dof, iterations: int = 10) -> FloatArray:
    """Last steps from a pose (4, 4): maximize Σ c log(1 / (1 + eᵀ S⁻¹ e))^1.5 over the matches by Gauss–Newton.

    c is the chance that a match is true, e (2,) the landmark's offset across the ray, and S (2, 2) the variance of a
    detection and the landmark's covariance across the ray: Cauchy's distribution in two dimensions.
    """
    T = T_map_camera
    for _ in range(iterations):
        step = _bounded(*refinement_equations(evidence, T, dof))
        if step is None:
            break
        T = moved(T, step)
        if np.abs(step).max() < _SETTLED:
            break
    return T


def refinement_equations(evidence: Evidence, T: FloatArray, dof: Dof) -> tuple[FloatArray, FloatArray]:
    """Gradient (6,) and Gauss–Newton curvature (6, 6) at pose T (4, 4) of what :func:`refined` maximizes plus the log
    prior on roll, at fixed S. Landmarks behind the camera are left out.
    """
    along = _dot((evidence.landmarks - T[:3, 3]) @ T[:3, :3], evidence.rays)
    some = evidence.take(np.flatnonzero(along > 0))
    variance = (_DETECTED_PX / evidence.focal_px * along[along > 0]) ** 2
    white, roots = RayOffsets.of(some, T).whitened(some.covariances, variance)
    weight = 2 * _TAIL * some.chances / (1 + (white**2).sum(axis=1))
    roots = roots.reshape(-1, 6)
    weighted = roots * np.repeat(weight, 2)[:, None]
    pull, stiffness = roll_prior(T, dof)
    return pull - white.ravel() @ weighted, weighted.T @ roots + stiffness


def optimum_at(densities: Densities, evidence: Evidence, T_map_camera: FloatArray, tolerance_px: float) -> Optimum:
    """A pose (4, 4) rated as the end of an ascent: likelihood and densities of the M matches at a tolerance [px]."""
    local = densities.near(evidence, T_map_camera, tolerance_px)
    density = np.zeros(len(evidence))
    density[local.matches] = local.at(T_map_camera, tolerance_px).density
    return Optimum(T_map_camera, float(np.log1p(density / evidence.epsilon).sum()), density)


def covariance_at(evidence: Evidence, optimum: Optimum, focal_free: bool = False) -> FloatArray:
    """Covariance (6, 6) of the pose at an optimum, position [m], rotation [rad]: inverse of :func:`information_at`."""
    information = information_at(evidence, optimum, focal_free)
    return np.asarray(np.linalg.inv(information + 1e-6 * np.eye(len(information)))[:6, :6])


def information_at(evidence: Evidence, optimum: Optimum, focal_free: bool = False) -> FloatArray:
    """Information (6, 6) at an optimum, or (7, 7) with ln(focal length) last if ``focal_free``; zeros if no match
    agrees.

    Position in metres, rotation in radians (a small rotation in the map frame from the left). Detection noise is
    estimated from the matches' residuals, at least 0.3 px, and the landmark covariance is added. ``SYSTEMATIC`` (a
    factor 3 on the standard deviations) accounts for the errors that neighbouring landmarks share, because they were
    triangulated from the same views. An estimated focal length (``focal_free``) lowers the information on the pose.
    """
    agreeing = evidence.take(np.flatnonzero(optimum.density > 0))
    if len(agreeing) == 0:
        return np.zeros((6 + focal_free, 6 + focal_free))
    offsets = RayOffsets.of(agreeing, optimum.T_map_camera)
    along = np.linalg.norm(agreeing.landmarks - optimum.T_map_camera[:3, 3], axis=1)
    offset_px = evidence.focal_px * np.linalg.norm(offsets.offset, axis=1) / along
    noise_px = max(float(np.median(offset_px)) / _RAYLEIGH_MEDIAN, _MIN_NOISE_PX)
    variance = (noise_px * along / evidence.focal_px) ** 2 + agreeing.variances
    J = offsets.jacobian
    if focal_free:
        J = np.concatenate([J, _by_focal(agreeing, optimum.T_map_camera)[:, :, None]], axis=2)
    weighted = J / (variance * SYSTEMATIC**2)[:, None, None]
    return np.asarray(np.einsum("mrp,mrq->pq", weighted, J))


def focal_sigma(information: FloatArray) -> float:
    """Standard deviation of ln(focal length) from an information matrix (7, 7) with ln(focal length) last."""
    return float(np.sqrt(np.linalg.inv(information + 1e-9 * np.eye(7))[6, 6]))


def upright(T_map_camera: FloatArray) -> FloatArray:
    """The pose (4, 4) with the same position and optical axis, and its x axis horizontal (roll 0)."""
    return pose_matrix(rotation_from_heading(T_map_camera[:3, 2]), T_map_camera[:3, 3])


def _bounded(gradient_: FloatArray, hessian: FloatArray) -> FloatArray | None:
    """Gauss–Newton step of at most half a metre and 0.3 rad, shortened as a whole. None if the curvature is singular or
    the step not finite. Parameters after the sixth are not bounded.
    """
    damping = 1e-6 * np.trace(hessian) / len(hessian) + 1e-12
    try:
        step = np.linalg.solve(hessian + damping * np.eye(len(hessian)), gradient_)
    except np.linalg.LinAlgError:
        return None
    move_m, turn_rad = math.hypot(*step[:3]), math.hypot(*step[3:6])
    length = max(move_m / 0.5, turn_rad / 0.3, 1.0)
    return np.asarray(step / length) if math.isfinite(length) else None


def normal_equations(
    local: LocalDensities, epsilon: FloatArray, T: FloatArray, tolerance_px: float, dof: Dof
) -> tuple[FloatArray, FloatArray]:
    """Gradient (6,) and Gauss–Newton curvature (6, 6) of Σ log(ε + ρ) plus the log prior on roll, at pose T (4, 4).

    ``epsilon`` (M,) are the odds of all matches; the first three parameters are the position [m], then a rotation [rad]
    from the left.
    """
    slopes = local.at(T, tolerance_px)
    inside = slopes.inside
    weight = 1 / (epsilon[local.matches[inside]] + slopes.density[inside])
    roots = slopes.roots.reshape(-1, 6)
    curvature = (np.repeat(2 * weight, 2)[:, None] * roots).T @ roots
    pull, stiffness = roll_prior(T, dof)
    return pull - weight @ slopes.gradient, curvature + stiffness


def roll_prior(T_map_camera: FloatArray, dof: Dof) -> tuple[FloatArray, FloatArray]:
    """Gradient (6,) and curvature (6, 6) of the log prior on the camera's roll, of width 1.5°.

    ``UPRIGHT``: a Gaussian, which keeps the camera upright against any evidence. ``AUTO``: a Cauchy distribution of the
    same width, which steadies a nearly upright camera and lets go of a clearly tilted one. ``FREE``: no prior.
    """
    pull, stiffness = np.zeros(6), np.zeros((6, 6))
    if dof is not Dof.FREE:
        heading, roll = T_map_camera[:3, 2], Pose(T_map_camera).roll
        scale = _ROLL_SIGMA_RAD**2 + (roll**2 if dof is Dof.AUTO else 0.0)
        pull[3:] = -roll / scale * heading
        stiffness[3:, 3:] = np.outer(heading, heading) / scale
    return pull, stiffness


def moved(T: FloatArray, step: FloatArray) -> FloatArray:
    """Pose (4, 4) after a ``step`` (6,): position [m], then rotation [rad] from the left, map frame."""
    R = _rotation(step[3:]) @ T[:3, :3]
    return pose_matrix(R, T[:3, 3] + step[:3])


def _rotation(vector: FloatArray) -> FloatArray:
    """Rotation matrix (3, 3) of a rotation vector (3,), by Rodrigues' formula."""
    x, y, z = vector.tolist()
    angle = math.hypot(x, y, z)
    sine, versine = (math.sin(angle) / angle, (1 - math.cos(angle)) / angle**2) if angle > 1e-9 else (1.0, 0.5)
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + sine * K + versine * (K @ K))
