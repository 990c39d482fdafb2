"""Joint ascent over several frames: the sum of their log densities, with known relative poses as soft constraints.

Each frame contributes Σ log(ε + ρ), in the last steps Cauchy's log-likelihood as for one frame; each link subtracts its
squared error over 2σ². Stiff links make it the density of one rig; links from odometry give way as far as the odometry
may be wrong.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from rholoc.density import Densities, Evidence
from rholoc.geometry import FloatArray
from rholoc.localization.pose.ascent import (
    Optimum,
    information_at,
    moved,
    normal_equations,
    refinement_equations,
)
from rholoc.localization.types import Dof

_SETTLED = 1e-4  # metres or radians
_LONGEST_STEP = np.repeat([0.5, 0.3], 3)  # metres, radians
_LAST_ITERATIONS = 10

_Equations = Callable[[FloatArray], tuple[FloatArray, FloatArray]]  # gradient (6,), curvature (6, 6) at a pose (4, 4)


@dataclass(frozen=True, eq=False)
class Link:
    """Measured relative pose between two frames.

    Attributes:
        a: row of the first frame.
        b: row of the second frame.
        T_a_b: (4, 4), takes points from b's camera frame to a's.
        sigma_m: standard deviation of the position along each axis.
        sigma_rad: standard deviation of the rotation about each axis.
    """

    a: int
    b: int
    T_a_b: FloatArray
    sigma_m: float
    sigma_rad: float


def ascend_together(
    densities: Densities,
    evidences: Sequence[Evidence],
    T_map_cameras: FloatArray,
    links: Sequence[Link],
    tolerances_px: tuple[float, ...],
    dof: Dof,
    iterations: int = 5,
) -> FloatArray:
    """Poses (N, 4, 4) of N frames after Gauss–Newton from others, with decreasing tolerances [px] of at most
    ``iterations`` steps each. ``evidences`` has one entry per frame.
    """
    T = T_map_cameras
    for tolerance_px in tolerances_px:
        equations: list[_Equations | None] = []
        for evidence, pose in zip(evidences, T, strict=True):
            local = densities.near(evidence, pose, tolerance_px)
            climbed = partial(normal_equations, local, evidence.epsilon, tolerance_px=tolerance_px, dof=dof)
            equations.append(climbed if len(evidence) else None)
        T = _climbed(equations, T, links, iterations)
    return T


def refined_together(
    evidences: Sequence[Evidence], T_map_cameras: FloatArray, links: Sequence[Link], dof: Dof
) -> FloatArray:
    """Last steps from the poses (N, 4, 4) of N frames, as :func:`~rholoc.localization.pose.ascent.refined` takes them
    for one. A frame without evidence is placed by its links alone. Returns the poses (N, 4, 4).
    """
    equations = [partial(refinement_equations, one, dof=dof) if len(one) else None for one in evidences]
    return _climbed(equations, T_map_cameras, links, _LAST_ITERATIONS) if any(equations) else T_map_cameras


def _climbed(
    equations: Sequence[_Equations | None], T_map_cameras: FloatArray, links: Sequence[Link], iterations: int
) -> FloatArray:
    """Poses (N, 4, 4) after Gauss–Newton steps by the frames' equations (None: no matches) and the links."""
    T = T_map_cameras
    for _ in range(iterations):
        slope, curvature = _link_equations(T, links)
        for i, of_frame in enumerate(equations):
            if of_frame is not None:
                own = slice(6 * i, 6 * i + 6)
                pull, stiffness = of_frame(T[i])
                slope[own] += pull
                curvature[own, own] += stiffness
        step = _bounded(slope, curvature)
        T = np.array([moved(pose, part) for pose, part in zip(T, step, strict=True)])
        if np.abs(step).max() < _SETTLED:
            break
    return T


def joint_covariances(evidences: Sequence[Evidence], optima: Sequence[Optimum], links: Sequence[Link]) -> FloatArray:
    """Covariance (N, 6, 6) of each frame's pose (position [m], rotation [rad]), given all frames and links; see
    :func:`covariance_at`.
    """
    information = _link_equations(np.array([one.T_map_camera for one in optima]), links)[1]
    for i, (evidence, optimum) in enumerate(zip(evidences, optima, strict=True)):
        own = slice(6 * i, 6 * i + 6)
        information[own, own] += information_at(evidence, optimum)
    covariance = np.linalg.inv(information + 1e-6 * np.eye(len(information)))
    return np.array([covariance[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] for i in range(len(optima))])


def _bounded(slope: FloatArray, curvature: FloatArray) -> FloatArray:
    """Gauss–Newton step (N, 6) from a gradient (6N,) and curvature (6N, 6N), shortened as a whole to at most half a
    metre and 0.3 rad per axis and frame.
    """
    damping = 1e-9 * np.trace(curvature) / len(curvature) + 1e-6
    step = np.linalg.solve(curvature + damping * np.eye(len(curvature)), slope).reshape(-1, 6)
    return np.asarray(step / max(float((np.abs(step) / _LONGEST_STEP).max()), 1.0))


def _link_equations(T: FloatArray, links: Sequence[Link]) -> tuple[FloatArray, FloatArray]:
    """Gradient (6N,) and curvature (6N, 6N) of the links' log-likelihood with respect to the poses T (N, 4, 4)."""
    size = 6 * len(T)
    slope, curvature = np.zeros(size), np.zeros((size, size))
    for link in links:
        expected = T[link.a] @ link.T_a_b
        arm = expected[:3, 3] - T[link.a, :3, 3]
        turned = Rotation.from_matrix(T[link.b, :3, :3] @ expected[:3, :3].T).as_rotvec()
        error = np.concatenate([T[link.b, :3, 3] - expected[:3, 3], turned])
        J = np.zeros((6, 12))  # of the error, by a's motion and by b's
        J[:, :6], J[:, 6:] = -np.eye(6), np.eye(6)
        J[:3, 3:6] = [[0, -arm[2], arm[1]], [arm[2], 0, -arm[0]], [-arm[1], arm[0], 0]]
        weights = np.repeat([link.sigma_m**-2, link.sigma_rad**-2], 3)
        rows = np.concatenate([np.arange(6 * link.a, 6 * link.a + 6), np.arange(6 * link.b, 6 * link.b + 6)])
        slope[rows] -= J.T @ (weights * error)
        curvature[np.ix_(rows, rows)] += (J.T * weights) @ J
    return slope, curvature
