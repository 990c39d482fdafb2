"""SIFT on grey, whole descriptors of 128 bytes."""

from rholoc.features.extractors._sift import SiftExtractor

EXTRACTOR = SiftExtractor("sift")
