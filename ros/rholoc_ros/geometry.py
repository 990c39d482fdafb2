"""Transforms between the frames of REP 105: map, odom, base, and a camera's optical frame (REP 103: z forward)."""

from __future__ import annotations

import math

import numpy as np

from rholoc_client.tracking.rigid import FloatArray, carried, in_radians, inverse, motion_between, moved, pose, rotation


def map_to_odom(T_map_base: FloatArray, T_odom_base: FloatArray) -> FloatArray:
    """T_map_odom (4, 4) of the two poses of one base at one moment: that of the picture."""
    return T_map_base @ inverse(T_odom_base)


def planar(T: FloatArray) -> FloatArray:
    """Pose (4, 4) with the x, y and yaw of ``T``, without height, roll and pitch."""
    yaw = math.atan2(float(T[1, 0]), float(T[0, 0]))
    return pose(rotation(np.array([0.0, 0.0, yaw])), np.array([T[0, 3], T[1, 3], 0.0]))


def base_covariance(
    covariance: tuple[tuple[float, ...], ...], T_map_camera: FloatArray, T_map_base: FloatArray
) -> FloatArray:
    """Covariance (6, 6) of a base's pose [m, rad] from the camera's, which the client gives in metres and degrees.

    Both are ordered x, y, z, rotation about x, y, z, all along the map's axes, as in ``PoseWithCovariance``.
    """
    return carried(in_radians(covariance), T_map_base[:3, 3] - T_map_camera[:3, 3])


def interpolated(before: FloatArray, after: FloatArray, share: float) -> FloatArray:
    """Pose (4, 4) a ``share`` (0..1) of the way from one pose to another, at constant velocity and turn rate."""
    return moved(before, share * motion_between(before, after))
