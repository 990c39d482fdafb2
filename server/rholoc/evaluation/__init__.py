"""How good poses are: errors against the truth, recall, plots."""

from rholoc.evaluation.errors import (
    RECALL_THRESHOLDS,
    Evaluation,
    PoseErrors,
    evaluate,
    quantile,
    rigid_alignment,
    trajectory_errors,
)
from rholoc.evaluation.matching import MATCH_TOLERANCE_S, PosePairs, PoseTable, in_range, pair_poses

__all__ = [
    "MATCH_TOLERANCE_S",
    "RECALL_THRESHOLDS",
    "Evaluation",
    "PoseErrors",
    "PosePairs",
    "PoseTable",
    "evaluate",
    "in_range",
    "pair_poses",
    "quantile",
    "rigid_alignment",
    "trajectory_errors",
]
