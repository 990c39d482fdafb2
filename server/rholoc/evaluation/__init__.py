"""Evaluation of poses: errors against the truth, recall, comparisons."""

from rholoc.evaluation.errors import (
    RECALL_THRESHOLDS,
    Evaluation,
    PoseErrors,
    evaluate,
    quantile,
    rigid_alignment,
    trajectory_errors,
)
from rholoc.evaluation.matching import MATCH_TOLERANCE_S, FramePoses, PosePairs, in_range, pair_poses
from rholoc.evaluation.reading import read_frame_poses

__all__ = [
    "MATCH_TOLERANCE_S",
    "RECALL_THRESHOLDS",
    "Evaluation",
    "FramePoses",
    "PoseErrors",
    "PosePairs",
    "evaluate",
    "in_range",
    "pair_poses",
    "quantile",
    "read_frame_poses",
    "rigid_alignment",
    "trajectory_errors",
]
