"""The ascent of several frames at once: one sum of log densities over all of them, their poses held to each other.

Each frame climbs its own Σ log(ε + ρ); a link says where two frames are relative to each other, and how surely. What is
maximized is the sum over frames less the links' squared errors over 2σ²: for a rig, whose links are stiff, one density
of one pose; for odometry, one that gives where the odometry does.
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
    """Where one frame is as another sees it.

    Attributes:
        a: the frame that it is seen from.
        b: the frame that is seen.
        T_a_b: (4, 4), takes points of b's camera frame to a's.
        sigma_m: one sigma of its position, metres along each axis.
        sigma_rad: one sigma of its rotation, radians about each axis.
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
    power: int = 1,
) -> list[Optimum]:
    """Gauss–Newton over the poses (N, 4, 4) of N frames, the tolerance narrowing step by step; each frame's optimum."""
    T = np.array(T_map_cameras, dtype=np.float64)
    for tolerance_px in tolerances_px:
        locals_ = [densities.near(one, pose, tolerance_px) for one, pose in zip(evidences, T, strict=True)]
        for _ in range(iterations):
            slope, curvature = _link_equations(T, links)
            for i, (local, evidence) in enumerate(zip(locals_, evidences, strict=True)):
                if len(evidence):
                    own = slice(6 * i, 6 * i + 6)
                    pull, stiffness = normal_equations(local, evidence.epsilon, T[i], tolerance_px, dof, power)
                    slope[own] += pull
                    curvature[own, own] += stiffness
            step = _bounded(slope, curvature)
            T = np.array([moved(pose, part) for pose, part in zip(T, step, strict=True)])
            if np.abs(step).max() < _SETTLED:
                break
    return [optimum_at(densities, one, pose, tolerances_px[-1]) for one, pose in zip(evidences, T, strict=True)]


def joint_covariances(evidences: Sequence[Evidence], optima: Sequence[Optimum], links: Sequence[Link]) -> FloatArray:
    """The covariance (N, 6, 6) of each frame's pose, all frames and links considered; see :func:`covariance_at`."""
    information = _link_equations(np.array([one.T_map_camera for one in optima]), links)[1]
    for i, (evidence, optimum) in enumerate(zip(evidences, optima, strict=True)):
        own = slice(6 * i, 6 * i + 6)
        information[own, own] += information_at(evidence, optimum)
    covariance = np.linalg.inv(information + 1e-6 * np.eye(len(information)))
    return np.array([covariance[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] for i in range(len(optima))])


def _bounded(slope: FloatArray, curvature: FloatArray) -> FloatArray:
    """The Gauss–Newton step (N, 6), no frame's longer than half a metre or 0.3 rad along an axis."""
    damping = 1e-9 * np.trace(curvature) / len(curvature) + 1e-6
    step = np.linalg.solve(curvature + damping * np.eye(len(curvature)), slope).reshape(-1, 6)
    return np.asarray(step / max(float((np.abs(step) / _LONGEST_STEP).max()), 1.0))


def _link_equations(T: FloatArray, links: Sequence[Link]) -> tuple[FloatArray, FloatArray]:
    """The gradient (6N,) of the links' log likelihood by the frames' motions, and its curvature (6N, 6N)."""
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
