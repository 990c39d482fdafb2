"""OpenCamera Sensors (Android): tables without headers, all in nanoseconds of one clock.

::

    NAME.mp4                   here, or beside the folder of the tables
    NAME_accel.csv             x, y, z, time      m/s², gravity included
    NAME_gyro.csv              x, y, z, time      rad/s
    NAME_timestamps.csv        time               row i is frame i; older: NAME_imu_timestamps.csv
"""

from pathlib import Path

from rholoc.errors import InvalidRecording
from rholoc.recordings.imu_normalisation import ImuConvention, Samples, frame_times_s, normalise_imu
from rholoc.recordings.readers._frames import find_video, require_video, timed_video
from rholoc.recordings.recording import Recording
from rholoc.recordings.tables.logged_table import is_bare_table, read_logged_table

TABLES = ("*_gyro.csv", "*_accel.csv", "*_timestamps.csv")
_GYROSCOPE, _ACCELEROMETER = "_gyro.csv", "_accel.csv"
_TIMES, _OLDER_TIMES = "_timestamps.csv", "_imu_timestamps.csv"


def recognises(folder: Path) -> bool:
    """Whether there are tables of a gyroscope and, beside it, an accelerometer, by name, with four columns each."""
    gyroscope = _find(folder, _GYROSCOPE)
    if gyroscope is None:
        return False
    accelerometer = _sibling(gyroscope, _ACCELEROMETER)
    return is_bare_table(gyroscope, 4) and is_bare_table(accelerometer, 4)


def read(folder: Path) -> Recording:
    """Read a recording of this format from its folder.

    Raises:
        InvalidRecording: a table or the video is missing or broken, or they contradict each other.
    """
    gyroscope = _find(folder, _GYROSCOPE)
    assert gyroscope is not None
    times_csv = _times_csv(gyroscope)
    if times_csv is None:
        raise InvalidRecording(f"There is no table of the frames' times, *{_TIMES}.", "Pack all that the app wrote.")
    times, unit_warnings = frame_times_s(read_logged_table(times_csv).numbered(0)[:, 0], "ns")
    name = gyroscope.name.removesuffix(_GYROSCOPE).lower()
    video = find_video(gyroscope.parent, name) or require_video(folder, name)
    timed = timed_video(video, times, times_csv.name)
    acceleration = Samples.from_rows(read_logged_table(_sibling(gyroscope, _ACCELEROMETER)).numbered(3, 0, 1, 2))
    rate = Samples.from_rows(read_logged_table(gyroscope).numbered(3, 0, 1, 2))
    imu, imu_warnings = normalise_imu(acceleration, rate, ImuConvention(time_unit="ns"))
    return Recording(
        timed.frames,
        imu=imu,
        warnings=(*unit_warnings, *timed.warnings, *imu_warnings),
    )


def _find(folder: Path, ending: str) -> Path | None:
    """The first file with such an ending, by name, in the folder, else in one of its folders; None if there is none."""
    return next(iter([*sorted(folder.glob(f"*{ending}")), *sorted(folder.glob(f"*/*{ending}"))]), None)


def _times_csv(gyroscope: Path) -> Path | None:
    """The gyroscope's table of the frames' times, else the first of its folder; None if there is none."""
    named = (_sibling(gyroscope, ending) for ending in (_TIMES, _OLDER_TIMES))
    return next((path for path in named if path.is_file()), None) or _find(gyroscope.parent, _TIMES)


def _sibling(gyroscope: Path, ending: str) -> Path:
    """Path of the table beside the gyroscope's with another ending."""
    return gyroscope.with_name(gyroscope.name.removesuffix(_GYROSCOPE) + ending)
