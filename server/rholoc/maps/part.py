"""Cut a part, chosen by its views, out of a large map."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rholoc.density import DensityKind
from rholoc.geometry import IntArray, ranges
from rholoc.maps.display import Cloud, Room
from rholoc.maps.map import Map


@dataclass(frozen=True, eq=False)
class MapPart:
    """Some views of a map, and all landmarks that they saw.

    Attributes:
        map: with only these, without the cloud and the room.
        features: (P,) the rows of its features in the whole map, ascending.
    """

    map: Map
    features: IntArray


def part_of(map_: Map, views: IntArray) -> MapPart:
    """The part of a map of ``ray`` form with the views in rows ``views`` (N,), ascending; in time by its size."""
    assert map_.info.density is DensityKind.RAY
    first, last = map_.view_offsets[views], map_.view_offsets[views + 1]
    rows = ranges(first, last)
    features, own = np.unique(map_.observations.features[rows], return_inverse=True)
    described = np.searchsorted(map_.descriptors.features, features, side="left")
    described_end = np.searchsorted(map_.descriptors.features, features, side="right")
    descriptors = map_.descriptors.take(ranges(described, described_end))
    owners = np.repeat(np.arange(len(features), dtype=np.int32), described_end - described)
    own_views = np.repeat(np.arange(len(views), dtype=np.int32), last - first)
    part = replace(
        map_,
        landmarks=map_.landmarks.take(features),
        descriptors=replace(descriptors, features=owners),
        views=map_.views.take(views),
        observations=replace(map_.observations.take(rows), views=own_views, features=own.astype(np.int32)),
        cloud=Cloud(),
        room=Room(),
    )
    return MapPart(part, features.astype(np.int64))
