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


def broken(map_: Map, **changes: Any) -> Map:
    """The map with other columns, named ``table.column``, or with another description."""
    for name, value in changes.items():
        table, _, column = name.partition(".")
        map_ = replace(map_, **{table: replace(getattr(map_, table), **{column: value}) if column else value})
    return map_


BREAKS = {
    "dtype": lambda m: {"landmarks.positions": m.landmarks.positions.astype(np.float64)},
    "a list": lambda m: {"views.times": list(m.views.times)},
    "shape": lambda m: {"landmarks.positions": m.landmarks.positions[:, :2]},
    "dimensions": lambda m: {"descriptors.values": m.descriptors.values.ravel()},
    "channels too few": lambda m: {"landmarks.channels": m.landmarks.channels[1:]},
    "covariances too few": lambda m: {"landmarks.covariances": m.landmarks.covariances[1:]},
    "nan landmark": lambda m: {"landmarks.positions": changed(m.landmarks.positions, (0, 0), np.nan)},
    "infinite time": lambda m: {"views.times": changed(m.views.times, 0, np.inf)},
    "infinite range": lambda m: {"observations.ranges_m": np.full(len(m.observations), np.inf, np.float32)},
    "negative variance": lambda m: {"landmarks.covariances": changed(m.landmarks.covariances, (0, 1, 1), -1)},
    "descriptor without owner": lambda m: {"descriptors.features": m.descriptors.features[1:]},
    "owner too large": lambda m: {"descriptors.features": changed(m.descriptors.features, -1, len(m))},
    "owner negative": lambda m: {"descriptors.features": changed(m.descriptors.features, 0, -1)},
    "owners unsorted": lambda m: {"descriptors.features": m.descriptors.features[::-1].copy()},
    "views differ": lambda m: {"views.times": m.views.times[1:]},
    "not a rotation": lambda m: {"views.T_map_camera": changed(m.views.T_map_camera, (0, 0, 0), 2.0)},
    "mirrored": lambda m: {"views.T_map_camera": m.views.T_map_camera * [[1, 1, -1, 1]]},
    "poses differ": lambda m: {"views.T_map_camera": m.views.T_map_camera[1:]},
    "observations differ": lambda m: {"observations.views": m.observations.views[1:]},
    "views fall": lambda m: {"observations.views": m.observations.views[::-1].copy()},
    "view too large": lambda m: {"observations.views": changed(m.observations.views, -1, len(m.views))},
    "view negative": lambda m: {"observations.views": changed(m.observations.views, 0, -1)},
    "seen feature too large": lambda m: {"observations.features": changed(m.observations.features, 0, len(m))},
    "seen feature negative": lambda m: {"observations.features": changed(m.observations.features, 0, -1)},
    "tensors missing": lambda m: {"info": replace(m.info, density=DensityKind.TENSOR)},
}


@pytest.mark.parametrize("name", BREAKS)
def test_arrays_that_contradict_each_other_are_refused(room_map: Map, name: str) -> None:
    validate_map(room_map)
    with pytest.raises(InvalidMap):
        validate_map(broken(room_map, **BREAKS[name](room_map)))
