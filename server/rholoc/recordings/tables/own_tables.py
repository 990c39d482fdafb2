"""The tables of rholoc's own format: frames.csv, imu.csv (the paper's Table 3), odometry.csv, lengths.csv."""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from rholoc.errors import InvalidRecording
from rholoc.geometry import FloatArray, IntArray, pose_matrix
from rholoc.recordings.imu_normalisation import checked_span
from rholoc.recordings.recording import Imu, KnownLength, Odometry
from rholoc.recordings.tables.csv_table import read_numbers, require_increasing, shortened, table_rows, write_numbers
from rholoc.recordings.tables.pose_table import poses_from_rows

FRAME_COLUMNS = ("frame", "timestamp")

_MAX_EXACT = 2**53  # above it a float64 is not exact
IMU_COLUMNS = ("timestamp", "ax", "ay", "az", "gx", "gy", "gz")
_POSE = ("timestamp", "x", "y", "z", "qx", "qy", "qz", "qw")
_VELOCITY = ("timestamp", "vx", "vy", "vz", "wx", "wy", "wz")
_SIGMAS = ("sigma_m", "sigma_deg")
_COLUMNS = ("first", "second", "length")
_MIN_M, _MAX_M = 0.05, 1000.0
_LENGTH_HINT = "Give two frames' numbers and the metres between the camera's places there: 12,340,2.40."


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


_USUAL_DRIFT, _USUAL_TURN_RAD_M = 0.02, np.radians(1.0)  # of the way; a metre
_LEAST_M, _LEAST_RAD = 1e-3, np.radians(0.05)  # of a step
_ODOMETRY_HINT = f"The header is {','.join(_POSE)} or {','.join(_VELOCITY)}, and optionally {','.join(_SIGMAS)}."


def read_odometry_csv(path: Path) -> Odometry:
    """Read odometry: poses of the camera in a frame that drifts, or its velocities in its own axes.

    ``timestamp,x,y,z,qx,qy,qz,qw`` (s, m) or ``timestamp,vx,vy,vz,wx,wy,wz`` (s, m/s, rad/s); optionally ``sigma_m``,
    ``sigma_deg`` or both: the standard deviations of the motion since the row before, by default 2 % of the distance
    and 1° per metre, at least 1 mm and 0.05°. The first row's sigmas are not checked.

    Raises:
        InvalidRecording: columns are missing, a value is not finite or a sigma not positive, or times do not increase.
        InvalidTrajectory: a quaternion is not of unit length.
    """
    with table_rows(path, InvalidRecording, 1) as (header, _):
        given = set(header)
    columns = next((some for some in (_POSE, _VELOCITY) if set(some) <= given), None)
    if columns is None:
        raise InvalidRecording(f"{path.name} has neither poses nor velocities.", _ODOMETRY_HINT)
    table = read_numbers(path, (*columns, *(name for name in _SIGMAS if name in given)))
    times = table["timestamp"]
    require_increasing(times, path)
    rows = np.column_stack([table[name] for name in columns[1:]])
    T = poses_from_rows(rows, path.name) if columns is _POSE else _integrated(times, rows)
    way_m = np.linalg.norm(np.diff(T[:, :3, 3], axis=0, prepend=T[:1, :3, 3]), axis=1)
    sigma_m, sigma_rad = np.hypot(_USUAL_DRIFT * way_m, _LEAST_M), np.hypot(_USUAL_TURN_RAD_M * way_m, _LEAST_RAD)
    sigma_m = table.get("sigma_m", sigma_m)
    sigma_rad = np.radians(table["sigma_deg"]) if "sigma_deg" in table else sigma_rad
    if not (sigma_m[1:].min(initial=1.0) > 0 and sigma_rad[1:].min(initial=1.0) > 0):
        raise InvalidRecording(f"{path.name} has a sigma that is not positive.", _ODOMETRY_HINT)
    return Odometry(times, T, sigma_m, sigma_rad)


def _integrated(times: FloatArray, rows: FloatArray) -> FloatArray:
    """Poses (M, 4, 4) by velocities and rates (M, 6) in the camera's axes, trapezoids; the first is the identity."""
    mean, seconds = 0.5 * (rows[1:] + rows[:-1]), np.diff(times)[:, None]
    turns = Rotation.from_rotvec(mean[:, 3:] * seconds).as_matrix()
    T = np.tile(np.eye(4), (len(times), 1, 1))
    for row, (turn, way) in enumerate(zip(turns, mean[:, :3] * seconds, strict=True)):
        T[row + 1] = T[row] @ pose_matrix(turn, way)
    return T


def read_lengths_csv(path: Path, numbers: IntArray) -> tuple[KnownLength, ...]:
    """Read lengths under the header ``first,second,length``: two frames' numbers, metres.

    Args:
        path: the file.
        numbers: (N,) of the recording's frames.

    Raises:
        InvalidRecording: a column is missing, a value is not a number, a frame unknown, or a length not 0.05 to 1000 m.
    """
    table = read_numbers(path, _COLUMNS)
    rows = zip(table["first"].tolist(), table["second"].tolist(), table["length"].tolist(), strict=True)
    return tuple(_checked(first, second, length_m, numbers, path.name) for first, second, length_m in rows)


def parse_length(text: str, numbers: IntArray) -> KnownLength:
    """Parse ``12,340,2.40``: the camera's positions in frames 12 and 340 were 2.40 m apart.

    Args:
        text: two frames' numbers and metres.
        numbers: (N,) of the recording's frames.

    Raises:
        InvalidRecording: the text is something else, a frame is not in the recording, or it is not 0.05 to 1000 m.
    """
    try:
        first, second, length_m = (float(part) for part in text.split(","))
    except ValueError:
        raise InvalidRecording(f"'{shortened(text)}' is not a length between two frames.", _LENGTH_HINT) from None
    return _checked(first, second, length_m, numbers, "A length")


def _checked(first: float, second: float, length_m: float, numbers: IntArray, what: str) -> KnownLength:
    """Known length between the frames ``first`` and ``second``, among ``numbers`` (N,). Raises InvalidRecording."""
    for number in (first, second):
        if not np.any(numbers == number):
            raise InvalidRecording(
                f"{what} names the frame {number:g}, which the recording does not have.",
                f"Its frames are {numbers[0]} to {numbers[-1]}.",
            )
    if first == second:
        raise InvalidRecording(f"{what} is between the frame {first:g} and itself.", _LENGTH_HINT)
    if not _MIN_M <= length_m <= _MAX_M:
        raise InvalidRecording(f"{what} of {length_m:g} m cannot be used.", f"Measure {_MIN_M:g} to {_MAX_M:g} m.")
    return KnownLength(int(first), int(second), length_m)
