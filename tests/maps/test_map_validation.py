"""Arrays that are no map."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rholoc.errors import InvalidMap
from rholoc.maps import Map, validate_map


def changed(array: Any, index: Any, value: Any) -> Any:
    copy = array.copy()
    copy[index] = value
    return copy


BREAKS = {
    "dtype": lambda m: {"landmarks": m.landmarks.astype(np.float64)},
    "a list": lambda m: {"view_times": list(m.view_times)},
    "shape": lambda m: {"landmarks": m.landmarks[:, :2]},
    "dimensions": lambda m: {"descriptors": m.descriptors.ravel()},
    "channels too few": lambda m: {"channels": m.channels[1:]},
    "covariances too few": lambda m: {"covariances": m.covariances[1:]},
    "nan landmark": lambda m: {"landmarks": changed(m.landmarks, (0, 0), np.nan)},
    "infinite time": lambda m: {"view_times": changed(m.view_times, 0, np.inf)},
    "negative variance": lambda m: {"covariances": changed(m.covariances, (0, 3), -1)},
    "descriptor without owner": lambda m: {"descriptor_features": m.descriptor_features[1:]},
    "owner too large": lambda m: {"descriptor_features": changed(m.descriptor_features, -1, len(m))},
    "owner negative": lambda m: {"descriptor_features": changed(m.descriptor_features, 0, -1)},
    "owners unsorted": lambda m: {"descriptor_features": m.descriptor_features[::-1].copy()},
    "views differ": lambda m: {"view_times": m.view_times[1:]},
    "quaternion": lambda m: {"view_poses": changed(m.view_poses, (0, 3), 2.0)},
    "offsets start": lambda m: {"view_offsets": changed(m.view_offsets, 0, 1)},
    "offsets end": lambda m: {"view_offsets": changed(m.view_offsets, -1, len(m.view_features) + 1)},
    "offsets fall": lambda m: {"view_offsets": changed(m.view_offsets, 1, m.view_offsets[2] + 1)},
    "offsets too few": lambda m: {"view_offsets": m.view_offsets[:-1]},
    "no offsets": lambda m: {"view_offsets": m.view_offsets[:0]},
    "seen feature too large": lambda m: {"view_features": changed(m.view_features, 0, len(m))},
    "seen feature negative": lambda m: {"view_features": changed(m.view_features, 0, -1)},
}


@pytest.mark.parametrize("name", BREAKS)
def test_arrays_that_contradict_each_other_are_refused(room_map: Map, name: str) -> None:
    validate_map(room_map)
    with pytest.raises(InvalidMap):
        validate_map(replace(room_map, **BREAKS[name](room_map)))
