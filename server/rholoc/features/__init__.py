"""Image → features: detectors on chosen channels of a colour space, and their matching."""

from rholoc.features.extractors import DEFAULT_FEATURES, Extractor, extractor_names, get_extractor, widened
from rholoc.features.feature_set import Channel, FeatureSet, Metric

__all__ = [
    "DEFAULT_FEATURES",
    "Channel",
    "Extractor",
    "FeatureSet",
    "Metric",
    "extractor_names",
    "get_extractor",
    "widened",
]
