"""``frames.csv``: the times of a recording's frames."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from rholoc.errors import InvalidRecording
from rholoc.geometry import FloatArray, IntArray
from rholoc.recordings.imu_normalisation import checked_span
from rholoc.recordings.tables.csv_table import read_numbers, require_increasing, write_numbers

FRAME_COLUMNS = ("frame", "timestamp")

_MAX_EXACT = 2**53  # above it a float64 is not exact


def read_frames_csv(path: Path) -> tuple[IntArray, FloatArray]:
    """Frame numbers (N,) int64 and times (N,) [s], both increasing, under the header ``frame,timestamp``.

    Raises:
        InvalidRecording: a column is missing, there are no rows, a value is not finite, a frame number is not whole,
            numbers or times do not increase, or times span more than two days.
    """
    numbers, times = read_frame_numbers(path)
    require_increasing(times, path)
    return numbers, checked_span(times, "frames")


def read_frame_numbers(path: Path) -> tuple[IntArray, FloatArray]:
    """Read frame numbers (N,) int64 and times (N,) in seconds, under the header ``frame,timestamp``.

    Raises:
        InvalidRecording: a column is missing, there are no rows, a value is not finite, a frame number is not whole,
            or numbers do not increase.
    """
    table = read_numbers(path, FRAME_COLUMNS)
    if np.any((table["frame"] != np.floor(table["frame"])) | (np.abs(table["frame"]) > _MAX_EXACT)):
        raise InvalidRecording(f"{path.name}: a frame number is not a whole number.")
    numbers = table["frame"].astype(np.int64)
    if np.any(np.diff(numbers) <= 0):
        raise InvalidRecording(f"{path.name}: frame numbers do not increase from row to row.")
    return numbers, table["timestamp"]


def write_frames_csv(path: Path, numbers: IntArray, times: FloatArray) -> None:
    """Write frame numbers (N,) and times (N,) in seconds; read back to a microsecond."""
    write_numbers(path, FRAME_COLUMNS, np.column_stack([numbers, times]), ["%d", "%.6f"])
