"""Two reconstructions of one walk, held against each other."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rholoc.geometry import FloatArray, Similarity, pose_matrix
from rholoc.trajectory.checks.agreement import Agreement, compare

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
    assert found.second_positions is not None
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
