"""MARS logger (Android and iOS): one table of the IMU, one of the frames with focal length and exposure.

::

    movie.mp4              or .mov
    gyro_accel.csv         Timestamp[nanosec],gx[rad/s],gy[rad/s],gz[rad/s],ax[m/s^2],ay[m/s^2],az[m/s^2]
    movie_metadata.csv     Timestamp[nanosec],fx[px],fy[px],Frame No.,…,Frame readout time[nanosec],…
    frame_timestamps.txt   nanoseconds, row i is frame i      Android; the metadata may have more rows than frames

On iOS times are ``Timestamp[sec]``, and the frames' table also has ``cx[px], cy[px]``. Gravity is included; the app
turns Apple's sign round itself.
"""

import re
from pathlib import Path

import numpy as np

from rholoc.errors import InvalidRecording
from rholoc.geometry import FloatArray
from rholoc.recordings.imu_normalisation import ImuConvention, Samples, frame_times_s, normalise_imu
from rholoc.recordings.readers._frames import require_video, timed_video
from rholoc.recordings.recording import Recording
from rholoc.recordings.tables.logged_table import LoggedTable, has_columns, read_logged_table

TABLES = ("*.csv", "frame_timestamps.txt")
_IMU = ("timestamp", "gx", "gy", "gz", "ax", "ay", "az")
_FRAMES = ("timestamp", "fx", "fy")
_READOUT = "frame readout time"  # nanoseconds
_STATED_UNIT = re.compile(r"timestamp\s*\[\s*([^\]\s]+)\s*\]")
_UNITS = {"sec": "s", "seconds": "s", "s": "s", "nanosec": "ns", "nanoseconds": "ns", "ns": "ns"}


def recognises(folder: Path) -> bool:
    """Whether CSV tables, of any file name, have the columns of an IMU, and those of frame times and focal lengths."""
    return _with_columns(folder, _IMU) is not None and _with_columns(folder, _FRAMES) is not None


def read(folder: Path) -> Recording:
    """Read a recording of this format from its folder, with the intrinsics logged for each frame.

    Raises:
        InvalidRecording: a table or the video is missing or broken, or they contradict each other.
    """
    imu_csv, frames_csv = _with_columns(folder, _IMU), _with_columns(folder, _FRAMES)
    assert imu_csv is not None
    assert frames_csv is not None
    rows = read_logged_table(imu_csv).named(*_IMU)
    imu, imu_warnings = normalise_imu(
        Samples(rows[:, 0], rows[:, 4:7]), Samples(rows[:, 0], rows[:, 1:4]), ImuConvention(time_unit=_unit(imu_csv))
    )
    metadata = read_logged_table(frames_csv)
    logged, unit_warnings = frame_times_s(metadata.named("timestamp")[:, 0], _unit(frames_csv))
    times, source = logged, frames_csv.name
    exact = folder / "frame_timestamps.txt"
    if exact.is_file():
        times, source = frame_times_s(read_logged_table(exact).numbered(0)[:, 0], "ns")[0], exact.name
    timed = timed_video(require_video(folder, "movie"), times, source)
    order = np.argsort(logged)
    middles = (logged[order][1:] + logged[order][:-1]) / 2
    nearest = order[np.searchsorted(middles, timed.frames.times)]
    return Recording(
        timed.frames,
        imu=imu,
        frame_intrinsics=_intrinsics(metadata)[nearest],
        readout_s=_readout_s(metadata),
        warnings=(*unit_warnings, *timed.warnings, *imu_warnings),
    )


def _with_columns(folder: Path, names: tuple[str, ...]) -> Path | None:
    """The first CSV file of the folder, by name, with these columns; None if there is none."""
    return next((path for path in sorted(folder.glob("*.csv")) if has_columns(path, names)), None)


def _unit(path: Path) -> str:
    """Unit of times by the first line with ``Timestamp[…]``. Raises InvalidRecording if there is no such line, or the
    unit is neither seconds nor nanoseconds.
    """
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        stated = next((found[1] for line in file if (found := _STATED_UNIT.search(line.lower()))), None)
    if stated is None:
        raise InvalidRecording(f"{path.name} does not say the unit of its times.")
    if stated not in _UNITS:
        raise InvalidRecording(f"{path.name} has times in [{stated[:20]}]. Write them in [sec] or [nanosec].")
    return _UNITS[stated]


def _intrinsics(metadata: LoggedTable) -> FloatArray:
    """fx, fy, cx, cy (N, 4) [px] of each row; NaN where the app does not log them."""
    values = np.full((len(metadata), 4), np.nan)
    for place, name in enumerate(("fx", "fy", "cx", "cy")):
        if name in metadata.header:
            values[:, place] = metadata.named(name)[:, 0]
    values[~(values[:, 0] > 0)] = np.nan
    return values


def _readout_s(metadata: LoggedTable) -> float | None:
    """Median read-out time [s] of the frames; None if it is not logged, or not positive."""
    if _READOUT not in metadata.header:
        return None
    readout_s = float(np.median(metadata.named(_READOUT))) / 1e9
    return readout_s if readout_s > 0 else None
