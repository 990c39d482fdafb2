"""Pictures of a flat board with known corners → a camera's intrinsics, and their uncertainty."""

from rholoc.calibration.boards import Board, BoardKind
from rholoc.calibration.calibrate import Calibration, calibrate

__all__ = ["Board", "BoardKind", "Calibration", "calibrate"]
