"""ORB on LAB's A and B: the paper's light-resistant features, prefixes 01 and 02 (paper, section 5)."""

import cv2

from rholoc.features.extractors._orb import OrbExtractor, as_bgr, split
from rholoc.features.feature_set import Channel

EXTRACTOR = OrbExtractor(
    "lab", (Channel.A, Channel.B), lambda image: split(cv2.cvtColor(as_bgr(image), cv2.COLOR_BGR2LAB))[1:]
)
