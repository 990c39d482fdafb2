"""The map as localization needs it."""

from __future__ import annotations

import numpy as np

from rholoc.localization import Localizer
from rholoc.maps import Map


def test_what_was_seen_alike_is_what_the_views_that_share_most_saw(localizer: Localizer, room_map: Map) -> None:
    of_view = np.split(room_map.observation_features, room_map.view_offsets[1:-1])
    seen = localizer.index.seen_alike(of_view[7], 1)
    np.testing.assert_array_equal(np.flatnonzero(seen), np.unique(of_view[7]))

    more = localizer.index.seen_alike(of_view[7], 3)
    assert (more & seen).sum() == seen.sum()
    assert localizer.index.seen_alike(of_view[7], len(of_view)).sum() == len(np.unique(room_map.observation_features))
