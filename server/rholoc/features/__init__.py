"""Image → features: detectors on chosen channels of a colour space, and their matching."""

from rholoc.features.extractors import Extractor, extractor_names, get_extractor, widened
from rholoc.features.feature_set import Channel, FeatureSet, Metric

__all__ = ["Channel", "Extractor", "FeatureSet", "Metric", "extractor_names", "get_extractor", "widened"]
