"""SIFT on grey, quick and small: pictures shrunk to 400 px, descriptors shortened to 48 bytes."""

from rholoc.features.extractors._sift import SiftExtractor

EXTRACTOR = SiftExtractor("sift48", longest_px=400, quick_px=288, descriptor_bytes=48, exact=True)
