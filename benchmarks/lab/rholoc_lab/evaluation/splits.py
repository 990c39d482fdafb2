"""Split a posed recording into frames for the map and frames for queries."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rholoc.errors import InvalidRecording
from rholoc.evaluation.pose_pairing import FramePoses, in_range
from rholoc.evaluation.reading import read_frame_poses
from rholoc.geometry import FloatArray, IntArray
from rholoc.recordings import GivenPoses, Recording, parse_frame_slice
from rholoc.recordings.frame_slice import SelectedFrames

_BLOCKS = 25
_HELD_OUT_OF = 5
TRUTH_FILE = "truth.csv"


@dataclass(frozen=True, eq=False)
class QuerySet:
    """Frames to localize, with known truth.

    Attributes:
        label: their name in tables.
        recording: the recording that they are frames of.
        rows: (N,) its frames.
    """

    label: str
    recording: Recording
    rows: IntArray

    @property
    def truth(self) -> FloatArray:
        """(N, 4, 4) T_map_camera."""
        assert self.recording.poses is not None
        return self.recording.poses.T_map_camera[self.rows]

    def every(self, step: int) -> QuerySet:
        """Only each ``step``-th of them."""
        return replace(self, rows=self.rows[::step])


def with_poses(recording: Recording, use_truth: bool) -> Recording:
    """The recording with its poses; if it has none and ``use_truth``, with those of ``truth.csv``.

    Raises:
        InvalidRecording: there are no poses.
        InvalidTrajectory: ``truth.csv`` is broken.
    """
    if recording.poses is None and use_truth:
        recording = replace(recording, poses=_true_poses(recording))
    if recording.poses is None:
        raise InvalidRecording(
            f"{recording.name} has no poses to compare with.",
            f"Put poses.txt beside its frames, or take a simulated recording's {TRUTH_FILE} with --truth.",
        )
    return replace(recording, waypoints=())


def poses_or_truth(recording: Recording) -> GivenPoses | None:
    """The recording's poses, or those of its ``truth.csv``; None where it has neither.

    Raises:
        InvalidTrajectory: ``truth.csv`` is broken.
    """
    has_truth = (recording.path / TRUTH_FILE).is_file()
    return _true_poses(recording) if recording.poses is None and has_truth else recording.poses


def choose_rows(recording: Recording, frames: str | None) -> IntArray:
    """The posed frames, or those whose numbers are in ``start:stop[:step]``: rows (N,).

    Raises:
        InvalidRecording: the text is no slice, or no posed frame is in it.
    """
    assert recording.poses is not None
    chosen = np.asarray(recording.poses.known)
    if frames is not None:
        chosen = chosen & in_range(recording.frames.numbers, parse_frame_slice(frames))
    if not chosen.any():
        raise InvalidRecording(f"{recording.name} has no posed frames {frames or ''}.", "Choose other frames.")
    return np.flatnonzero(chosen)


def hold_out_blocks(rows: IntArray) -> tuple[IntArray, IntArray]:
    """Rows for the map, and rows held out: of 25 consecutive blocks, the middle one of every five.

    Neighbouring frames look alike; holding out whole blocks keeps similar frames out of the map too.
    """
    block = np.arange(len(rows)) * _BLOCKS // max(len(rows), 1)
    held_out = block % _HELD_OUT_OF == _HELD_OUT_OF // 2
    return rows[~held_out], rows[held_out]


def take_rows(recording: Recording, rows: IntArray) -> Recording:
    """The recording with only the frames ``rows`` (N,), which increase, and their poses."""
    poses = recording.poses
    return replace(
        recording,
        frames=SelectedFrames(recording.frames, rows),
        poses=None if poses is None else GivenPoses(poses.known[rows], poses.T_map_camera[rows]),
    )


def _true_poses(recording: Recording) -> GivenPoses:
    path = recording.path / TRUTH_FILE
    if not path.is_file():
        raise InvalidRecording(f"{recording.name} has no {TRUTH_FILE}.", "Only simulated recordings have one.")
    return _as_given(read_frame_poses(path).known(), recording)


def _as_given(truth: FramePoses, recording: Recording) -> GivenPoses:
    numbers = recording.frames.numbers
    T = np.full((len(numbers), 4, 4), np.nan)
    if truth.frames is None:
        raise InvalidRecording(f"{recording.name}'s {TRUTH_FILE} has no frame numbers.", "Add a column 'frame'.")
    row_of = {int(number): row for row, number in enumerate(numbers)}
    for number, pose in zip(truth.frames, truth.T_map_camera, strict=True):
        if int(number) in row_of:
            T[row_of[int(number)]] = pose
    return GivenPoses(np.isfinite(T).all(axis=(1, 2)), T)
