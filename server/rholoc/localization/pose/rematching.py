"""Re-matching: project the landmarks at a pose, match again nearby, ascend again, and collect the evidence."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rholoc.density import Evidence
from rholoc.geometry import Camera, FloatArray, IntArray, pose_distances
from rholoc.lazy import lazy
from rholoc.localization.index.map_index import MapIndex
from rholoc.localization.index.matches import Matches
from rholoc.localization.pose.ascent import Optimum, ascend, covariance_at, end_of_climb, optimum_at, refined
from rholoc.localization.pose.pose_evidence import Support, support_of
from rholoc.localization.types import Dof, Query

SEARCH_RADII_PX = (14.0, 5.0)
FINAL_TOLERANCE_PX = 4.0
_POLISHING_RADIUS_PX = 10.0
_MIN_MATCHES = 6
ENOUGH_MATCHES = 60  # of a sample of features, within the first radius, for the others to be skipped there
_VIEWS_ALIKE = 10
_WIDE_ITERATIONS = 2  # at each tolerance of the ascent within the wider radius


@dataclass(frozen=True, eq=False)
class Verified:
    """A pose after re-matching.

    Attributes:
        optimum: end of the last ascent.
        matches: matches around the pose.
        evidence: their evidence.
        pixels: (M, 2) pixels of the matched detections.
        wide: matches of the first, widest search.
        support: evidence for and against the pose.
        focal_free: whether the focal length was estimated too; the covariance then includes its uncertainty.
    """

    optimum: Optimum
    matches: Matches
    evidence: Evidence
    pixels: FloatArray
    wide: Matches
    support: Support
    focal_free: bool = False

    @lazy
    def covariance(self) -> FloatArray:
        """(6, 6) of position [m] and rotation [rad, map frame, from the left]."""
        return covariance_at(self.evidence, self.optimum, self.focal_free)

    @property
    def inliers(self) -> int:
        """Number of matches that agree with the pose."""
        return int((self.optimum.density > 0).sum())

    @property
    def inlier_pixels(self) -> FloatArray:
        """Pixels (N, 2) of the matches that agree with the pose."""
        return self.pixels[self.optimum.density > 0]

    @property
    def inlier_landmarks(self) -> IntArray:
        """(I,) landmarks of the matches that agree with the pose."""
        return self.matches.landmarks[self.optimum.density > 0]

    def is_apart(self, other: Verified, more_than_m: float, more_than_rad: float) -> bool:
        """Whether another pose is farther away than one bound, or turned by more than the other."""
        apart_m, turned_rad = pose_distances(self.optimum.T_map_camera, other.optimum.T_map_camera)
        return bool(apart_m > more_than_m or turned_rad > more_than_rad)


def evidence_of(index: MapIndex, matches: Matches, rays: FloatArray, camera: Camera) -> Evidence:
    """Evidence of matches (M), given the unit rays (N, 3) of all the query's features in the camera frame."""
    return Evidence.of(
        matches.landmarks,
        rays[matches.detections],
        index.landmarks[matches.landmarks],
        index.covariances[matches.landmarks],
        matches.chances,
        camera.focal,
    )


def settle(index: MapIndex, matches: Matches, evidence: Evidence, optimum: Optimum, dof: Dof) -> Optimum:
    """Last steps of an ascent that ended at ``FINAL_TOLERANCE_PX``, by :func:`settling` matches; rates the end at that
    tolerance again. The optimum itself if there are none.
    """
    some = settling(index, matches, optimum)
    if len(some) == 0:
        return optimum
    T = refined(evidence.take(some), optimum.T_map_camera, dof)
    return optimum_at(index.map.densities, evidence, T, FINAL_TOLERANCE_PX)


def settling(index: MapIndex, matches: Matches, optimum: Optimum) -> IntArray:
    """Rows of the matches for the last steps of an ascent; none if fewer than six of them are inliers, or the densities
    have no exact peaks.

    Landmarks that were only seen from elsewhere look different from here and are detected less exactly. They help to
    find and to believe a pose, but the last steps only use landmarks that nearby views saw too.
    """
    if not index.map.densities.has_exact_peaks:
        return np.zeros(0, dtype=np.int64)
    agreeing = optimum.density > 0
    alike = index.seen_alike(matches.landmarks[agreeing], _VIEWS_ALIKE)[matches.landmarks]
    return np.flatnonzero(alike if (agreeing & alike).sum() >= _MIN_MATCHES else np.zeros_like(alike))


def polished(index: MapIndex, query: Query, verified: Verified) -> Verified:
    """The pose refined once more by matches within 10 px; its matches and evidence stay.

    Seen from afar, features are detected less exactly than the narrow radius of :func:`verify` assumes, and the choice
    of matches by that radius would bias the pose.
    """
    densities, T = index.map.densities, verified.optimum.T_map_camera
    matches, _ = index.match_near(query.features, query.camera, T, _POLISHING_RADIUS_PX)
    evidence = evidence_of(index, matches, query.camera.rays(query.features.pixels), query.camera)
    start = optimum_at(densities, evidence, T, FINAL_TOLERANCE_PX)
    end = settle(index, matches, evidence, start, query.dof)
    return replace(verified, optimum=optimum_at(densities, verified.evidence, end.T_map_camera, FINAL_TOLERANCE_PX))


def matches_about(index: MapIndex, query: Query, T_map_camera: FloatArray, radius_px: float) -> Matches:
    """Matches within ``radius_px`` of the landmarks projected at a pose (4, 4).

    Only a sample of the features is matched if it has ``ENOUGH_MATCHES``, otherwise all.
    """
    some = query.features.sample
    if len(some) < len(query.features):
        matches, _ = index.match_near(query.features, query.camera, T_map_camera, radius_px, some)
        if len(matches) >= ENOUGH_MATCHES:
            return matches
    return index.match_near(query.features, query.camera, T_map_camera, radius_px)[0]


def verify(
    index: MapIndex,
    query: Query,
    rays: FloatArray,
    T_map_camera: FloatArray,
    focal_free: bool = False,
    wide: Matches | None = None,
) -> Verified | None:
    """Match again around a pose (4, 4) and ascend, within a wide (14 px) and then a narrow (5 px) radius.

    Args:
        index: index of the map.
        query: the frame.
        rays: (N, 3) rays of all features in the camera frame.
        T_map_camera: (4, 4) start.
        focal_free: whether the focal length is an estimate; only noted in the result.
        wide: matches within the first radius, if they are already known.

    Returns:
        The pose with the matches of the narrow radius; None if either radius has fewer than six matches.
    """
    densities, dof = index.map.densities, query.dof
    wide_px, narrow_px = SEARCH_RADII_PX
    wide = wide or matches_about(index, query, T_map_camera, wide_px)
    if len(wide) < _MIN_MATCHES:
        return None
    evidence = evidence_of(index, wide, rays, query.camera)
    T = end_of_climb(
        densities, evidence, T_map_camera, (wide_px, wide_px / 2, FINAL_TOLERANCE_PX), dof, _WIDE_ITERATIONS
    )
    matches, by_chance = index.match_near(query.features, query.camera, T, narrow_px)
    if len(matches) < _MIN_MATCHES:
        return None
    evidence = evidence_of(index, matches, rays, query.camera)
    optimum = ascend(densities, evidence, T, (narrow_px, FINAL_TOLERANCE_PX), dof)
    optimum = settle(index, matches, evidence, optimum, dof)
    support = support_of(index, query, matches, evidence, optimum, by_chance, wide)
    pixels = query.features.pixels[matches.detections]
    return Verified(optimum, matches, evidence, pixels, wide, support, focal_free)
