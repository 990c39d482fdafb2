"""Read tables of poses: ``poses.txt`` and Table 6."""

from pathlib import Path

import numpy as np

from rholoc.errors import InvalidTrajectory
from rholoc.evaluation.pose_pairing import FramePoses
from rholoc.maps import read_trajectory_csv
from rholoc.recordings import read_pose_table

_LARGEST_KEY = 2.0**63


def read_frame_poses(path: Path) -> FramePoses:
    """Read Table 6 (CSV with the column ``timestamp``), without frame numbers if one is negative; or ``poses.txt``.

    The keys of ``poses.txt`` are frame numbers if all of them are whole, else times [s].

    Raises:
        InvalidTrajectory: the file is neither, or is broken.
    """
    if _is_table_6(path):
        table = read_trajectory_csv(path)
        numbered = bool(len(table)) and bool(np.all(table.frames >= 0))
        return FramePoses(table.T_map_camera, table.frames if numbered else None, table.times)
    poses = read_pose_table(path)
    if np.abs(poses.keys).max() >= _LARGEST_KEY:
        raise InvalidTrajectory(
            f"{path.name}: {np.abs(poses.keys).max():g} is too large for a frame number or a time.",
            "Each row begins with a frame number, or with a time in seconds.",
        )
    if np.all(poses.keys == np.floor(poses.keys)):
        return FramePoses(poses.T_map_camera, frames=poses.keys.astype(np.int64))
    return FramePoses(poses.T_map_camera, times=poses.keys)


def _is_table_6(path: Path) -> bool:
    """Whether the first column of a file is called ``timestamp``. Raises InvalidTrajectory if it cannot be read."""
    try:
        with path.open(encoding="utf-8-sig", errors="replace") as file:
            return file.readline().lower().startswith("timestamp,")
    except OSError as error:
        raise InvalidTrajectory(f"{path} cannot be read: {error.strerror}.", "Check the path.") from error
