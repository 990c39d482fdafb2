"""Two reconstructions of one walk, held against each other; waypoints held against all else."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rholoc.geometry import FloatArray, Similarity, pose_matrix
from rholoc.trajectory.checks.agreement import Agreement, compare
from rholoc.trajectory.checks.mistaken_waypoints import LeftOut, compare_unused, explain, leave_out, worst

_DEPTH = 3.0  # of the points, in the walk's unit
_COUNT = 40


def _walk() -> FloatArray:
    """(40, 4, 4) along a bent line."""
    along = np.linspace(0, 4, _COUNT)
    R = Rotation.from_euler("z", 20 * along[:, None], degrees=True).as_matrix()
    return pose_matrix(R, np.column_stack([along, np.sin(along), 0.1 * np.cos(3 * along)]))


def _against(other: FloatArray, placed: int = _COUNT) -> Agreement:
    return compare(_walk(), np.ones(_COUNT, dtype=bool), np.arange(_COUNT), other, np.arange(_COUNT) < placed, _DEPTH)


def test_frame_and_scale_do_not_matter() -> None:
    turned = Similarity(2.5, Rotation.from_euler("xyz", [0.4, -1.0, 2.0]).as_matrix(), np.array([3.0, -7.0, 1.0]))
    found = _against(turned.poses(_walk()))
    assert found.same
    assert found.distance == pytest.approx(0, abs=1e-9)
    assert found.angle_deg == pytest.approx(0, abs=1e-4)
    assert "agree:" in found.why


def test_the_second_reconstruction_is_known_in_the_frame_of_the_first() -> None:
    turned = Similarity(2.5, Rotation.from_euler("xyz", [0.4, -1.0, 2.0]).as_matrix(), np.array([3.0, -7.0, 1.0]))
    every_second = np.arange(0, _COUNT, 2)
    found = compare(
        _walk(), np.ones(_COUNT, bool), every_second, turned.poses(_walk())[::2], np.arange(20) < 18, _DEPTH
    )
    np.testing.assert_allclose(found.second_positions[:36:2], _walk()[:36:2, :3, 3], atol=1e-9)
    assert np.isnan(found.second_positions[1::2]).all()
    assert np.isnan(found.second_positions[36:]).all()
    assert _against(_walk(), placed=20).second_positions is None


def test_a_straight_walk_agrees_with_itself_in_any_frame() -> None:
    """Positions on a line leave the rotation about it open."""
    straight = _walk()
    straight[:, 1:3, 3] *= 1e-3
    turned = Similarity(2.5, Rotation.from_euler("xyz", [0.4, -1.0, 2.0]).as_matrix(), np.array([3.0, -7.0, 1.0]))
    rng = np.random.default_rng(0)
    other = turned.poses(straight)
    other[:, :3, 3] += rng.normal(0, 0.01, (_COUNT, 3))
    every = np.ones(_COUNT, dtype=bool)
    found = compare(straight, every, np.arange(_COUNT), other, every, _DEPTH)
    assert found.same
    assert found.angle_deg < 0.5


def test_a_bent_walk_disagrees() -> None:
    bent = _walk()
    bent[_COUNT // 2 :, :3, 3] += np.linspace(0, 1.0, _COUNT // 2)[:, None] * [0.0, 0.0, 1.0]
    found = _against(bent)
    assert not found.same
    assert "disagree" in found.why


def test_a_part_that_is_elsewhere_shows_in_most_though_not_in_the_median() -> None:
    part = _walk()
    part[-6:, :3, 3] += [0.0, 0.0, 2.0]
    found = _against(part)
    assert not found.same


def test_wrong_rotations_disagree() -> None:
    turned = _walk()
    turned[:, :3, :3] = turned[:, :3, :3] @ Rotation.from_euler("x", 5, degrees=True).as_matrix()
    assert not _against(turned).same


def test_too_few_common_keyframes_prove_nothing() -> None:
    found = _against(_walk(), placed=20)
    assert not found.same
    assert found.common == 20
    assert found.why == "Only 20 of 40 keyframes could be checked by a second reconstruction."


@pytest.mark.parametrize(
    ("distance", "of_most", "angle_deg", "same"),
    [
        (0.019, 0.039, 1.9, True),
        (0.021, 0.039, 1.9, False),
        (0.019, 0.041, 1.9, False),
        (0.019, 0.039, 2.1, False),
        (np.nan, np.nan, np.nan, False),
    ],
)
def test_what_counts_as_the_same(distance: float, of_most: float, angle_deg: float, same: bool) -> None:
    assert Agreement(distance, of_most, angle_deg, 9, 10).same is same


def test_distances_are_shares_of_the_depth_and_angles_are_degrees() -> None:
    """Two in five keyframes are elsewhere, so little that the rest decides the alignment."""
    walk = _walk()
    moved = walk.copy()
    moved[::2, :3, 3] += [0.0, 0.0, 0.03]
    moved[1::2, :3, 3] -= [0.0, 0.0, 0.03]
    turn = Rotation.from_euler("x", np.where(np.arange(_COUNT) % 2, 0.5, -0.5)[:, None], degrees=True).as_matrix()
    moved[:, :3, :3] = moved[:, :3, :3] @ turn
    found = _against(moved)
    assert found.distance == pytest.approx(0.03 / _DEPTH, rel=0.05)
    assert found.distance_of_most == pytest.approx(0.03 / _DEPTH, rel=0.3)
    assert found.angle_deg == pytest.approx(0.5, rel=0.3)
    assert (found.common, found.of) == (_COUNT, _COUNT)


@pytest.mark.parametrize(("placed", "compared"), [(27, False), (28, True)])
def test_seven_in_ten_keyframes_must_be_placed_by_both(placed: int, compared: bool) -> None:
    assert np.isfinite(_against(_walk(), placed).distance) == compared
    here = np.arange(_COUNT) >= _COUNT - placed
    found = compare(_walk(), here, np.arange(_COUNT), _walk(), np.ones(_COUNT, bool), _DEPTH)
    assert np.isfinite(found.distance) == compared
    assert found.common == placed


@pytest.mark.parametrize(("count", "compared"), [(2, False), (3, True)])
def test_three_keyframes_are_the_least(count: int, compared: bool) -> None:
    every = np.ones(count, bool)
    found = compare(
        _walk()[10:], np.ones(30, bool), 4 * np.arange(count), _walk()[10 : 10 + 4 * count : 4], every, _DEPTH
    )
    assert np.isfinite(found.distance) == compared


def test_some_of_the_keyframes_are_compared_with_their_like() -> None:
    some = np.arange(0, _COUNT, 2)
    found = compare(_walk(), np.ones(_COUNT, bool), some, _walk()[some], np.ones(len(some), bool), _DEPTH)
    assert found.distance == pytest.approx(0, abs=1e-9)
    assert (
        found.why
        == "Two reconstructions agree: 0.0% of the median depth and 0.0° apart, nine in ten keyframes within 0.0%."
    )


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
    found = compare_unused(np.array([1.1, 2.0, 3.0]), np.array([1.0, 2.0, 3.1]), covariance, 0.04)
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
