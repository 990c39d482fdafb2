"""A video beside tables of nanoseconds, as several Android recorders write them.

::

    video.mp4            or the images that frames.csv names
    frames.csv           timestamp_ns,filename      row i is frame i
    accelerometer.csv    timestamp_ns,ax,ay,az      m/s², gravity included
    gyroscope.csv        timestamp_ns,gx,gy,gz      rad/s
"""

from pathlib import Path

from rholoc.recordings.imu_normalisation import ImuConvention, Samples, frame_times_s, normalise_imu
from rholoc.recordings.readers._frames import find_video, listed_file, timed_images, timed_video
from rholoc.recordings.recording import Recording
from rholoc.recordings.tables.logged_table import has_columns, read_logged_table

TABLES = ("frames.csv", "accelerometer.csv", "gyroscope.csv")
_ACCELEROMETER = ("timestamp_ns", "ax", "ay", "az")
_GYROSCOPE = ("timestamp_ns", "gx", "gy", "gz")
_FRAMES = ("timestamp_ns", "filename")


def recognises(folder: Path) -> bool:
    """Whether ``frames.csv``, ``accelerometer.csv`` and ``gyroscope.csv`` have this format's columns."""
    return (
        has_columns(folder / "frames.csv", _FRAMES)
        and has_columns(folder / "accelerometer.csv", _ACCELEROMETER)
        and has_columns(folder / "gyroscope.csv", _GYROSCOPE)
    )


def read(folder: Path) -> Recording:
    """Read a recording of this format from its folder.

    Raises:
        InvalidRecording: a table or the video is broken, or they contradict each other.
    """
    table = read_logged_table(folder / "frames.csv")
    times, unit_warnings = frame_times_s(table.named("timestamp_ns")[:, 0], "ns")
    video = find_video(folder)
    if video is not None:
        timed = timed_video(video, times, "frames.csv")
    else:
        timed = timed_images([listed_file(folder, name) for name in table.text("filename")], times)
    accelerometer = Samples.from_rows(read_logged_table(folder / "accelerometer.csv").named(*_ACCELEROMETER))
    gyroscope = Samples.from_rows(read_logged_table(folder / "gyroscope.csv").named(*_GYROSCOPE))
    imu, imu_warnings = normalise_imu(accelerometer, gyroscope, ImuConvention(time_unit="ns"))
    return Recording(
        timed.frames,
        imu=imu,
        warnings=(*unit_warnings, *timed.warnings, *imu_warnings),
    )
