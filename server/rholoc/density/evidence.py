"""Matches of a frame as pairs of a camera ray and a landmark that it may show."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rholoc.geometry import FloatArray, IntArray, basis_across
from rholoc.lazy import lazy

_FALSE_DENSITY = 0.1  # the density of false matches near the truth, relative to true ones


@dataclass(frozen=True, eq=False)
class Evidence:
    """M matches: rays of the camera and landmarks of the map.

    Attributes:
        features: (M,) rows of the map's features.
        rays: (M, 3) unit rays in the camera frame.
        across: (M, 3, 2) an orthonormal basis across each ray, camera frame.
        landmarks: (M, 3) metres, map frame.
        covariances: (M, 3, 3) m², map frame.
        epsilon: (M,) the odds that the match is false, in units of the density's peak.
        focal_px: the focal length, to turn pixels into angles.
    """

    features: IntArray
    rays: FloatArray
    across: FloatArray
    landmarks: FloatArray
    covariances: FloatArray
    epsilon: FloatArray
    focal_px: float

    @classmethod
    def of(
        cls,
        features: IntArray,
        rays: FloatArray,
        landmarks: FloatArray,
        covariances: FloatArray,
        chances: FloatArray,
        focal_px: float,
    ) -> Evidence:
        """From features (M,), unit rays (M, 3), landmarks (M, 3), covariances (M, 3, 3) and chances (M,) in (0, 1] of
        being true.
        """
        epsilon = _FALSE_DENSITY * (1 - chances) / chances
        return cls(features, rays, basis_across(rays), landmarks, covariances, epsilon, focal_px)

    def __len__(self) -> int:
        return len(self.rays)

    @property
    def chances(self) -> FloatArray:
        """Probability (M,) that each match is true, by descriptors alone."""
        return _FALSE_DENSITY / (_FALSE_DENSITY + self.epsilon)

    @lazy
    def variances(self) -> FloatArray:
        """Variance (M,) [m²] of each landmark along an axis, the mean over all axes."""
        return np.asarray(np.trace(self.covariances, axis1=1, axis2=2) / 3)

    def refocused(self, scale: float) -> Evidence:
        """The evidence if the camera's focal length were ``scale`` times as long: rays of the same pixels."""
        rays = self.rays * (1.0, 1.0, scale)
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        return replace(self, rays=rays, across=basis_across(rays), focal_px=self.focal_px * scale)

    def take(self, index: IntArray) -> Evidence:
        """The evidence of the matches in rows ``index`` (K,), in that order."""
        return Evidence(
            self.features[index],
            self.rays[index],
            self.across[index],
            self.landmarks[index],
            self.covariances[index],
            self.epsilon[index],
            self.focal_px,
        )
