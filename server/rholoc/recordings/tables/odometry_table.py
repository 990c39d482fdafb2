"""``odometry.csv``: how the camera moved by wheels or a tracker, which drift, as poses or as velocities."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from rholoc.errors import InvalidRecording
from rholoc.geometry import FloatArray, pose_matrix
from rholoc.recordings.recording import Odometry
from rholoc.recordings.tables.csv_table import read_numbers, require_increasing, table_rows
from rholoc.recordings.tables.pose_table import poses_from_rows

_POSE = ("timestamp", "x", "y", "z", "qx", "qy", "qz", "qw")
_VELOCITY = ("timestamp", "vx", "vy", "vz", "wx", "wy", "wz")
_SIGMAS = ("sigma_m", "sigma_deg")
_USUAL_DRIFT, _USUAL_TURN_RAD_M = 0.02, np.radians(1.0)  # of the way; a metre
_LEAST_M, _LEAST_RAD = 1e-3, np.radians(0.05)  # of a step
_HINT = f"The header is {','.join(_POSE)} or {','.join(_VELOCITY)}, and optionally {','.join(_SIGMAS)}."


def read_odometry_csv(path: Path) -> Odometry:
    """Read odometry: poses of the camera in a frame that drifts, or its velocities in its own axes.

    ``timestamp,x,y,z,qx,qy,qz,qw`` (s, m) or ``timestamp,vx,vy,vz,wx,wy,wz`` (s, m/s, rad/s); optionally ``sigma_m``,
    ``sigma_deg``: the standard deviations of the motion since the row before, by default 2 % of the way and 1° a metre.

    Raises:
        InvalidRecording: columns are missing, a value is not finite or a sigma not positive, or times do not increase.
        InvalidTrajectory: a quaternion is not of unit length.
    """
    with table_rows(path, InvalidRecording, 1) as (header, _):
        given = set(header)
    columns = next((some for some in (_POSE, _VELOCITY) if set(some) <= given), None)
    if columns is None:
        raise InvalidRecording(f"{path.name} has neither poses nor velocities.", _HINT)
    has_sigmas = set(_SIGMAS) <= given
    table = read_numbers(path, (*columns, *(_SIGMAS if has_sigmas else ())))
    times = table["timestamp"]
    require_increasing(times, path)
    rows = np.column_stack([table[name] for name in columns[1:]])
    T = poses_from_rows(rows, path.name) if columns is _POSE else _integrated(times, rows)
    if has_sigmas:
        sigma_m, sigma_rad = table["sigma_m"], np.radians(table["sigma_deg"])
    else:
        way_m = np.linalg.norm(np.diff(T[:, :3, 3], axis=0, prepend=T[:1, :3, 3]), axis=1)
        sigma_m, sigma_rad = np.hypot(_USUAL_DRIFT * way_m, _LEAST_M), np.hypot(_USUAL_TURN_RAD_M * way_m, _LEAST_RAD)
    if not (sigma_m[1:].min(initial=1.0) > 0 and sigma_rad[1:].min(initial=1.0) > 0):
        raise InvalidRecording(f"{path.name} has a sigma that is not positive.", _HINT)
    return Odometry(times, T, sigma_m, sigma_rad)


def _integrated(times: FloatArray, rows: FloatArray) -> FloatArray:
    """Poses (M, 4, 4) by velocities and rates (M, 6) in the camera's axes, trapezoids; the first is the identity."""
    mean, seconds = 0.5 * (rows[1:] + rows[:-1]), np.diff(times)[:, None]
    turns = Rotation.from_rotvec(mean[:, 3:] * seconds).as_matrix()
    T = np.tile(np.eye(4), (len(times), 1, 1))
    for row, (turn, way) in enumerate(zip(turns, mean[:, :3] * seconds, strict=True)):
        T[row + 1] = T[row] @ pose_matrix(turn, way)
    return T
