"""ORB on LAB's L, A and B: prefixes 00, 01 and 02."""

import cv2

from rholoc.features.extractors._orb import OrbExtractor, as_bgr, split
from rholoc.features.feature_set import Channel

EXTRACTOR = OrbExtractor(
    "lab3",
    (Channel.L, Channel.A, Channel.B),
    lambda image: split(cv2.cvtColor(as_bgr(image), cv2.COLOR_BGR2LAB)),
)
