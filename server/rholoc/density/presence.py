"""Presence π_f: where a feature was seen from.

A feature is looked for only from where it can be expected: from a direction and a distance like those that it was
observed from. This keeps a feature from voting for places behind it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rholoc.geometry import BoolArray, FloatArray, IntArray, angles_between

_EXTRA_ANGLE_RAD = np.deg2rad(35.0)
_DISTANCE_RATIO = 2.0


def group_sums(groups: IntArray, values: FloatArray, count: int) -> FloatArray:
    """The sums (count, C) of the rows of ``values`` (N, C) by their group (N,) in 0..count-1."""
    columns = [np.bincount(groups, weights=column, minlength=count) for column in values.T]
    return np.stack(columns, axis=1).astype(np.float64)


@dataclass(frozen=True, eq=False)
class Presence:
    """Where each of F features was seen from.

    Attributes:
        direction: (F, 3) mean direction from the landmark to the cameras, unit vectors.
        cosine_limit: (F,) cosine of the largest angle to ``direction`` at which the feature may be seen.
        nearest: (F,) smallest distance [m] from which it was seen.
        farthest: (F,) largest distance [m] from which it was seen.
    """

    direction: FloatArray
    cosine_limit: FloatArray
    nearest: FloatArray
    farthest: FloatArray

    @classmethod
    def of(cls, landmarks: FloatArray, positions: FloatArray, features: IntArray) -> Presence:
        """From landmarks (F, 3) [m] and N observations: the camera's position (N, 3) and the feature's row (N,)."""
        count = len(landmarks)
        away = positions - landmarks[features]
        distance = np.linalg.norm(away, axis=1)
        unit = away / np.maximum(distance, 1e-9)[:, None]
        total = group_sums(features, unit, count)
        mean = total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-9)
        angle = angles_between(unit, mean[features])
        spread, farthest, nearest = np.zeros(count), np.zeros(count), np.full(count, np.inf)
        np.maximum.at(spread, features, angle)
        np.maximum.at(farthest, features, distance)
        np.minimum.at(nearest, features, distance)
        return cls(mean, np.cos(np.minimum(spread + _EXTRA_ANGLE_RAD, np.pi)), nearest, farthest)

    @property
    def half_angle(self) -> FloatArray:
        """Half angle (F,) [rad] of the cone about ``direction`` from which a feature may be seen."""
        return np.arctan2(np.sqrt(np.maximum(1 - self.cosine_limit**2, 0)), self.cosine_limit)

    @property
    def reach(self) -> tuple[FloatArray, FloatArray]:
        """Least and greatest distance (F,) [m] from which a feature may be seen: half and twice those observed."""
        return self.nearest / _DISTANCE_RATIO, self.farthest * _DISTANCE_RATIO

    def take(self, rows: IntArray | slice) -> Presence:
        """Presence of the features in ``rows`` only."""
        return Presence(self.direction[rows], self.cosine_limit[rows], self.nearest[rows], self.farthest[rows])

    def allows(self, landmarks: FloatArray, position: FloatArray) -> BoolArray:
        """Mask (F,) of the features at ``landmarks`` (F, 3) that may be seen from ``position`` (3,).

        Within the cone of observed directions widened by 35°, and between half and twice the observed distances.
        """
        away = position - landmarks
        distance = np.linalg.norm(away, axis=1)
        least, most = self.reach
        within = np.einsum("fi,fi->f", away, self.direction) >= self.cosine_limit * distance
        return np.asarray(within & (distance < most) & (distance > least))
