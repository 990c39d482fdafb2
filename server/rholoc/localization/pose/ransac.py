"""LO-RANSAC: absolute pose from matches with many outliers, by poselib (Larsson and contributors)."""

import numpy as np

from rholoc.geometry import FloatArray
from rholoc.geometry.resection import resected
from rholoc.localization.index.map_index import MapIndex
from rholoc.localization.index.matches import Matches
from rholoc.localization.pose.patch_evidence import patch_log_odds
from rholoc.localization.types import Query

_MIN_MATCHES = 4
_FEWEST_INLIERS, _CHANCE_SHARE = 4, 1 / 80


def lo_ransac(
    rays: FloatArray,
    points: FloatArray,
    focal_px: float,
    tolerance_px: float,
    most_samples: int,
    fewest_samples: int = 1000,
    success: float = 0.9999,
) -> tuple[FloatArray, int] | None:
    """Absolute pose (4, 4) with the most inliers, and their number. None for fewer than four matches or inliers.

    Likelier matches are sampled first (PROSAC, Chum and Matas 2005), improved samples are refined locally, and sampling
    ends once a better sample is improbable.

    Args:
        rays: (M, 3) unit rays of the detections in the camera frame, the likeliest match first.
        points: (M, 3) their landmarks [m], map frame.
        focal_px: converts the tolerance to an angle.
        tolerance_px: maximum reprojection error of an inlier.
        most_samples: maximum number of samples.
        fewest_samples: minimum number of samples.
        success: required probability that no better sample was missed.
    """
    if len(rays) < _MIN_MATCHES:
        return None
    settings = {
        "max_iterations": most_samples,
        "min_iterations": min(fewest_samples, most_samples),
        "max_reproj_error": tolerance_px,
        "success_prob": success,
        "progressive_sampling": True,
    }
    T_map_camera, agreeing = resected(
        [rays], [np.asarray(points, dtype=np.float64)], np.eye(4)[None], focal_px, settings
    )
    return (T_map_camera, agreeing) if agreeing >= _MIN_MATCHES and np.isfinite(T_map_camera).all() else None


def credible_pose(
    index: MapIndex, query: Query, matches: Matches, tolerance_px: float, samples: tuple[int, int]
) -> tuple[FloatArray, int] | None:
    """Absolute pose (4, 4) of a query by LO-RANSAC, and the number of its inliers. None if chance explains them.

    Chance explains inliers that are no more than agree on the best of many poses in another room (fewer than 4 + M / 80
    of M matches), and inliers whose orientations and sizes are likelier for false matches than for true ones.

    Args:
        index: index of the map.
        query: the frame.
        matches: matches of its features, in any order.
        tolerance_px: maximum reprojection error of an inlier.
        samples: maximum and minimum number of samples.
    """
    matches, camera = matches.likeliest_first(), query.camera
    pixels, points = query.features.pixels[matches.detections], index.landmarks[matches.landmarks]
    found = lo_ransac(camera.rays(pixels), points, camera.focal, tolerance_px, *samples)
    if found is None or found[1] < _FEWEST_INLIERS + _CHANCE_SHARE * len(matches):
        return None
    T = found[0]
    off_px = np.linalg.norm(camera.project((points - T[:3, 3]) @ T[:3, :3]) - pixels, axis=1)
    inliers = matches.take(np.flatnonzero(off_px <= tolerance_px))
    log_odds = patch_log_odds(index.map, query.features, camera, T, inliers.detections, inliers.landmarks)
    return None if np.nansum(log_odds) < 0 else found
