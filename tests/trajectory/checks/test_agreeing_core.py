"""Two reconstructions that are the same over some of their pictures."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rholoc.geometry import BoolArray, FloatArray, Similarity, pose_matrix
from rholoc.trajectory.checks.agreeing_core import Links, agreeing_core

_COUNT, _CORE = 20, 12
_DEPTH = 2.0  # of the points, in the first one's unit
_MATCHES, _FEW = 40, 5  # of each two neighbours and of those next to them; of those on both sides of the core's end
_FRAME = Similarity(2.5, Rotation.from_rotvec([0.3, -0.8, 0.2]).as_matrix(), np.array([4.0, -2.0, 1.0]))
_BENT = Similarity(1.3, Rotation.from_rotvec([0.0, 0.0, 0.9]).as_matrix(), np.array([1.0, 1.0, 0.0]))
_PAIRS = [(k, k + step) for step in (1, 2) for k in range(_COUNT - step)]


def _walk() -> FloatArray:
    """(20, 4, 4) along a bent line, a third of a unit apart."""
    along = np.linspace(0, 6, _COUNT)
    R = Rotation.from_euler("z", 20 * along[:, None], degrees=True).as_matrix()
    return pose_matrix(R, np.column_stack([along, np.sin(along), 0.1 * np.cos(3 * along)]))


def _bent_after_core() -> FloatArray:
    """(20, 4, 4) the same walk in another frame and scale, but with the last eight poses elsewhere."""
    T = _walk()
    T[_CORE:] = _BENT.poses(T[_CORE:])
    return _FRAME.poses(T)


def _links(pairs: list[tuple[int, int]], others: dict[tuple[int, int], int] | None = None) -> Links:
    """Links of pairs along the walk, and of ``others`` with their matches."""
    usual = {pair: _FEW if pair[0] < _CORE <= pair[1] else _MATCHES for pair in pairs}
    every = usual | (others or {})
    return Links(np.array(list(every)), np.array(list(every.values())))


def _core(other: FloatArray, links: Links, placed: BoolArray | None = None, T: FloatArray | None = None) -> list[int]:
    every = np.ones(_COUNT, np.bool_)
    found = agreeing_core(
        _walk() if T is None else T, other, every if placed is None else placed, links, np.full(_COUNT, _DEPTH)
    )
    return np.flatnonzero(found).tolist()


def test_the_larger_of_two_parts_that_are_joined_differently_is_the_core() -> None:
    assert _core(_bent_after_core(), _links(_PAIRS)) == list(range(_CORE))


def test_equal_reconstructions_agree_everywhere() -> None:
    assert _core(_FRAME.poses(_walk()), _links(_PAIRS)) == list(range(_COUNT))


@pytest.mark.parametrize(("off", "turned_deg"), [(0.05 * _DEPTH, 0.0), (0.0, 3.0)])
def test_a_pose_by_over_4_percent_of_its_depth_or_2_degrees_elsewhere_is_left_out(
    off: float, turned_deg: float
) -> None:
    other = _walk()
    other[5, :3, 3] += [0.0, 0.0, off]
    other[5, :3, :3] = other[5, :3, :3] @ Rotation.from_euler("x", turned_deg, degrees=True).as_matrix()
    assert _core(_FRAME.poses(other), _links(_PAIRS)) == [k for k in range(_COUNT) if k != 5]


def test_pictures_that_only_one_places_are_left_out() -> None:
    placed = np.arange(_COUNT) != 5
    assert _core(_bent_after_core(), _links(_PAIRS), placed) == [k for k in range(_CORE) if k != 5]


def test_a_core_is_connected() -> None:
    pairs = [pair for pair in _PAIRS if not pair[0] <= 6 < pair[1]]
    assert _core(_FRAME.poses(_walk()), _links(pairs)) == list(range(7, _COUNT))


def test_pictures_of_a_place_that_looks_alike_are_left_out_though_both_have_them_there() -> None:
    """Of a corridor both reconstructions had two pictures at doors 30 m off, by 51 of their matches; with those of the
    pictures around them, which each had elsewhere, they had 556.
    """
    T, other = _walk(), _bent_after_core()
    T[-2:], other[-2:] = T[4:6], other[4:6]
    assert _core(other, _links(_PAIRS, {(4, 18): 30, (5, 19): 20}), T=T) == list(range(_CORE))


def test_a_core_ends_at_weak_links() -> None:
    """In a simulated corridor three reconstructions agreed over 22 pictures of two doors that look alike."""
    strong = dict.fromkeys(_PAIRS, _MATCHES)
    assert _core(_bent_after_core(), _links(_PAIRS, strong)) == []


def test_reconstructions_of_which_no_two_pictures_agree_have_no_core() -> None:
    rng = np.random.default_rng(0)
    R = Rotation.random(_COUNT, random_state=0).as_matrix()
    assert _core(pose_matrix(R, rng.normal(0, 3, (_COUNT, 3))), _links(_PAIRS)) == []
