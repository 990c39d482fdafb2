"""Errors, recall and medians: known values and invariants; which estimated pose is compared with which true one."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from rholoc.errors import InvalidTrajectory
from rholoc.evaluation import (
    Evaluation,
    FramePoses,
    PoseErrors,
    evaluate,
    in_range,
    pair_poses,
    quantile,
    rigid_alignment,
    trajectory_errors,
)
from rholoc.geometry import FloatArray, pose_matrix


def random_poses(n: int, seed: int = 0) -> FloatArray:
    rng = np.random.default_rng(seed)
    return pose_matrix(Rotation.random(n, rng=rng).as_matrix(), rng.normal(size=(n, 3)))


def test_the_truth_has_no_error() -> None:
    truth = random_poses(20)
    errors = trajectory_errors(truth, truth)
    np.testing.assert_allclose(errors.position_m, 0)
    np.testing.assert_allclose(errors.rotation_rad, 0, atol=1e-7)


def test_known_offsets_are_measured() -> None:
    truth = random_poses(5)
    offset = pose_matrix(Rotation.from_rotvec([0, 0, math.radians(7)]).as_matrix(), np.zeros(3))
    estimated = truth @ offset  # turned about its own axis: pure roll
    estimated[:, :3, 3] += [0.03, 0.0, 0.04]
    errors = trajectory_errors(estimated, truth)
    np.testing.assert_allclose(errors.position_m, 0.05)
    np.testing.assert_allclose(np.degrees(errors.rotation_rad), 7)


@given(seed=st.integers(0, 1000))
def test_errors_do_not_depend_on_the_map_frame(seed: int) -> None:
    truth, estimated = random_poses(4, seed), random_poses(4, seed + 1)
    T = random_poses(1, seed + 2)[0]
    here, there = trajectory_errors(estimated, truth), trajectory_errors(T @ estimated, T @ truth)
    np.testing.assert_allclose(here.position_m, there.position_m)
    np.testing.assert_allclose(here.rotation_rad, there.rotation_rad, atol=1e-6)


def test_a_frame_without_a_pose_is_a_failure_in_every_figure() -> None:
    truth = random_poses(4)
    estimated = truth.copy()
    estimated[:3] = np.nan
    figures = evaluate(trajectory_errors(estimated, truth))
    assert (figures.n, figures.localized) == (4, 1)
    assert figures.recall_25cm_10deg == 0.25
    assert figures.median_cm is None
    assert figures.p90_deg is None


def test_figures_of_known_errors() -> None:
    errors = PoseErrors(np.array([0.01, 0.05, 0.07, 0.2, np.inf]), np.radians(np.array([1.0, 4.0, 6.0, 9.0, np.inf])))
    figures = evaluate(errors)
    assert (figures.n, figures.localized) == (5, 4)
    assert figures.median_cm == pytest.approx(7)
    assert figures.median_deg == pytest.approx(6)
    assert figures.recall_5cm_5deg == pytest.approx(0.4)
    assert figures.recall_10cm_5deg == pytest.approx(0.4)  # 7 cm is near enough, but 6° is not
    assert figures.recall_25cm_10deg == pytest.approx(0.8)
    assert figures.p90_cm is None


def test_the_keys_are_those_that_scripts_rely_on() -> None:
    keys = list(evaluate(PoseErrors(np.zeros(1), np.zeros(1))).as_dict())
    asked = "n localized median_cm median_deg recall_5cm_5deg recall_10cm_5deg recall_25cm_10deg"
    assert set(asked.split()) <= set(keys)
    assert set(keys) - set(asked.split()) == {"p90_cm", "p90_deg"}


def test_no_frames_have_no_median_and_no_recall() -> None:
    assert evaluate(PoseErrors(np.zeros(0), np.zeros(0))) == Evaluation(0, 0, None, None, None, None, 0.0, 0.0, 0.0)


@given(st.lists(st.floats(0, 1e6), min_size=1), st.floats(0, 1))
def test_quantiles_of_finite_values_are_numpys(values: list[float], q: float) -> None:
    assert quantile(np.array(values), q) == pytest.approx(float(np.quantile(values, q)), rel=1e-9, abs=1e-9)


def test_a_quantile_below_the_failures_stays_finite() -> None:
    assert quantile(np.array([1.0, 2.0, np.inf]), 0.5) == 2.0
    assert quantile(np.array([1.0, np.inf]), 0.5) is None


@given(seed=st.integers(0, 1000))
def test_alignment_undoes_a_rigid_motion(seed: int) -> None:
    truth = random_poses(8, seed)
    T_truth_estimated = random_poses(1, seed + 1)[0]
    estimated = np.linalg.inv(T_truth_estimated) @ truth
    estimated[3] = np.nan
    found = rigid_alignment(estimated, truth)
    np.testing.assert_allclose(found, T_truth_estimated, atol=1e-8)


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
