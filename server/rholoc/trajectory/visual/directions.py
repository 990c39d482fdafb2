"""Direction of motion between two keyframes of known rotation."""

from dataclasses import dataclass

import numpy as np

from rholoc.geometry import FloatArray
from rholoc.trajectory.visual.two_view import inliers_of_rotation

_MIN_INLIERS = 12
_MIN_SHARE = 0.4  # of the matches that are inliers of the direction
_CLEAR_SHARE = 0.7  # of the inliers that must lie before both cameras
_RAY_SIGMA_PX = 0.7
_ROTATION_SIGMA_RAD = np.radians(0.1)  # of the rotation between the two
_MIN_SIGMA_RAD = np.radians(0.5)
_ROUNDS = 4
_CAUCHY = 2.0


@dataclass(frozen=True, eq=False)
class PairDirection:
    """Direction from one keyframe's position to another's.

    Attributes:
        first, second: keyframe numbers.
        direction: (3,), unit, in the frame of the rotations.
        sigma_rad: standard deviation; large if the camera hardly moved.
    """

    first: int
    second: int
    direction: FloatArray
    sigma_rad: float


def direction_between(
    first: int,
    second: int,
    R_world_camera: FloatArray,
    rays: tuple[FloatArray, FloatArray],
    tolerance_px: float,
    focal_px: float,
) -> PairDirection | None:
    """Direction with most inliers; None with fewer than twelve inliers or 40 %, or if its sign is ambiguous.

    The two rays of a match and the baseline lie in one plane; the baseline is the intersection of all these planes.

    Args:
        first, second: keyframe numbers.
        R_world_camera: (K, 3, 3).
        rays: unit rays (M, 3) of the matches, in the frames of the first and the second camera.
        tolerance_px: maximum distance of an inlier's ray from its plane.
        focal_px: of the camera.
    """
    R_a, R_b = R_world_camera[first], R_world_camera[second]
    inliers = inliers_of_rotation(*rays, R_b.T @ R_a, tolerance_px / focal_px)
    if inliers.sum() < max(_MIN_INLIERS, _MIN_SHARE * len(inliers)):
        return None
    a, b = rays[0][inliers] @ R_a.T, rays[1][inliers] @ R_b.T
    normals = np.cross(a, b)
    weights = np.ones(len(normals))
    sigma_ray = _RAY_SIGMA_PX / focal_px
    for _ in range(_ROUNDS):
        information, axes = np.linalg.eigh((normals * weights[:, None]).T @ normals)
        direction = axes[:, 0]
        weights = 1 / (1 + (normals @ direction / (sigma_ray * _CAUCHY)) ** 2)
    together = np.sum(a * b, axis=1)
    depth_a = a @ direction - together * (b @ direction)  # up to a positive factor
    depth_b = together * (a @ direction) - b @ direction
    ahead = float(np.sum(weights * ((depth_a > 0) & (depth_b > 0))))
    behind = float(np.sum(weights * ((depth_a < 0) & (depth_b < 0))))
    if max(ahead, behind) < _CLEAR_SHARE * (ahead + behind) or ahead + behind == 0:
        return None
    parallax = float(np.median(np.linalg.norm(normals, axis=1)))
    sigma = np.sqrt(
        sigma_ray**2 / max(float(information[1]), 1e-12)
        + (_ROTATION_SIGMA_RAD / max(parallax, 1e-6)) ** 2
        + _MIN_SIGMA_RAD**2
    )
    return PairDirection(first, second, direction if ahead >= behind else -direction, float(sigma))
