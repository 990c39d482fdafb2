"""Joint ascent over several frames: the sum of their log densities, with known relative poses as soft constraints.

Each frame contributes Σ log(ε + ρ); each link subtracts its squared error over 2σ². Stiff links make it the density of
one rig; links from odometry give way as far as the odometry may be wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from rholoc.density import Densities, Evidence
from rholoc.geometry import FloatArray
from rholoc.localization.pose.ascent import Optimum, information_at, moved, normal_equations, optimum_at
from rholoc.localization.types import Dof

_SETTLED = 1e-4  # metres or radians
_LONGEST_STEP = np.repeat([0.5, 0.3], 3)  # metres, radians


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
) -> list[Optimum]:
    """Gauss–Newton over the poses (N, 4, 4) of N frames, with decreasing tolerances [px] of at most ``iterations``
    steps each.

    Returns each frame's optimum, rated at the last tolerance. ``evidences`` has one entry per frame.
    """
    T = np.array(T_map_cameras, dtype=np.float64)
    for tolerance_px in tolerances_px:
        locals_ = [densities.near(one, pose, tolerance_px) for one, pose in zip(evidences, T, strict=True)]
        for _ in range(iterations):
            slope, curvature = _link_equations(T, links)
            for i, (local, evidence) in enumerate(zip(locals_, evidences, strict=True)):
                if len(evidence):
                    own = slice(6 * i, 6 * i + 6)
                    pull, stiffness = normal_equations(local, evidence.epsilon, T[i], tolerance_px, dof)
                    slope[own] += pull
                    curvature[own, own] += stiffness
            step = _bounded(slope, curvature)
            T = np.array([moved(pose, part) for pose, part in zip(T, step, strict=True)])
            if np.abs(step).max() < _SETTLED:
                break
    return [optimum_at(densities, one, pose, tolerances_px[-1]) for one, pose in zip(evidences, T, strict=True)]


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
