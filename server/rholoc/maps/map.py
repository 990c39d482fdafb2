"""The map: features with their densities, and the views that observed them; and parts of a large one."""

from dataclasses import dataclass, replace

import numpy as np

from rholoc.density import Densities, DensityKind, RayDensities
from rholoc.geometry import IntArray, ranges
from rholoc.lazy import lazy
from rholoc.maps.display import Cloud, Room
from rholoc.maps.info import MapInfo
from rholoc.maps.map_tables import MapDescriptors, MapLandmarks, MapObservations, MapViews


@dataclass(frozen=True, eq=False)
class Map:
    """F features seen in K views (keyframes), V observations in all.

    Attributes:
        info: the map's description.
        landmarks: F rows.
        descriptors: D rows, sorted by feature.
        views: K rows.
        observations: V rows, sorted by view.
        cloud: further points of the room, for people to see.
        room: surfaces of the room, for people to see.
        plan: the file of its floor plan, empty if it has none; ``info.plan`` describes it.
        densities: of all features, in the map's form.
    """

    info: MapInfo
    landmarks: MapLandmarks
    descriptors: MapDescriptors
    views: MapViews
    observations: MapObservations
    cloud: Cloud = Cloud()  # noqa: RUF009 - it is frozen
    room: Room = Room()  # noqa: RUF009 - it is frozen
    plan: bytes = b""
    densities: Densities = RayDensities()  # noqa: RUF009 - it is frozen

    def __len__(self) -> int:
        return len(self.landmarks)

    @lazy
    def view_offsets(self) -> IntArray:
        """(K + 1,) int32: the observations of view k are rows view_offsets[k] : view_offsets[k + 1]."""
        return np.searchsorted(self.observations.views, np.arange(len(self.views) + 1)).astype(np.int32)


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
    """The part of a map of ``ray`` form with the views in rows ``views`` (N,), ascending."""
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
