"""Errors, recall and medians: known values and invariants."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from rholoc.evaluation import Evaluation, PoseErrors, evaluate, quantile, rigid_alignment, trajectory_errors
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
