"""Evaluation of poses: errors against the truth, recall, comparisons."""

from rholoc.evaluation.errors import (
    Evaluation,
    PoseErrors,
    evaluate,
    quantile,
    rigid_alignment,
    trajectory_errors,
)
from rholoc.evaluation.pose_pairing import FramePoses, in_range, pair_poses
from rholoc.evaluation.reading import read_frame_poses

__all__ = [
    "Evaluation",
    "FramePoses",
    "PoseErrors",
    "evaluate",
    "in_range",
    "pair_poses",
    "quantile",
    "read_frame_poses",
    "rigid_alignment",
    "trajectory_errors",
]
