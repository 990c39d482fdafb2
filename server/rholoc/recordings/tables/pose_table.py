"""``poses.txt``: poses that came with a recording, or a dataset's ground truth."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from rholoc.errors import InvalidTrajectory
from rholoc.geometry import FloatArray, IntArray, interpolated_poses, pose_matrix
from rholoc.recordings.recording import FrameSource, GivenPoses
from rholoc.recordings.tables.csv_table import read_text

_COLUMNS_HINT = "Each row is: frame or time, tx ty tz in metres, qx qy qz qw (T_map_camera)."
_NORM_TOLERANCE = 1e-2
_FARTHEST = 1e8  # the largest coordinate, in any unit; georeferenced metres stay below
_LONE_FRAME_TOLERANCE_S = 0.02


@dataclass(frozen=True, eq=False)
class PoseTable:
    """Poses by frame number or by time.

    Attributes:
        keys: (N,) float64, all different: frame numbers or seconds, see :meth:`keys_are_frames`.
        T_map_camera: (N, 4, 4).
    """

    keys: FloatArray
    T_map_camera: FloatArray

    def keys_are_frames(self, numbers: IntArray) -> bool:
        """Whether the keys are frame numbers: whole numbers that are all among ``numbers``, or include all of them."""
        if np.any(self.keys != np.floor(self.keys)):
            return False
        return bool(np.isin(self.keys, numbers).all() or np.isin(numbers, self.keys).all())


def read_pose_table(path: Path) -> PoseTable:
    """Read rows of ``frame-or-time tx ty tz qx qy qz qw``, separated by spaces or commas.

    ``#`` begins a comment; one header row is allowed. Quaternions are normalised.

    Raises:
        InvalidTrajectory: no rows, other than eight columns, a value that is not finite, a quaternion that is not of
            unit length, or a repeated frame or time.
    """
    rows: list[list[float]] = []
    for line, text in enumerate(read_text(path, InvalidTrajectory).splitlines(), start=1):
        parts = text.split("#", 1)[0].replace(",", " ").split()
        if not parts or (not rows and not _is_number(parts[0])):
            continue
        if len(parts) != 8 or not all(map(_is_number, parts)):
            raise InvalidTrajectory(f"{path.name}, line {line}: not eight finite numbers.", _COLUMNS_HINT)
        rows.append([float(part) for part in parts])
    if not rows:
        raise InvalidTrajectory(f"{path.name} has no poses.", _COLUMNS_HINT)
    table = np.array(rows)
    poses = poses_from_rows(table[:, 1:], path.name, _COLUMNS_HINT)
    if len(np.unique(table[:, 0])) < len(table):
        raise InvalidTrajectory(f"{path.name}: a frame or time occurs twice.")
    return PoseTable(table[:, 0], poses)


def poses_from_rows(rows: FloatArray, source: str, hint: str = "") -> FloatArray:
    """Rows (N, 7) of tx ty tz qx qy qz qw → poses (N, 4, 4); ``source`` is the table's name, ``hint`` the errors'.

    Raises:
        InvalidTrajectory: a quaternion's length is off by more than 1 %, or a coordinate is beyond 1e8.
    """
    q = rows[:, 3:].clip(-2, 2)  # squares of more may overflow, and are not of unit length either
    wrong = np.flatnonzero(~(np.abs(np.linalg.norm(q, axis=1) - 1) <= _NORM_TOLERANCE))  # NaN is wrong, too
    if len(wrong):
        raise InvalidTrajectory(f"{source}: the quaternion of pose {wrong[0] + 1} is not of unit length.", hint)
    far = np.flatnonzero(~(np.abs(rows[:, :3]).max(axis=1) <= _FARTHEST))
    if len(far):
        raise InvalidTrajectory(f"{source}: pose {far[0] + 1} is not finite, or implausibly far away.", hint)
    return pose_matrix(Rotation.from_quat(rows[:, 3:]).as_matrix(), rows[:, :3])


def match_poses(table: PoseTable, frames: FrameSource) -> GivenPoses:
    """Give each frame the pose with its number, or the pose at its time; NaN for frames without one.

    By time, a frame has a pose if the table has one within half a frame interval: interpolated between the poses before
    and after the frame if these are at most two frame intervals apart, else the nearest one.
    By number if the keys are frame numbers or the frames have no times.

    Raises:
        InvalidTrajectory: no pose belongs to a frame.
    """
    order = np.argsort(table.keys)
    keys = table.keys[order]
    by_number = table.keys_are_frames(frames.numbers) or not frames.timed
    wanted: FloatArray = frames.numbers.astype(np.float64) if by_number else frames.times
    tolerance = 0.0 if by_number else _half_interval(frames.times)
    after = np.searchsorted(keys, wanted).clip(0, len(keys) - 1)
    before = (after - 1).clip(0)
    nearest = np.where(np.abs(keys[before] - wanted) < np.abs(keys[after] - wanted), before, after)
    known = np.abs(keys[nearest] - wanted) <= tolerance
    if not known.any():
        raise InvalidTrajectory(
            f"No pose belongs to a frame: the table runs from {keys[0]:.12g} to {keys[-1]:.12g}.",
            f"Frames are {frames.numbers[0]}–{frames.numbers[-1]}"
            + (f", times {frames.times[0]:.12g}–{frames.times[-1]:.12g} s." if frames.timed else ", without times."),
        )
    T = table.T_map_camera[order][nearest]
    between = known & (keys[before] < wanted) & (wanted < keys[after]) & (keys[after] - keys[before] <= 4 * tolerance)
    if between.any():
        single, rows = np.unique(keys, return_index=True)
        T[between] = interpolated_poses(single, table.T_map_camera[order][rows], wanted[between])
    T[~known] = np.nan
    return GivenPoses(known, T)


def _half_interval(times: FloatArray) -> float:
    """Half the median interval of times (N,) [s]; ``_LONE_FRAME_TOLERANCE_S`` for one time."""
    return float(np.median(np.diff(times))) / 2 if len(times) > 1 else _LONE_FRAME_TOLERANCE_S


def _is_number(text: str) -> bool:
    """Whether a text is a finite number."""
    try:
        return bool(np.isfinite(float(text)))
    except ValueError:
        return False
