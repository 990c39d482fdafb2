"""Waypoints held against all else."""

from __future__ import annotations

import numpy as np
import pytest

from rholoc.trajectory.checks.blame import LeftOut, explain, leave_out, worst

_SIGMA_M = 0.02


def _chain(measured: np.ndarray, given: np.ndarray, step_sigma_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Five places a metre apart, each step known to ``step_sigma_m``, and the waypoints (5,) that are given: solved.

    Only along x; the weights of waypoints are those of Cauchy's loss at the solution.
    """
    weights = given / _SIGMA_M**2
    for _ in range(50):
        information = np.diag(weights)
        right = weights * measured
        for i in range(4):
            J = np.zeros(5)
            J[i], J[i + 1] = -1, 1
            information += np.outer(J, J) / step_sigma_m**2
            right += J * 1.0 / step_sigma_m**2
        x = np.linalg.solve(information, right)
        weights = given / (1 + ((measured - x) / (3 * _SIGMA_M)) ** 2) / _SIGMA_M**2
    return x, np.linalg.inv(information)


@pytest.mark.parametrize("wrong", [0, 2, 4])
def test_leaving_one_out_is_the_solution_without_it(wrong: int) -> None:
    """Without a second solution: the information of the waypoint is taken out of that of its place."""
    measured = np.arange(5.0) + np.array([0.004, -0.006, 0.01, 0.0, -0.008])
    measured[wrong] += 0.05
    everyone, all_but = np.ones(5), np.ones(5)
    all_but[wrong] = 0
    x, covariance = _chain(measured, everyone, 0.01)
    without, covariance_without = _chain(measured, all_but, 0.01)
    apart = np.array([1.0, 0, 0])
    found = leave_out(
        measured[wrong] * apart,
        x[wrong] * apart,
        np.diag([covariance[wrong, wrong], 1e-4, 1e-4]),
        _SIGMA_M,
    )
    off = measured[wrong] - without[wrong]
    assert found.off_m[0] == pytest.approx(off, rel=0.05)
    expected_sigmas = abs(off) / np.hypot(np.sqrt(covariance_without[wrong, wrong]), _SIGMA_M)
    assert found.sigmas == pytest.approx(expected_sigmas, rel=0.05)


def test_a_waypoint_that_alone_holds_its_place_is_never_mistaken() -> None:
    """Where all else knows nothing, its place is its own word: leaving it out leaves everything open."""
    measured = np.array([1.0, 2.0, 3.0])
    for rounding in (1e-5, 1e-4):
        alone = leave_out(measured, measured + rounding, _SIGMA_M**2 * np.eye(3), _SIGMA_M)
        assert alone.sigmas < 1
        assert not alone.mistaken


def test_a_waypoint_far_from_a_certain_walk_is_mistaken() -> None:
    certain = leave_out(np.array([1.2, 2.0, 3.0]), np.array([1.0, 2.0, 3.0]), 1e-5 * np.eye(3), _SIGMA_M)
    assert certain.mistaken
    bent = leave_out(np.array([1.2, 2.0, 3.0]), np.array([1.0, 2.0, 3.0]), 1e-2 * np.eye(3), 0.2)
    assert not bent.mistaken, "it is likelier that the walk is bent"
    near = leave_out(np.array([1.06, 2.0, 3.0]), np.array([1.0, 2.0, 3.0]), 1e-7 * np.eye(3), 0.01)
    assert not near.mistaken, "nobody measures waypoints that well"


def test_the_furthest_off_is_named_with_its_coordinate() -> None:
    outs = [
        LeftOut(np.array([0.0, 0.01, 0.0]), 0.5),
        LeftOut(np.array([0.0, 0.2, 0.0]), 8.0),
        LeftOut(np.array([0.3, 0.3, 0.0]), 12.0),
    ]
    names = ["START", "W1", "W2"]
    assert worst(names, outs) == 2
    assert worst(names[:1], outs[:1]) is None
    assert explain("W1", outs[1].off_m) == "W1: its y looks wrong by 0.20 m; it was left out."
    assert "W2 is 0.42 m from where the walk has it" in explain("W2", outs[2].off_m)
