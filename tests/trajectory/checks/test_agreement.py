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
