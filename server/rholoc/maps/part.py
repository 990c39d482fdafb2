"""A part of a map, chosen by its views: a map of its own that is quick to cut out of a large one."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rholoc.density import DensityKind
from rholoc.geometry import IntArray, ranges
from rholoc.maps.cloud import Cloud
from rholoc.maps.map import Map


@dataclass(frozen=True, eq=False)
class MapPart:
    """Some views of a map, and all landmarks that they saw.

    Attributes:
        map: only these, without what learning needs.
        features: (P,) the rows of its features in the whole map, ascending.
    """

    map: Map
    features: IntArray


def part_of(map_: Map, views: IntArray) -> MapPart:
    """The part of a map of ``ray`` form with the ``views`` (N,), ascending; takes time by the part's size."""
    assert map_.info.density is DensityKind.RAY
    first, last = map_.view_offsets[views], map_.view_offsets[views + 1]
    seen = map_.observation_features[ranges(first, last)]
    features, own = np.unique(seen, return_inverse=True)
    described = np.searchsorted(map_.descriptor_features, features, side="left")
    described_end = np.searchsorted(map_.descriptor_features, features, side="right")
    part = replace(
        map_,
        channels=map_.channels[features],
        landmarks=map_.landmarks[features],
        covariances=map_.covariances[features],
        colours=None if map_.colours is None else map_.colours[features],
        patches=None if map_.patches is None else map_.patches[features],
        descriptors=map_.descriptors[ranges(described, described_end)],
        descriptor_features=np.repeat(np.arange(len(features), dtype=np.int32), described_end - described),
        view_times=map_.view_times[views],
        T_map_camera=map_.T_map_camera[views],
        view_covariances=None if map_.view_covariances is None else map_.view_covariances[views],
        observation_views=np.repeat(np.arange(len(views), dtype=np.int32), last - first),
        observation_features=own.astype(np.int32),
        observations=None,
        cloud=Cloud(),
        pictures=None,
    )
    return MapPart(part, features.astype(np.int64))
