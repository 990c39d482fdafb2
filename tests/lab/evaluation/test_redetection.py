"""Repeatability and precision, where they are known."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from rholoc.errors import InvalidInput, InvalidRecording
from rholoc.evaluation.errors import trajectory_errors
from rholoc.features import FeatureSet, Metric, extractor_names, get_extractor
from rholoc.geometry import Camera, FloatArray, Pose
from rholoc.localization.index.matches import Matches
from rholoc.maps import TrajectoryTable, write_trajectory_csv
from rholoc_lab.evaluation.lighting_pairs import compare_lighting_pairs, stereo_counts
from rholoc_lab.evaluation.pnp_baselines import MatchSet, Solver, distinct, solve
from rholoc_lab.evaluation.redetection import Redetection, redetection
from rholoc_lab.evaluation.splits import choose_rows, hold_out_blocks, take_rows, with_poses


def features(pixels: np.ndarray, descriptors: np.ndarray, channels: np.ndarray | int = 0) -> FeatureSet:
    n = len(pixels)
    zeros = np.zeros(n, np.float32)
    return FeatureSet(
        np.asarray(pixels, np.float32), np.full(n, channels, np.uint8) if np.isscalar(channels) else channels,
        descriptors, zeros, zeros,
    )  # fmt: skip


@pytest.fixture
def descriptors() -> np.ndarray:
    return np.random.default_rng(0).integers(0, 256, (5, 32), dtype=np.uint8)


def test_features_are_redetected_within_three_pixels_in_their_channel(descriptors: np.ndarray) -> None:
    a = features(np.array([[10, 10], [50, 50], [90, 90], [130, 130], [170, 170]]), descriptors)
    offsets = np.array([[0, 0], [2, 2], [3, 3], [0, 0], [0, 0]])  # the third is 4.2 px off
    channels = np.array([0, 0, 0, 1, 0], np.uint8)  # the fourth is of another channel
    where = np.asarray(a.pixels, np.float64).copy()
    where[4] = np.nan  # the fifth is hidden
    counts = redetection(a, features(a.pixels + offsets, descriptors, channels), where, Metric.HAMMING)
    # the fourth has no likeness in its channel that is mutual; the fifth matches, but cannot be right
    assert counts == Redetection(visible=4, redetected=2, matches=4, right=2)
    assert counts.repeatability == 0.5
    assert counts.precision == 0.5


def test_nothing_visible_has_no_share(descriptors: np.ndarray) -> None:
    a = features(np.zeros((5, 2)), descriptors)
    counts = redetection(a, FeatureSet.empty(32), np.full((5, 2), np.nan), Metric.HAMMING)
    assert counts == Redetection(0, 0, 0, 0)
    assert counts.figures() == {"repeatability": None, "precision": None, "right_matches": 0}


def test_totals_are_sums() -> None:
    assert Redetection.total([Redetection(4, 3, 2, 1), Redetection(6, 2, 3, 3)]) == Redetection(10, 5, 5, 4)


def test_a_stereo_match_lies_on_the_row_at_a_possible_disparity(descriptors: np.ndarray) -> None:
    left = features(np.array([[100, 10], [100, 50], [100, 90], [100, 130], [100, 170]]), descriptors)
    right = features(left.pixels - [[20, 0], [0, 0.5], [64, 0], [65, 0], [-3, 0]], descriptors)
    assert stereo_counts(left, right, get_extractor("gray"), max_disparity_px=64) == (5, 3)
    off_row = features(left.pixels - [[20, 1.5]], descriptors)
    assert stereo_counts(left, off_row, get_extractor("gray"), max_disparity_px=64) == (5, 0)


def write_scene(folder: Path, stereo: bool) -> None:
    image = np.random.default_rng(1).integers(0, 256, (60, 80, 3), dtype=np.uint8)
    image = cv2.resize(image, (320, 240), interpolation=cv2.INTER_NEAREST)
    folder.mkdir()
    cv2.imwrite(str(folder / "right_changed.png"), image)
    cv2.imwrite(str(folder / "left_default.png" if stereo else folder / "right_default.png"), image)


@pytest.mark.slow
def test_every_extractor_is_compared_on_every_scene(tmp_path: Path) -> None:
    write_scene(tmp_path / "a", stereo=False)
    write_scene(tmp_path / "b", stereo=True)
    (tmp_path / "b" / "calib.txt").write_text("baseline=100\n ndisp= 64 \n")
    found = compare_lighting_pairs(tmp_path)
    assert [(pair.scene, pair.features) for pair in found] == [(s, n) for s in "ab" for n in extractor_names()]
    for pair in found:
        if pair.scene == "a":  # the same picture twice
            assert pair.registered.repeatability == 1
            assert pair.registered.precision == pytest.approx(1, abs=0.02)  # but for features that look alike
            assert pair.stereo_precision is None
        else:
            assert pair.registered is None
            assert pair.stereo_precision == pytest.approx(1, abs=0.02)


def test_a_folder_without_scenes_or_calibration_is_reported(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="no lighting pairs"):
        compare_lighting_pairs(tmp_path)
    write_scene(tmp_path / "b", stereo=True)
    with pytest.raises(InvalidInput, match=r"calib\.txt"):
        compare_lighting_pairs(tmp_path, ["gray"])


CAMERA = Camera(640, 480, 520.0, 510.0, 318.0, 242.0, (-0.1, 0.02, 0.001, -0.002))
POSE = Pose.from_heading(np.array([1.0, -2.0, 1.5]), np.array([0.6, 0.8, -0.1]), roll=0.2)


def scene(wrong: int, noise_px: float = 0.3) -> tuple[FloatArray, FloatArray]:
    """Sixty right matches and some wrong ones: pixels and points."""
    rng = np.random.default_rng(5)
    pixels = rng.uniform((20, 20), (620, 460), (60 + wrong, 2))
    points = POSE.position + (CAMERA.rays(pixels) @ POSE.R_map_camera.T) * rng.uniform(1, 5, (60 + wrong, 1))
    points[60:] = points[rng.permutation(wrong) + 60]
    return pixels + rng.normal(0, noise_px, pixels.shape), points


@pytest.mark.parametrize("solver", Solver)
@pytest.mark.parametrize("wrong", [0, 140])
def test_a_pose_is_found_among_wrong_matches_and_through_distortion(solver: Solver, wrong: int) -> None:
    T = solve(solver, *scene(wrong), CAMERA)
    errors = trajectory_errors(T[None], POSE.T_map_camera[None])
    assert errors.position_m[0] < 0.01
    assert np.degrees(errors.rotation_rad[0]) < 0.2


@pytest.mark.parametrize("solver", Solver)
@pytest.mark.parametrize("count", [0, 3])
def test_too_few_matches_give_no_pose(solver: Solver, count: int) -> None:
    pixels, points = scene(0)
    assert solve(solver, pixels[:count], points[:count], CAMERA) is None


@pytest.mark.parametrize("solver", Solver)
def test_points_that_all_coincide_give_no_pose(solver: Solver) -> None:
    pixels, points = scene(0)
    assert solve(solver, np.repeat(pixels[:1], 20, axis=0), np.repeat(points[:1], 20, axis=0), CAMERA) is None


def test_matches_are_sorted_and_thinned_by_their_chances() -> None:
    matches = Matches(np.arange(4), np.arange(4), np.array([0.2, 0.9, 0.3, 0.9]))
    assert matches.likeliest_first().detections.tolist() == [1, 3, 2, 0]
    assert distinct(matches).detections.tolist() == [1, 2, 3]


def test_the_names_that_tables_show() -> None:
    assert [*Solver] == ["cv2", "poselib"]
    assert [*MatchSet] == ["everywhere", "distinct", "place"]


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
    assert np.flatnonzero(poses.known).tolist() == rows.tolist()
    np.testing.assert_allclose(poses.T_map_camera[rows], T[rows], atol=1e-4)
    # poses that a recording brings itself stand
    assert with_poses(recording, use_truth=True).poses is recording.poses
