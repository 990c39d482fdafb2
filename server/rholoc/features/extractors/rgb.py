"""ORB on red, green and blue, one detector each (paper, section 5)."""

from rholoc.features.extractors._orb import OrbExtractor, as_bgr, split
from rholoc.features.feature_set import Channel

EXTRACTOR = OrbExtractor("rgb", (Channel.BLUE, Channel.GREEN, Channel.RED), lambda image: split(as_bgr(image)))
