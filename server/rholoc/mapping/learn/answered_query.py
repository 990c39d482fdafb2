"""An answered query as far as the map may learn from it: features and pose, not the picture."""

from dataclasses import dataclass

from rholoc.features import FeatureSet
from rholoc.geometry import Camera, FloatArray


@dataclass(frozen=True, eq=False)
class AnsweredQuery:
    """One frame with a confident answer.

    Attributes:
        features: its features, by the map's own extractor.
        camera: its intrinsics, as given.
        T_map_camera: (4, 4) the answer.
        covariance: (6, 6) of the answer: position [m], then rotation [rad], map frame.
        confidence: confidence of the answer, 0 to 1.
        time_s: time of the query since the epoch.
        asker: pseudonym of the client, the same for the same key.
    """

    features: FeatureSet
    camera: Camera
    T_map_camera: FloatArray
    covariance: FloatArray
    confidence: float
    time_s: float
    asker: str
