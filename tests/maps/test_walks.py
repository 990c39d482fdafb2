"""Which views follow one another."""

import numpy as np

from rholoc.maps.walks import consecutive, walk_numbers

ALONG = np.column_stack([np.linspace(0, 5, 20), np.zeros(20), np.zeros(20)])
SHUFFLED = np.random.default_rng(0).permutation(ALONG)


def test_each_recording_in_order_is_a_walk_and_pictures_in_no_order_are_none() -> None:
    sources = np.repeat([0, 1, 2], 20)
    walks = walk_numbers(np.vstack([ALONG, SHUFFLED, ALONG]), sources)
    first, second, third = walks[:20], walks[20:40], walks[40:]
    assert len(np.unique(first)) == len(np.unique(third)) == 1
    assert len(np.unique(second)) == 20
    assert len(np.unique(walks)) == 22
    rows = consecutive(walks)
    np.testing.assert_array_equal(rows[:, 1] - rows[:, 0], 1)
    assert len(rows) == 2 * 19
    assert not np.any((rows[:, 0] >= 19) & (rows[:, 1] <= 40))


def test_few_views_are_a_walk() -> None:
    for count in range(3):
        assert len(np.unique(walk_numbers(SHUFFLED[:count], np.zeros(count)))) == min(count, 1)
        assert consecutive(walk_numbers(SHUFFLED[:count], np.zeros(count))).shape == (max(count - 1, 0), 2)
