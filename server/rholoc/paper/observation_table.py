"""Table 4 of what a map remembers."""

import numpy as np

from rholoc.maps import Map, ObservationTable, check_memory


def observation_table(map_: Map) -> ObservationTable:
    """The observations of a map: each feature's pixel in a view and the view's pose, in the order of the views.

    A map keeps a feature's descriptors, not one for each observation: the first, which stands for the feature in a
    search of the whole map, is given to all of them.

    Raises:
        InvalidInput: the map does not remember its observations.
        InvalidMap: its observations contradict the rest of the map.
    """
    pixels = check_memory(map_, "The map").pixels
    features, views = map_.observations.features, map_.observations.views
    first_descriptor = np.searchsorted(map_.descriptors.features, np.arange(len(map_)))
    return ObservationTable(
        channels=map_.landmarks.channels[features],
        descriptors=map_.descriptors.values[first_descriptor[features]],
        pixels=pixels,
        positions=map_.views.positions[views],
        headings=map_.views.headings[views],
    )
