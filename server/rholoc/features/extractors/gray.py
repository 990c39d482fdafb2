"""ORB on grey."""

from rholoc.features.extractors._orb import OrbExtractor, as_gray
from rholoc.features.feature_set import Channel

EXTRACTOR = OrbExtractor("gray", (Channel.L,), lambda image: [as_gray(image)], features_per_channel=1000)
