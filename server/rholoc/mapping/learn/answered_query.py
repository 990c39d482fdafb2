"""A query that a map has answered, as far as the map may learn from it: what was seen, from where. Not the picture."""

from __future__ import annotations

from dataclasses import dataclass

from rholoc.features import FeatureSet
from rholoc.geometry import Camera, FloatArray


@dataclass(frozen=True, eq=False)
class AnsweredQuery:
    """One frame that was localized surely.

    Attributes:
        features: what it showed, by the map's own extractor.
        camera: its intrinsics, as they were given.
        T_map_camera: (4, 4) the answer.
        covariance: (6, 6) of it: metres, then radians, map frame.
        confidence: 0..1, of the answer.
        time_s: when it was asked, seconds since the epoch.
        asker: who asked, as a pseudonym; the same for the same key.
    """

    features: FeatureSet
    camera: Camera
    T_map_camera: FloatArray
    covariance: FloatArray
    confidence: float
    time_s: float
    asker: str
