"""SIFT on grey: slower, and the better matcher."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from rholoc.features.extractors._orb import as_gray, to_feature_set
from rholoc.features.feature_set import Channel, FeatureSet, Metric
from rholoc.geometry import ByteArray


@dataclass(frozen=True)
class SiftExtractor:
    """OpenCV's SIFT (Lowe, 2004) with the square-root normalisation of Arandjelović and Zisserman (2012).

    Descriptors are stored as bytes: 512 √(d / Σd), at most 255.
    """

    name: str = "sift"
    channels: tuple[Channel, ...] = (Channel.SIFT,)
    metric: Metric = Metric.EUCLIDEAN
    descriptor_bytes: int = 128
    features: int = 1000
    contrast_threshold: float = 0.02

    def extract(self, image: ByteArray) -> FeatureSet:
        """The features of an image (H, W, 3) in BGR order or (H, W) grey, uint8."""
        sift = cv2.SIFT_create(nfeatures=self.features, contrastThreshold=self.contrast_threshold)  # type: ignore[attr-defined]
        keypoints, descriptors = sift.detectAndCompute(as_gray(image), None)
        if descriptors is not None:
            total = np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-6)
            descriptors = np.minimum(np.rint(512 * np.sqrt(descriptors / total)), 255).astype(np.uint8)
        return to_feature_set(keypoints, descriptors, Channel.SIFT, self.descriptor_bytes)


EXTRACTOR = SiftExtractor()
