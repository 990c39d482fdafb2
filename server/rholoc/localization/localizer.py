"""Frame → pose: the localizer of one map."""

from __future__ import annotations

from rholoc.features import Extractor, get_extractor
from rholoc.localization.types import Localization, Query
from rholoc.maps import Map


class Localizer:
    """Localizes frames in one map. Building it makes the index; calls may come from several threads.

    Args:
        map_: the map.
        min_confidence: answers below it are refused (``localized`` False, reason ``low_confidence``).
    """

    def __init__(self, map_: Map, min_confidence: float = 0.5) -> None:
        self.map = map_
        self.min_confidence = min_confidence

    @property
    def extractor(self) -> Extractor:
        """The extractor whose features the map is made of."""
        return get_extractor(self.map.info.features)

    def localize(self, query: Query) -> Localization:
        """The pose of one frame, by equation (1).

        Raises:
            InvalidDescriptors: the features are not of the map's kind.
        """
        raise NotImplementedError
