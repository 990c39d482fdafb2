"""TUM RGB-D, a dataset of a Kinect: lists separated by spaces, in seconds.

::

    rgb.txt             # timestamp filename
    groundtruth.txt     # timestamp tx ty tz qx qy qz qw     of the colour camera, z up
    depth.txt           # timestamp filename                of images that show what the colour image shows
    accelerometer.txt   # timestamp ax ay az                 ignored, since there is no gyroscope

Depth is in units of 1/5000 m; a frame has that of the nearest time. Intrinsics are not in the folder.
"""

from pathlib import Path

import numpy as np

from rholoc.errors import InvalidRecording
from rholoc.geometry import FloatArray
from rholoc.recordings.frames.depth import DepthImages
from rholoc.recordings.readers._frames import depth_images, listed_file, timed_images
from rholoc.recordings.recording import Recording
from rholoc.recordings.tables.logged_table import is_bare_table, read_logged_table
from rholoc.recordings.tables.pose_table import match_poses, read_pose_table
from rholoc.reports import RecordingWarning, WarningKind

TABLES = ("rgb.txt", "depth.txt", "groundtruth.txt", "accelerometer.txt", "depth/*")
_DEPTH_UNIT_M = 1 / 5000
_SAME_MOMENT_S = 0.02  # of a colour and a depth image


def recognises(folder: Path) -> bool:
    """Whether ``rgb.txt`` has two columns, the first of numbers; its header is a comment."""
    return is_bare_table(folder / "rgb.txt", 2)


def read(folder: Path) -> Recording:
    """Read a recording of this format from its folder: poses in metres and depth, if any; no intrinsics.

    Raises:
        InvalidRecording: the list or an image is missing or broken.
        InvalidTrajectory: the ground truth is broken.
    """
    taken, names = _list(folder / "rgb.txt")
    timed = timed_images([listed_file(folder, name) for name in names], taken)
    truth = folder / "groundtruth.txt"
    warnings = list(timed.warnings)
    if (folder / "accelerometer.txt").is_file():
        text = "accelerometer.txt is ignored: without a gyroscope it is of little use."
        warnings.append(RecordingWarning(WarningKind.NOT_USED, text))
    return Recording(
        timed.frames,
        poses=match_poses(read_pose_table(truth), timed.frames) if truth.is_file() else None,
        depth=_depth(folder, timed.frames.times),
        warnings=tuple(warnings),
    )


def _list(path: Path) -> tuple[FloatArray, list[str]]:
    """The times (M,) in seconds and the names of listed images. Raises InvalidRecording: the list is broken."""
    table = read_logged_table(path)
    if table.columns != 2:
        raise InvalidRecording(f"{path.name} has {table.columns} columns.", "Each row is a time and an image's name.")
    return table.numbered(0)[:, 0], [name for _, name in table.rows]


def _depth(folder: Path, times: FloatArray) -> DepthImages | None:
    """For each frame, at times (N,) [s], the depth image nearest in time, if within 20 ms; None without a list of them.
    Raises InvalidRecording: the list is broken.
    """
    if not (folder / "depth.txt").is_file():
        return None
    taken, names = _list(folder / "depth.txt")
    nearest = np.abs(taken - times[:, None]).argmin(axis=1)
    paths = [
        listed_file(folder, names[row]) if abs(taken[row] - time) <= _SAME_MOMENT_S else None
        for row, time in zip(nearest.tolist(), times.tolist(), strict=True)
    ]
    return depth_images(paths, _DEPTH_UNIT_M)
