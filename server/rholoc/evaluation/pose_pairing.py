"""Pair estimated poses with true ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rholoc.errors import InvalidTrajectory
from rholoc.geometry import BoolArray, FloatArray, IntArray

MATCH_TOLERANCE_S = 0.01
"""Poses belong together by time when their times differ by no more than this."""


@dataclass(frozen=True, eq=False)
class FramePoses:
    """Poses of N frames from a trajectory file or a table of true poses.

    Attributes:
        T_map_camera: (N, 4, 4), NaN where a frame has no pose.
        frames: (N,) int64, the frames' numbers, or None where the file has none.
        times: (N,) float64 seconds, or None where the file has none.
    """

    T_map_camera: FloatArray
    frames: IntArray | None = None
    times: FloatArray | None = None

    def __len__(self) -> int:
        return len(self.T_map_camera)

    def known(self) -> FramePoses:
        """Only the frames that have a pose."""
        rows = np.isfinite(self.T_map_camera).all(axis=(1, 2))
        return FramePoses(
            self.T_map_camera[rows],
            None if self.frames is None else self.frames[rows],
            None if self.times is None else self.times[rows],
        )


@dataclass(frozen=True, eq=False)
class PosePairs:
    """N frames with their estimated and true poses.

    Attributes:
        estimated: (N, 4, 4) T_map_camera, NaN where the frame has no pose.
        truth: (N, 4, 4) T_map_camera, all known.
        without_truth: number of estimated frames left out because their truth is unknown.
        by_time: whether frames were paired by time; frames without a pose are then missing.
        beyond: number of frames before the first or after the last estimated pose.
    """

    estimated: FloatArray
    truth: FloatArray
    without_truth: int
    by_time: bool
    beyond: int = 0

    def __len__(self) -> int:
        return len(self.truth)


def pair_poses(estimated: FramePoses, truth: FramePoses, frames: slice | None = None) -> PosePairs:
    """Pair poses by frame number if both tables have numbers, else by time.

    By number, every frame with a true pose (in ``frames``, if given) is paired; where ``estimated`` lacks it, its
    estimated pose is NaN. By time, only estimated poses within ``MATCH_TOLERANCE_S`` of a true one are paired, so
    failures do not show.

    Raises:
        InvalidTrajectory: the tables share neither frame numbers nor times, ``frames`` is given without numbers, or
            there is nothing to pair.
    """
    truth = truth.known()
    if estimated.frames is not None and truth.frames is not None:
        pairs = _pair_by_frame(estimated, truth, frames)
    elif frames is not None:
        raise InvalidTrajectory(
            "A range of frames was requested, but one of the files has no frame numbers.",
            "Leave the range out, or add a frame column.",
        )
    elif estimated.times is not None and truth.times is not None:
        pairs = _pair_by_time(estimated, truth)
    else:
        raise InvalidTrajectory(
            "One file has frame numbers only, the other times only.", "Give both files the same kind of first column."
        )
    if len(pairs) == 0:
        raise InvalidTrajectory(
            "No frame of the trajectory has a true pose.", "Check that both files are of the same recording."
        )
    return pairs


def in_range(numbers: IntArray, frames: slice) -> BoolArray:
    """Mask (N,) of increasing frame numbers (N,) in a slice, whose step counts from its start or the first number."""
    start = (numbers[0] if len(numbers) else 0) if frames.start is None else frames.start
    stop = np.inf if frames.stop is None else frames.stop
    return np.asarray((numbers >= start) & (numbers < stop) & ((numbers - start) % (frames.step or 1) == 0))


def _pair_by_frame(estimated: FramePoses, truth: FramePoses, frames: slice | None) -> PosePairs:
    """Pairs of all true frames in ``frames``, by their numbers; NaN where there is no estimate."""
    assert estimated.frames is not None
    assert truth.frames is not None
    frames = frames or slice(None)
    asked = estimated.frames[in_range(estimated.frames, frames)]
    chosen = in_range(truth.frames, frames)
    T_estimated = np.full((int(chosen.sum()), 4, 4), np.nan)
    row_of = {int(number): row for row, number in enumerate(estimated.frames)}
    for place, number in enumerate(truth.frames[chosen]):
        if int(number) in row_of:
            T_estimated[place] = estimated.T_map_camera[row_of[int(number)]]
    without_truth = int((~np.isin(asked, truth.frames)).sum())
    numbers = truth.frames[chosen]
    beyond = int(((numbers < asked.min()) | (numbers > asked.max())).sum()) if len(asked) else 0
    return PosePairs(T_estimated, truth.T_map_camera[chosen], without_truth, by_time=False, beyond=beyond)


def _pair_by_time(estimated: FramePoses, truth: FramePoses) -> PosePairs:
    """Pairs of the estimates within ``MATCH_TOLERANCE_S`` of a true pose, each with the nearest one."""
    assert estimated.times is not None
    assert truth.times is not None
    if len(truth) == 0:
        return PosePairs(np.zeros((0, 4, 4)), truth.T_map_camera, len(estimated), by_time=True)
    nearest = np.abs(estimated.times[:, None] - truth.times[None]).argmin(axis=1)
    matched = np.abs(estimated.times - truth.times[nearest]) <= MATCH_TOLERANCE_S
    return PosePairs(
        estimated.T_map_camera[matched], truth.T_map_camera[nearest[matched]], int((~matched).sum()), by_time=True
    )
