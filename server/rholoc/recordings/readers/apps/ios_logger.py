"""ios_logger (iOS): tables without headers, seconds since 1970.

::

    Frames.m4v    the video, as ARKit has images: on their side
    Frames.txt    time, frame[, fx, fy, cx, cy]                        row i is frame i
    ARposes.txt   time, x, y, z, qw, qx, qy, qz                        ARKit's: y up, looking along −z
    MotARH.txt    time, rotation rate, gravity, user acceleration, …   rad/s, g, g, Apple's sign
    Gyro.txt      time, x, y, z                                        rad/s
    Accel.txt     time, x, y, z                                        g, gravity included, Apple's sign

MotARH.txt is preferred: Apple's fusion has the gyroscope's bias out of it, and one clock for both sensors.
"""

from pathlib import Path

from rholoc.geometry import FloatArray
from rholoc.recordings.frames.memory_frames import MissingImages
from rholoc.recordings.imu_normalisation import (
    ImuConvention,
    Samples,
    advancing_rows,
    frame_times_s,
    normalise_imu,
    with_sign_by_poses,
)
from rholoc.recordings.readers._apple import R_LANDSCAPE_CAMERA_IMU, read_arkit_poses
from rholoc.recordings.readers._frames import TimedFrames, find_video, timed_video
from rholoc.recordings.recording import Imu, Recording
from rholoc.recordings.tables.logged_table import is_bare_table, read_logged_table
from rholoc.reports import RecordingWarning, WarningKind

TABLES = ("frames.txt", "arposes.txt", "motarh.txt", "gyro.txt", "accel.txt")


def recognises(folder: Path) -> bool:
    """Whether ``Frames.txt`` has 2 or 6 columns, and ``MotARH.txt`` 11, or ``Accel.txt`` and ``Gyro.txt`` 4 each."""
    frames = folder / "Frames.txt"
    imu = is_bare_table(folder / "MotARH.txt", 11) or (
        is_bare_table(folder / "Accel.txt", 4) and is_bare_table(folder / "Gyro.txt", 4)
    )
    return imu and (is_bare_table(frames, 2) or is_bare_table(frames, 6))


def read(folder: Path) -> Recording:
    """Read a recording of this format from its folder; without its video it has times of frames, and no images.

    Raises:
        InvalidRecording: a table or the video is broken, or they contradict each other.
        InvalidTrajectory: the poses are broken.
    """
    table = read_logged_table(folder / "Frames.txt")
    times, unit_warnings = frame_times_s(table.numbered(0)[:, 0], "s")
    timed = _frames(folder, times)
    intrinsics = table.numbered(2, 3, 4, 5)[timed.rows] if table.columns == 6 else None
    poses = read_arkit_poses(folder / "ARposes.txt", timed.frames)
    imu, imu_warnings = _imu(folder)
    imu, sign_warnings = with_sign_by_poses(imu, timed.frames.times, poses)
    return Recording(
        timed.frames,
        imu=imu,
        poses=poses,
        frame_intrinsics=intrinsics,
        warnings=(*unit_warnings, *timed.warnings, *imu_warnings, *sign_warnings),
    )


def _frames(folder: Path, times: FloatArray) -> TimedFrames:
    """Frames of the video; without one their times alone, with a warning."""
    video = find_video(folder, "frames")
    if video is not None:
        return timed_video(video, times, "Frames.txt")
    rows, found = advancing_rows(times, "frames")
    warning = RecordingWarning(WarningKind.NO_IMAGES, "There is no video: no map can be built from this.")
    return TimedFrames(MissingImages(times[rows], rows), rows, (warning, *found))


def _imu(folder: Path) -> tuple[Imu, tuple[RecordingWarning, ...]]:
    """The IMU by ``MotARH.txt``, else by ``Accel.txt`` and ``Gyro.txt``, and warnings. Raises InvalidRecording."""
    fused = folder / "MotARH.txt"
    says = ImuConvention(in_g=True, apple_sign=True)
    if fused.is_file():
        rows = read_logged_table(fused).numbered(*range(10))
        accelerometer = Samples(rows[:, 0], rows[:, 4:7] + rows[:, 7:10])
        gyroscope = Samples.from_rows(rows[:, :4])
    else:
        accelerometer, gyroscope = (
            Samples.from_rows(read_logged_table(folder / name).numbered(0, 1, 2, 3))
            for name in ("Accel.txt", "Gyro.txt")
        )
    return normalise_imu(accelerometer, gyroscope, says, R_LANDSCAPE_CAMERA_IMU)
