"""Table 4 of what a map remembers."""

from __future__ import annotations

import numpy as np

from rholoc.mapping.memory import check_memory, observations_of, view_transforms
from rholoc.maps import Map, ObservationTable


def observation_table(map_: Map, what: str = "The map") -> ObservationTable:
    """The observations of a map: who was seen at which pixel from where, in the order of its views.

    A map keeps a feature's descriptors, not one for each observation: the first, which stands for the feature in a
    search of the whole map, is given to all of them. ``what`` names the map to users.

    Raises:
        InvalidInput: the map does not remember its observations.
        InvalidMap: its memory contradicts itself.
    """
    check_memory(map_, what)
    seen = observations_of(map_)
    first_descriptor = np.searchsorted(map_.descriptor_features, np.arange(len(map_)))
    return ObservationTable(
        channels=map_.channels[seen.features],
        descriptors=map_.descriptors[first_descriptor[seen.features]],
        pixels=seen.pixels,
        positions=seen.positions,
        headings=view_transforms(map_)[seen.views, :3, 2],
    )
