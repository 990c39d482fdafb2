"""Recordings split into map and queries."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rholoc.errors import InvalidRecording
from rholoc.maps import TrajectoryTable, write_trajectory_csv
from rholoc_lab.evaluation.splits import choose_rows, hold_out_blocks, take_rows, with_poses


@pytest.mark.parametrize("count", [5, 26, 100, 601])
def test_every_fifth_block_is_held_out(count: int) -> None:
    rows = np.arange(count) + 7
    mapped, held_out = hold_out_blocks(rows)
    assert sorted([*mapped, *held_out]) == rows.tolist()
    assert len(held_out) == pytest.approx(count / 5, abs=max(5, count / 50))
    if count >= 100:
        assert (np.diff(held_out) > 1).sum() == 4  # five blocks
        assert mapped[0] == rows[0]
        assert mapped[-1] == rows[-1]


def test_frames_are_chosen_by_number_where_they_have_poses(wall: Any) -> None:
    recording = wall.walk(20)
    recording.poses.known[3] = False
    assert choose_rows(recording, "2:6").tolist() == [2, 4, 5]
    assert take_rows(recording, np.array([4, 9])).frames.numbers.tolist() == [4, 9]
    with pytest.raises(InvalidRecording, match="no posed frames"):
        choose_rows(recording, "50:60")


def test_a_recording_without_poses_says_what_to_do(wall: Any) -> None:
    with pytest.raises(InvalidRecording, match="no poses") as caught:
        with_poses(replace(wall.walk(3), poses=None), use_truth=False)
    assert "--truth" in caught.value.hint


def test_truth_gives_the_frames_that_it_lists_their_poses(wall: Any, tmp_path: Path) -> None:
    recording = replace(wall.walk(6), path=tmp_path)
    rows, T = np.array([0, 2, 5]), recording.poses.T_map_camera
    table = TrajectoryTable(rows / 10, rows, T[rows], np.ones(3), np.zeros(3, dtype=np.int64))
    with pytest.raises(InvalidRecording, match=r"truth\.csv"):
        with_poses(replace(recording, poses=None), use_truth=True)
    write_trajectory_csv(tmp_path / "truth.csv", table)
    poses = with_poses(replace(recording, poses=None), use_truth=True).poses
    assert poses is not None
    assert np.flatnonzero(poses.known).tolist() == rows.tolist()
    np.testing.assert_allclose(poses.T_map_camera[rows], T[rows], atol=1e-4)
    # poses that a recording brings itself stand
    assert with_poses(recording, use_truth=True).poses is recording.poses
