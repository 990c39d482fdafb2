"""Which estimated pose is compared with which true one."""

from __future__ import annotations

import numpy as np
import pytest

from rholoc.errors import InvalidTrajectory
from rholoc.evaluation import FramePoses, in_range, pair_poses
from rholoc.geometry import FloatArray


def poses_at(xs: list[float]) -> FloatArray:
    T = np.tile(np.eye(4), (len(xs), 1, 1))
    T[:, 0, 3] = xs
    T[np.isnan(xs)] = np.nan
    return T


TRUTH = FramePoses(poses_at([0, 1, 2, 3, 4, 5]), np.array([10, 11, 12, 13, 14, 15]), np.arange(6) / 10)


def test_frames_are_paired_by_number_whatever_their_order() -> None:
    pairs = pair_poses(FramePoses(poses_at([3.5, 1.5]), np.array([13, 11])), TRUTH, slice(11, 14, 2))
    np.testing.assert_array_equal(pairs.truth[:, 0, 3], [1, 3])
    np.testing.assert_array_equal(pairs.estimated[:, 0, 3], [1.5, 3.5])


def test_without_a_range_every_true_frame_counts() -> None:
    pairs = pair_poses(FramePoses(poses_at([1]), np.array([11])), TRUTH)
    assert len(pairs) == 6
    assert not pairs.by_time


def test_a_range_counts_frames_that_the_trajectory_leaves_out() -> None:
    pairs = pair_poses(FramePoses(poses_at([1.5]), np.array([11])), TRUTH, slice(10, 14))
    assert len(pairs) == 4
    assert np.isfinite(pairs.estimated[:, 0, 3]).sum() == 1


def test_a_range_leaves_out_what_lies_outside() -> None:
    pairs = pair_poses(FramePoses(poses_at([0, 5]), np.array([10, 15])), TRUTH, slice(14, None))
    np.testing.assert_array_equal(pairs.truth[:, 0, 3], [4, 5])


def test_a_frame_that_failed_stays_a_failure() -> None:
    pairs = pair_poses(FramePoses(poses_at([np.nan, 1]), np.array([10, 11])), TRUTH, slice(10, 12))
    assert len(pairs) == 2
    assert np.isnan(pairs.estimated[0]).all()


def test_frames_whose_truth_is_unknown_are_left_out_and_counted() -> None:
    truth = FramePoses(poses_at([0, np.nan, 2]), np.array([0, 1, 2]))
    pairs = pair_poses(FramePoses(poses_at([0, 1, 2, 3]), np.array([0, 1, 2, 99])), truth)
    assert len(pairs) == 2
    assert pairs.without_truth == 2


def test_times_pair_where_a_file_has_no_frame_numbers() -> None:
    estimated = FramePoses(poses_at([2.5, 9]), None, np.array([0.203, 0.25]))
    pairs = pair_poses(estimated, TRUTH)
    np.testing.assert_array_equal(pairs.truth[:, 0, 3], [2])
    assert pairs.without_truth == 1
    assert pairs.by_time


@pytest.mark.parametrize(
    ("estimated", "frames"),
    [
        (FramePoses(poses_at([0]), np.array([99])), slice(50, 120)),  # no such frames
        (FramePoses(poses_at([0]), None, np.array([0.0])), slice(0, 5)),  # a range, but no frame numbers
        (FramePoses(poses_at([0])), None),  # neither frames nor times
    ],
)
def test_what_cannot_be_paired_is_an_error(estimated: FramePoses, frames: slice | None) -> None:
    with pytest.raises(InvalidTrajectory):
        pair_poses(estimated, TRUTH, frames)


def test_ranges_are_pythons() -> None:
    numbers = np.arange(20)
    for chosen in (slice(3, 9), slice(3, 17, 4), slice(None, 5), slice(7, None, 3), slice(None, None, 2)):
        np.testing.assert_array_equal(np.flatnonzero(in_range(numbers, chosen)), numbers[chosen])
