"""Presence: a feature is expected from where it was seen, not from behind it or from afar."""

from __future__ import annotations

import numpy as np

from rholoc.density.presence import Presence, group_sums

LANDMARKS = np.array([[0.0, 0.0, 0.0], [5.0, 0.0, 0.0]])
POSITIONS = np.array([[0.0, -2.0, 0.0], [0.5, -2.0, 0.0], [5.0, 3.0, 0.0]])
PRESENCE = Presence.of(LANDMARKS, POSITIONS, np.array([0, 0, 1]))


def test_where_it_was_seen_from_is_allowed() -> None:
    assert PRESENCE.allows(LANDMARKS, POSITIONS[0])[0]
    assert PRESENCE.allows(LANDMARKS, POSITIONS[1])[0]
    assert PRESENCE.allows(LANDMARKS, POSITIONS[2])[1]


def test_behind_and_too_far_are_not() -> None:
    assert not PRESENCE.allows(LANDMARKS, np.array([0.0, 2.0, 0.0]))[0]
    assert not PRESENCE.allows(LANDMARKS, np.array([0.0, -20.0, 0.0]))[0]
    assert not PRESENCE.allows(LANDMARKS, np.array([0.0, -0.2, 0.0]))[0]


def test_group_sums_add_by_group() -> None:
    sums = group_sums(np.array([0, 2, 0]), np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]), 4)
    np.testing.assert_array_equal(sums, [[6, 8], [0, 0], [3, 4], [0, 0]])


def test_near_and_far_views_count_alike() -> None:
    presence = Presence.of(np.zeros((1, 3)), np.array([[0.0, -1.0, 0.0], [4.0, 0.0, 0.0]]), np.array([0, 0]))
    np.testing.assert_allclose(presence.direction, [[np.sqrt(0.5), -np.sqrt(0.5), 0.0]])
    assert (presence.nearest[0], presence.farthest[0]) == (1.0, 4.0)


def test_it_is_looked_for_from_a_little_beyond_where_it_was_seen() -> None:
    presence = Presence.of(np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0]] * 2), np.array([0, 0]))

    def allowed(angle_deg: float, distance: float) -> bool:
        angle = np.deg2rad(angle_deg)
        return bool(presence.allows(np.zeros((1, 3)), distance * np.array([np.cos(angle), 0.0, np.sin(angle)]))[0])

    assert allowed(34.0, 1.0)
    assert not allowed(36.0, 1.0)
    assert allowed(0.0, 1.99)
    assert not allowed(0.0, 2.01)
    assert allowed(0.0, 0.51)
    assert not allowed(0.0, 0.49)
    taken = presence.take(np.array([0]))
    assert (taken.nearest[0], taken.farthest[0], taken.cosine_limit[0]) == (1.0, 1.0, presence.cosine_limit[0])
