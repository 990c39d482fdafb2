"""``imu.csv``: the paper's Table 3."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from rholoc.geometry import FloatArray
from rholoc.recordings.recording import Imu
from rholoc.recordings.tables.csv_table import read_numbers, require_increasing, write_numbers

IMU_COLUMNS = ("timestamp", "ax", "ay", "az", "gx", "gy", "gz")


def read_imu_csv(path: Path, includes_gravity: bool = True, R_camera_imu: FloatArray | None = None) -> Imu:
    """Read Table 3: seconds, linear acceleration in m/s², angular velocity in rad/s, under the header
    ``timestamp,ax,ay,az,gx,gy,gz``.

    Raises:
        InvalidRecording: a column is missing, there are no rows, a value is not finite, or times do not increase.
    """
    rows = read_imu_rows(path)
    require_increasing(rows[:, 0], path)
    return Imu(rows[:, 0], rows[:, 1:4], rows[:, 4:7], includes_gravity, R_camera_imu)


def read_imu_rows(path: Path) -> FloatArray:
    """The unprocessed rows of Table 3, (M, 7) in the order of ``IMU_COLUMNS``; times in any order.

    Raises:
        InvalidRecording: a column is missing, there are no rows, or a value is not finite.
    """
    table = read_numbers(path, IMU_COLUMNS)
    return np.column_stack([table[name] for name in IMU_COLUMNS])


def write_imu_csv(path: Path, imu: Imu) -> None:
    """Write Table 3; :func:`read_imu_csv` reads it back to a microsecond and nine digits."""
    values = np.column_stack([imu.times, imu.acceleration, imu.angular_velocity])
    write_numbers(path, IMU_COLUMNS, values, ["%.6f"] + ["%.9g"] * 6)
