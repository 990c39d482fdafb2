"""The map: features with their densities, and the views that observed them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rholoc.density import Densities, RayDensities
from rholoc.geometry import IntArray
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
