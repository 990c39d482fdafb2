"""Lenses: how rays become points of the image, and back, before focal lengths and principal point.

Coordinates of the image are (u - cx) / fx and (v - cy) / fy. The models are OpenCV's: ``calib3d`` for the pinhole with
radial and tangential distortion (Brown and Conrady; with eight coefficients the rational model), ``fisheye`` for
Kannala and Brandt's. An equirectangular picture has longitude and latitude for coordinates.
"""

import math
from enum import StrEnum
from functools import lru_cache

import cv2
import numpy as np

from rholoc.geometry.arrays import FloatArray

_MAX_STEPS, _SETTLED = 60, 1e-13
_CLOSEST = 1e-9  # to the axis, where the direction across it is not defined


class Lens(StrEnum):
    """Projection model of a camera."""

    PINHOLE = "pinhole"  # with none of OpenCV's coefficients, or k1, k2, p1, p2[, k3[, k4, k5, k6]]
    FISHEYE = "fisheye"  # Kannala and Brandt, with none or OpenCV's k1, k2, k3, k4
    EQUIRECTANGULAR = "equirectangular"  # a panorama, or a part of one; without distortion

    @property
    def coefficients(self) -> tuple[int, ...]:
        """Possible numbers of distortion coefficients."""
        return {Lens.PINHOLE: (0, 4, 5, 8), Lens.FISHEYE: (0, 4), Lens.EQUIRECTANGULAR: (0,)}[self]


def rays_of(lens: Lens, places: FloatArray, distortion: tuple[float, ...]) -> FloatArray:
    """Normalized image coordinates (N, 2), (u - cx) / fx and (v - cy) / fy → unit rays (N, 3) in the camera frame.

    For a panorama the coordinates are radians. Beyond a fisheye's :func:`widest_angle`, its outermost ray.
    """
    match lens:
        case Lens.PINHOLE:
            plane = _undistorted(places, distortion) if distortion and len(places) else places
            rays = np.column_stack([plane, np.ones(len(plane))])
            return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))
        case Lens.FISHEYE:
            radius = np.linalg.norm(places, axis=1)
            angle = _angles_of(radius, distortion)
            across = np.where(radius < _CLOSEST, 1.0, np.sin(angle) / np.maximum(radius, _CLOSEST))
            return np.column_stack([places * across[:, None], np.cos(angle)])
        case Lens.EQUIRECTANGULAR:
            longitude, latitude = places.T
            level = np.cos(latitude)
            return np.column_stack([level * np.sin(longitude), np.sin(latitude), level * np.cos(longitude)])


def places_of(lens: Lens, points: FloatArray, distortion: tuple[float, ...]) -> FloatArray:
    """Points (N, 3) in the camera frame → normalized image coordinates (N, 2); NaN where the lens cannot show them."""
    x, y, z = points.T
    match lens:
        case Lens.PINHOLE:
            depth = np.where(z > 0, z, np.nan)
            return _distorted(points[:, :2] / depth[:, None], distortion)
        case Lens.FISHEYE:
            radius, angle = _off_axis(points)
            on_axis = radius <= _CLOSEST * np.abs(z)
            is_shown = (angle <= widest_angle(distortion)) & ~(on_axis & (z <= 0))
            away = np.where(is_shown, np.where(on_axis, z, radius), np.nan)
            return np.asarray(points[:, :2] * (np.where(on_axis, 1.0, _bent(angle, distortion)) / away)[:, None])
        case Lens.EQUIRECTANGULAR:
            level = np.hypot(x, z)
            somewhere = np.where(level + np.abs(y) > 0, 1.0, np.nan)
            return np.column_stack([np.arctan2(x, z), np.arctan2(y, level)]) * somewhere[:, None]


def slopes_of(lens: Lens, points: FloatArray, distortion: tuple[float, ...]) -> FloatArray:
    """Derivative (N, 2, 3) of :func:`places_of` by the point, at points (N, 3) in the camera frame.

    NaN for points that the lens cannot show. A pinhole's distortion is ignored.
    """
    x, y, z = points.T
    none = np.zeros(len(points))
    match lens:
        case Lens.PINHOLE:
            depth = np.where(z > 0, z, np.nan)
            return _rows((1 / depth, none, -x / depth**2), (none, 1 / depth, -y / depth**2))
        case Lens.FISHEYE:
            radius, angle = _off_axis(points)
            angle = np.where(angle <= widest_angle(distortion), angle, np.nan)
            radius = np.maximum(radius, _CLOSEST * np.abs(z))
            square = radius**2 + z**2
            stretch = np.where(angle < _CLOSEST, 1 / np.sqrt(square), _bent(angle, distortion) / radius)
            by_angle = _bending(angle, distortion)
            outward = (by_angle * z / square - stretch) / radius**2
            forward = -by_angle / square
            return _rows(
                (stretch + x * outward * x, x * outward * y, x * forward),
                (y * outward * x, stretch + y * outward * y, y * forward),
            )
        case Lens.EQUIRECTANGULAR:
            level = np.where(np.hypot(x, z) > 0, np.hypot(x, z), np.nan)
            square = level**2 + y**2
            return _rows(
                (z / level**2, none, -x / level**2),
                (-y * x / level / square, level / square, -y * z / level / square),
            )


def field_of_view_rad(lens: Lens, share: float) -> float:
    """Angle [rad] covered by an image whose length is ``share`` × the focal length, distortion left out."""
    return 2 * math.atan(share / 2) if lens is Lens.PINHOLE else share


@lru_cache(64)
def widest_angle(distortion: tuple[float, ...]) -> float:
    """Angle [rad] off the axis up to which a fisheye's radius grows, at most π. ``distortion`` is empty or k1 to k4."""
    if not distortion:
        return math.pi
    k1, k2, k3, k4 = distortion
    roots = np.roots([9 * k4, 7 * k3, 5 * k2, 3 * k1, 1.0])  # of the radius's derivative, in the angle's square
    squares = roots.real[(np.abs(roots.imag) < 1e-9 * np.maximum(np.abs(roots.real), 1e-9)) & (roots.real > 0)]
    return min(math.pi, math.sqrt(float(squares.min(initial=math.inf))))


def _undistorted(places: FloatArray, distortion: tuple[float, ...]) -> FloatArray:
    """Points (N, 2) on the plane z = 1 from a pinhole's distorted coordinates (N, 2)."""
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-12)
    found = cv2.undistortPoints(places[:, None], np.eye(3), np.array(distortion), criteria=criteria)
    return np.asarray(found, dtype=np.float64).reshape(-1, 2)


def _distorted(plane: FloatArray, distortion: tuple[float, ...]) -> FloatArray:
    """Points (N, 2) on the plane z = 1 → normalized image coordinates (N, 2) of a pinhole with distortion."""
    if not distortion:
        return plane
    x, y = plane.T
    k1, k2, p1, p2, k3, k4, k5, k6 = (*distortion, 0.0, 0.0, 0.0, 0.0)[:8]
    r2 = x * x + y * y
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    return np.column_stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        ]
    )


def _off_axis(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Distances (N,) of points (N, 3) from the optical axis, and angles (N,) off it in radians, 0 to π."""
    radius = np.hypot(points[:, 0], points[:, 1])
    return radius, np.arctan2(radius, points[:, 2])


def _bent(angle: FloatArray, distortion: tuple[float, ...]) -> FloatArray:
    """Kannala and Brandt's radius (N,) in the image, in focal lengths, at angles (N,) [rad] off the axis."""
    if not distortion:
        return angle
    k1, k2, k3, k4 = distortion
    square = angle * angle
    return np.asarray(angle * (1 + square * (k1 + square * (k2 + square * (k3 + square * k4)))))


def _bending(angle: FloatArray, distortion: tuple[float, ...]) -> FloatArray:
    """Derivative (N,) of the fisheye's radius by the angle, at angles (N,) [rad]."""
    if not distortion:
        return np.ones_like(angle)
    k1, k2, k3, k4 = distortion
    square = angle * angle
    return np.asarray(1 + square * (3 * k1 + square * (5 * k2 + square * (7 * k3 + square * 9 * k4))))


def _angles_of(radius: FloatArray, distortion: tuple[float, ...]) -> FloatArray:
    """Angles (N,) [rad] off the axis that a fisheye shows at radii (N,), in focal lengths, of the image; at most the
    widest. Newton's steps within a bracket.
    """
    widest = widest_angle(distortion)
    if not distortion:
        return np.minimum(radius, widest)
    low, high = np.zeros_like(radius), np.full_like(radius, widest)
    angle = np.minimum(radius, widest)
    for _ in range(_MAX_STEPS):
        off = _bent(angle, distortion) - radius
        if np.abs(off).max(initial=0.0) < _SETTLED:
            break
        low, high = np.where(off < 0, angle, low), np.where(off < 0, high, angle)
        with np.errstate(divide="ignore", invalid="ignore"):
            step = angle - off / _bending(angle, distortion)
        angle = np.where((step > low) & (step < high), step, (low + high) / 2)
    return angle


def _rows(u: tuple[FloatArray, ...], v: tuple[FloatArray, ...]) -> FloatArray:
    """Jacobian (N, 2, C) from its C columns for u and for v."""
    return np.stack([np.column_stack(u), np.column_stack(v)], axis=1)
