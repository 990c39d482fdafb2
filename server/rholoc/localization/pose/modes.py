"""Modes of one place: poses along an arc around what a picture shows, from which it looks nearly the same.

A scene that is far away and has little depth looks nearly the same from all along such an arc, and matching again
around any pose there finds matches that confirm it. The curvature at one mode does not reveal the others.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from rholoc.geometry import FloatArray
from rholoc.localization.index.map_error import RIGHT_M, RIGHT_RAD
from rholoc.localization.index.map_index import MapIndex
from rholoc.localization.pose.rematching import Verified

_ARC_RAD = np.deg2rad(8.0)
_MAX_FOUND_FROM_AFAR = 0.25  # of the expected landmarks: near the map's views more are found again
_DISTINCT_M, _DISTINCT_RAD = 0.05, np.deg2rad(2.0)


def is_seen_from_afar(verified: Verified) -> bool:
    """Whether fewer than a quarter of the expected landmarks were found: other modes of the place are likely."""
    support = verified.support
    return support.found < _MAX_FOUND_FROM_AFAR * support.expected


def poses_on_arcs(index: MapIndex, verified: Verified) -> Iterator[FloatArray]:
    """Iterate over four poses (4, 4): the verified one rotated by 8° up, down, left and right about the median of its
    inlier landmarks. Yields nothing without inliers.
    """
    T = verified.optimum.T_map_camera
    seen = verified.inlier_landmarks
    if len(seen) == 0:
        return
    centre = np.median(index.landmarks[seen], axis=0)
    for axis in (0, 1):
        for angle_rad in (_ARC_RAD, -_ARC_RAD):
            R = Rotation.from_rotvec(angle_rad * T[:3, axis]).as_matrix()
            carried = T.copy()
            carried[:3, :3] = R @ T[:3, :3]
            carried[:3, 3] = centre + R @ (T[:3, 3] - centre)
            yield carried


def are_distinct(a: Verified, b: Verified) -> bool:
    """Whether two poses are different modes (more than 5 cm or 2° apart), and not one mode that was found twice."""
    return a.is_apart(b, _DISTINCT_M, _DISTINCT_RAD)


@dataclass(frozen=True, eq=False)
class Spread:
    """Spread of mutually exclusive poses about the answered pose.

    A covariance alone would misjudge them: if the answered pose has probability 0.9 and another one is half a metre
    away, the answer is exact with probability 0.9, although the standard deviation is 15 cm.

    Attributes:
        right: probability 0 to 1 of the poses within 10 cm and 5° of the answered one.
        moment: (6, 6) second moment about the answered pose: position [m] and rotation [rad, map frame, from the left].
    """

    right: float
    moment: FloatArray

    @classmethod
    def of(cls, answered: Verified, modes: Sequence[Verified], weights: FloatArray) -> Spread:
        """Spread of M ``modes``, the pose ``answered`` among them, with probabilities ``weights`` (M,) of sum 1."""
        T = answered.optimum.T_map_camera
        poses = np.array([mode.optimum.T_map_camera for mode in modes])
        turned = Rotation.from_matrix(poses[:, :3, :3] @ T[:3, :3].T).as_rotvec()
        moves = np.hstack([poses[:, :3, 3] - T[:3, 3], turned])
        right = float(weights @ [not mode.is_apart(answered, RIGHT_M, RIGHT_RAD) for mode in modes])
        return cls(right, (weights[:, None] * moves).T @ moves)
