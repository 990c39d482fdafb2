"""Vectors of three (``UP`` is the map's z axis), and angles and distances between rotations, directions and poses."""

import numpy as np
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from rholoc.geometry.arrays import FloatArray

UP: FloatArray = np.array([0.0, 0.0, 1.0])
UP.flags.writeable = False


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """a × b of (..., 3); several times faster than NumPy's own on a few hundred vectors."""
    ax, ay, az, bx, by, bz = a[..., 0], a[..., 1], a[..., 2], b[..., 0], b[..., 1], b[..., 2]
    x, y, z = ay * bz, az * bx, ax * by
    x -= az * by
    y -= ax * bz
    z -= ay * bx
    out = np.empty((*x.shape, 3))
    out[..., 0], out[..., 1], out[..., 2] = x, y, z
    return out


def basis_across(rays: FloatArray) -> FloatArray:
    """Two orthonormal vectors (N, 3, 2), as columns, perpendicular to each unit ray (N, 3)."""
    helper = np.where(np.abs(rays[:, :1]) < 0.7, [[1.0, 0, 0]], [[0, 1.0, 0]])
    first = cross(rays, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, cross(rays, first)], axis=2)


def rotation_angles(R_a: FloatArray, R_b: FloatArray) -> FloatArray:
    """Angles (...) [rad], 0 to π, between the rotations (..., 3, 3) of two arrays, pair by pair."""
    relative = np.swapaxes(R_a, -1, -2) @ R_b
    angles = Rotation.from_matrix(relative.reshape(-1, 3, 3)).magnitude() if relative.size else np.zeros(0)
    return np.asarray(np.reshape(angles, relative.shape[:-2]))


def angles_between(a: FloatArray, b: FloatArray) -> FloatArray:
    """The angles (...) in radians, 0 to π, between the vectors (..., 3) of two arrays, pair by pair.

    Vectors of any length; with a vector of length 0 the angle is 0.
    """
    return np.asarray(np.arctan2(np.linalg.norm(cross(a, b), axis=-1), np.sum(a * b, axis=-1)))


def direction_angles(a: FloatArray, b: FloatArray) -> FloatArray:
    """The angles (N, M) in radians, 0 to π, between unit vectors (N, 3) and (M, 3), each with each."""
    return np.asarray(2 * np.arctan2(cdist(a, b), cdist(a, -b)))


def pose_distances(T_a: FloatArray, T_b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Distances (...) [m] and angles (...) [rad] between poses (..., 4, 4) of two arrays, pair by pair."""
    apart = np.linalg.norm(T_a[..., :3, 3] - T_b[..., :3, 3], axis=-1)
    return np.asarray(apart), rotation_angles(T_a[..., :3, :3], T_b[..., :3, :3])
