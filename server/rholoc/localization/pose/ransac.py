"""LO-RANSAC: absolute pose from matches with many outliers, by poselib (Larsson and contributors)."""

from __future__ import annotations

import numpy as np
import poselib

from rholoc.geometry import FloatArray, pose_matrix

_MIN_MATCHES = 4


def lo_ransac(
    plane: FloatArray,
    points: FloatArray,
    focal_px: float,
    tolerance_px: float,
    most_samples: int,
    fewest_samples: int = 1000,
    success: float = 0.9999,
) -> tuple[FloatArray, int] | None:
    """Absolute pose (4, 4) with the most inliers, and their number. None if there are too few matches or no inliers.

    Likelier matches are sampled first (PROSAC, Chum and Matas 2005), improved samples are refined locally, and sampling
    ends once a better sample is improbable.

    Args:
        plane: (M, 2) detections on the plane z = 1 of the camera frame, the likeliest match first.
        points: (M, 3) their landmarks [m], map frame.
        focal_px: converts the tolerance to the plane's unit.
        tolerance_px: maximum reprojection error of an inlier.
        most_samples: maximum number of samples.
        fewest_samples: minimum number of samples.
        success: required probability that no better sample was missed.
    """
    if len(plane) < _MIN_MATCHES:
        return None
    pinhole = {"model": "SIMPLE_PINHOLE", "width": 1, "height": 1, "params": [focal_px, 0.0, 0.0]}
    settings = {
        "max_iterations": most_samples,
        "min_iterations": min(fewest_samples, most_samples),
        "max_reproj_error": tolerance_px,
        "success_prob": success,
        "progressive_sampling": True,
    }
    pose, report = poselib.estimate_absolute_pose(
        np.asarray(plane, dtype=np.float64) * focal_px, np.asarray(points, dtype=np.float64), pinhole, settings, {}
    )
    R_camera_map = np.asarray(pose.R)
    T_map_camera = pose_matrix(R_camera_map.T, -R_camera_map.T @ np.asarray(pose.t))
    agreeing = int(report["num_inliers"])
    return (T_map_camera, agreeing) if agreeing >= _MIN_MATCHES and np.isfinite(T_map_camera).all() else None
