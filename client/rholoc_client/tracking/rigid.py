"""Rigid motions as 4×4 matrices, and small motions as six numbers: position in metres, then a rotation vector in
radians applied from the left, both in the map frame. The covariances of answers are covariances of such motions."""

import math
from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray: TypeAlias = NDArray[np.floating[Any]]

_RIGID_TOLERANCE = 1e-3
_DEGREES = np.array([1.0, 1.0, 1.0, *[180 / math.pi] * 3])


def rigid(values: ArrayLike) -> FloatArray:
    """A motion (4, 4), its rotation made orthonormal.

    Raises:
        ValueError: it is not one: not finite, not 4×4, or no rotation.
    """
    T = np.array(values, dtype=np.float64)
    if T.shape != (4, 4) or not np.isfinite(T).all() or not np.allclose(T[3], (0, 0, 0, 1), atol=_RIGID_TOLERANCE):
        raise ValueError("A pose is a finite 4×4 matrix whose last row is 0, 0, 0, 1.")
    R = T[:3, :3]
    if np.abs(R @ R.T - np.eye(3)).max() > _RIGID_TOLERANCE or np.linalg.det(R) < 0:
        raise ValueError("The rotation of a pose is not orthonormal, or it is a reflection.")
    U, _, V = np.linalg.svd(R)
    return pose(U @ V, T[:3, 3])


def pose(R: FloatArray, position: FloatArray) -> FloatArray:
    """The motion (4, 4) of a rotation (3, 3) and a position (3,)."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, position
    return T


def from_quaternion(position: Sequence[float], quaternion_xyzw: Sequence[float]) -> FloatArray:
    """The motion (4, 4) of a position in metres and a rotation as a quaternion of any length but 0.

    Raises:
        ValueError: they are not three and four finite numbers, or the quaternion is 0.
    """
    p, q = np.asarray(position, dtype=np.float64), np.asarray(quaternion_xyzw, dtype=np.float64)
    if p.shape != (3,) or q.shape != (4,) or not np.isfinite(p).all() or not np.isfinite(q).all():
        raise ValueError("A pose is a position of three finite numbers and a quaternion of four.")
    length = float(np.linalg.norm(q))
    if length < 1e-9:
        raise ValueError("A quaternion of length 0 is not a rotation.")
    x, y, z, w = q / length
    R = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    return pose(R, p)


def quaternion_of(R: FloatArray) -> tuple[float, float, float, float]:
    """A rotation (3, 3) as x, y, z, w with w ≥ 0 (Shepperd's method: no division by what is nearly 0)."""
    squares = [R[0, 0], R[1, 1], R[2, 2], np.trace(R)]
    largest = int(np.argmax(squares))
    if largest == 3:
        q = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1], 1 + np.trace(R)])
    else:
        i, j, k = largest, (largest + 1) % 3, (largest + 2) % 3
        q = np.zeros(4)
        q[i] = 1 + R[i, i] - R[j, j] - R[k, k]
        q[j], q[k], q[3] = R[j, i] + R[i, j], R[k, i] + R[i, k], R[k, j] - R[j, k]
    q /= np.linalg.norm(q)
    x, y, z, w = (q if q[3] >= 0 else -q).tolist()
    return x, y, z, w


def inverse(T: FloatArray) -> FloatArray:
    """The inverse of a motion (4, 4)."""
    R = T[:3, :3].T
    return pose(R, -R @ T[:3, 3])


def cross(v: FloatArray) -> FloatArray:
    """[v]× (3, 3): cross(v) @ w is v × w."""
    x, y, z = v.tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def rotation(vector: FloatArray) -> FloatArray:
    """The rotation (3, 3) of a rotation vector (3,), by Rodrigues' formula."""
    angle = math.sqrt(float(vector @ vector))
    sine, versine = (math.sin(angle) / angle, (1 - math.cos(angle)) / angle**2) if angle > 1e-9 else (1.0, 0.5)
    K = cross(vector)
    return np.asarray(np.eye(3) + sine * K + versine * (K @ K))


def rotation_vector(R: FloatArray) -> FloatArray:
    """The rotation vector (3,) of a rotation (3, 3); its length is at most π."""
    x, y, z, w = quaternion_of(R)
    axis = np.array([x, y, z])
    sine = float(np.linalg.norm(axis))
    return axis * (2 * math.atan2(sine, w) / sine if sine > 1e-12 else 2.0)


def moved(T: FloatArray, motion: FloatArray) -> FloatArray:
    """A pose (4, 4) after a small motion (6,)."""
    return pose(rotation(motion[3:]) @ T[:3, :3], T[:3, 3] + motion[:3])


def motion_between(a: FloatArray, b: FloatArray) -> FloatArray:
    """The motion (6,) that takes pose ``a`` (4, 4) to pose ``b``."""
    return np.concatenate([b[:3, 3] - a[:3, 3], rotation_vector(b[:3, :3] @ a[:3, :3].T)])


def carried(covariance: FloatArray, by: FloatArray) -> FloatArray:
    """The covariance (6, 6) of a pose, at a point that is rigidly attached to it, ``by`` (3,) away in the map frame.

    δp' = δp + δθ × by.
    """
    J = np.eye(6)
    J[:3, 3:] = -cross(by)
    return np.asarray(J @ covariance @ J.T)


def in_radians(covariance: ArrayLike) -> FloatArray:
    """A pose's covariance (6, 6) in metres and radians, from metres and degrees as answers have it."""
    return np.asarray(np.asarray(covariance) / np.outer(_DEGREES, _DEGREES))


def in_degrees(covariance: ArrayLike) -> FloatArray:
    """A pose's covariance (6, 6) in metres and degrees, from metres and radians."""
    return np.asarray(np.asarray(covariance) * np.outer(_DEGREES, _DEGREES))
