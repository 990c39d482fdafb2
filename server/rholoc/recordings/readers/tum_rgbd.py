"""TUM RGB-D, a dataset of a Kinect: lists with blanks between, in seconds.

::

    rgb.txt             # timestamp filename
    groundtruth.txt     # timestamp tx ty tz qx qy qz qw     of the colour camera, z up
    accelerometer.txt   # timestamp ax ay az                 no gyroscope comes with it: left aside

Depth is left aside. Intrinsics are not in the folder.
"""

from __future__ import annotations

from pathlib import Path

from rholoc.recordings.readers._frames import listed_file, timed_images
from rholoc.recordings.recording import Recording, RecordingFormat
from rholoc.recordings.tables.logged_table import is_bare_table, read_logged_table
from rholoc.recordings.tables.pose_table import match_poses, read_pose_table
from rholoc.reports import RecordingWarning, WarningKind


def recognises(folder: Path) -> bool:
    """Whether there is a list of colour images with this dataset's name and columns; its header is a comment."""
    return is_bare_table(folder / "rgb.txt", 2)


def read(folder: Path) -> Recording:
    """Read the folder.

    Raises:
        InvalidRecording: the list or an image is missing or broken.
        InvalidTrajectory: the ground truth is broken.
    """
    table = read_logged_table(folder / "rgb.txt")
    timed = timed_images([listed_file(folder, name) for _, name in table.rows], table.numbered(0)[:, 0])
    truth = folder / "groundtruth.txt"
    warnings = list(timed.warnings)
    if (folder / "accelerometer.txt").is_file():
        text = "accelerometer.txt is left aside: without a gyroscope it says little."
        warnings.append(RecordingWarning(WarningKind.NOT_USED, text))
    return Recording(
        name=folder.resolve().name,
        path=folder,
        frames=timed.frames,
        poses=match_poses(read_pose_table(truth), timed.frames) if truth.is_file() else None,
        format=RecordingFormat.TUM_RGBD,
        warnings=tuple(warnings),
    )
