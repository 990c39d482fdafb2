"""LO-RANSAC: a pose from matches of which many are false, by poselib (Larsson and contributors)."""

from __future__ import annotations

import numpy as np

from rholoc.geometry import FloatArray
from rholoc.geometry.resection import resected

_MIN_MATCHES = 4


def lo_ransac(
    rays: FloatArray,
    points: FloatArray,
    focal_px: float,
    tolerance_px: float,
    most_samples: int,
    fewest_samples: int = 1000,
    success: float = 0.9999,
) -> tuple[FloatArray, int] | None:
    """The pose (4, 4) that most matches agree with, and how many do.

    Samples are drawn from the first matches first (PROSAC, Chum and Matas 2005), each better one is optimized locally,
    and drawing ends once a better one has become improbable. None where there are too few matches or none agree.

    Args:
        rays: (M, 3) unit, of the detections in the camera frame, the likeliest match first.
        points: (M, 3) their landmarks, metres, map frame.
        focal_px: turns the tolerance into an angle.
        tolerance_px: how far off an agreeing match may be.
        most_samples: the most that are drawn.
        fewest_samples: the least, however well the first ones fit.
        success: how probable it must be that no better sample was missed.
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
