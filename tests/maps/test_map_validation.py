"""Arrays that are no map."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rholoc.errors import InvalidMap
from rholoc.maps import DensityKind, Map, validate_map


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
    "negative variance": lambda m: {"covariances": changed(m.covariances, (0, 1, 1), -1)},
    "descriptor without owner": lambda m: {"descriptor_features": m.descriptor_features[1:]},
    "owner too large": lambda m: {"descriptor_features": changed(m.descriptor_features, -1, len(m))},
    "owner negative": lambda m: {"descriptor_features": changed(m.descriptor_features, 0, -1)},
    "owners unsorted": lambda m: {"descriptor_features": m.descriptor_features[::-1].copy()},
    "views differ": lambda m: {"view_times": m.view_times[1:]},
    "not a rotation": lambda m: {"T_map_camera": changed(m.T_map_camera, (0, 0, 0), 2.0)},
    "mirrored": lambda m: {"T_map_camera": m.T_map_camera * [[1, 1, -1, 1]]},
    "poses differ": lambda m: {"T_map_camera": m.T_map_camera[1:]},
    "observations differ": lambda m: {"observation_views": m.observation_views[1:]},
    "views fall": lambda m: {"observation_views": m.observation_views[::-1].copy()},
    "view too large": lambda m: {"observation_views": changed(m.observation_views, -1, len(m.view_times))},
    "view negative": lambda m: {"observation_views": changed(m.observation_views, 0, -1)},
    "seen feature too large": lambda m: {"observation_features": changed(m.observation_features, 0, len(m))},
    "seen feature negative": lambda m: {"observation_features": changed(m.observation_features, 0, -1)},
    "tensors missing": lambda m: {"info": replace(m.info, density=DensityKind.TENSOR)},
}


@pytest.mark.parametrize("name", BREAKS)
def test_arrays_that_contradict_each_other_are_refused(room_map: Map, name: str) -> None:
    validate_map(room_map)
    with pytest.raises(InvalidMap):
        validate_map(replace(room_map, **BREAKS[name](room_map)))
