"""Waypoints held against all else."""

from __future__ import annotations

import numpy as np
import pytest

from rholoc.trajectory.checks.blame import LeftOut, explain, held_against, leave_out, worst

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


@pytest.mark.parametrize(
    ("off_m", "sigmas", "mistaken"), [(0.5, 4.4, False), (0.5, 4.6, True), (0.079, 9.0, False), (0.081, 9.0, True)]
)
def test_a_mistake_is_far_off_in_sigmas_and_in_metres(off_m: float, sigmas: float, mistaken: bool) -> None:
    assert LeftOut(np.array([0.0, 0.6, -0.8]) * off_m, sigmas).mistaken is mistaken


def test_a_distance_in_sigmas_is_of_both_uncertainties() -> None:
    covariance = np.diag([0.03, 0.04, 0.0]) ** 2
    found = held_against(np.array([1.1, 2.0, 3.0]), np.array([1.0, 2.0, 3.1]), covariance, 0.04)
    np.testing.assert_allclose(found.off_m, [0.1, 0, -0.1])
    assert found.sigmas == pytest.approx(np.sqrt((0.1 / 0.05) ** 2 + (0.1 / 0.04) ** 2))


def test_taking_out_a_waypoint_is_exact_where_its_loss_is_square() -> None:
    """Place and waypoint along each axis: a mean of two, of which one is taken back. With Cauchy's weight elsewhere."""
    others, own = np.array([0.03, 0.05, 0.02]), _SIGMA_M
    measured, without = np.array([1.0, 2.0, 3.0]), np.array([1.001, 1.999, 3.0005])
    off = measured - without
    weight = 1 / own**2
    for _ in range(60):
        place = (without / others**2 + weight * measured) / (others**-2 + weight)
        weight = 1 / own**2 / (1 + (np.linalg.norm(measured - place) / (3 * own)) ** 2)
    covariance = np.diag(1 / (others**-2 + weight))
    found = leave_out(measured, place, covariance, own)
    np.testing.assert_allclose(found.off_m, off, rtol=1e-6)
    assert found.sigmas == pytest.approx(np.sqrt(np.sum(off**2 / (others**2 + own**2))), rel=1e-6)


@pytest.mark.parametrize(
    ("off", "one"), [((0.0, 0.19, 0.09), True), ((0.0, 0.18, -0.09), False), ((-0.2, 0.0, 0.0), True)]
)
def test_one_coordinate_is_named_where_it_is_nine_tenths_of_the_error(
    off: tuple[float, float, float], one: bool
) -> None:
    assert ("looks wrong by" in explain("W", np.array(off))) is one
