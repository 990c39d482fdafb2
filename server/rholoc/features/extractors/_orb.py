"""ORB on chosen channels of an image, which the colour extractors share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike

from rholoc.features.feature_set import Channel, FeatureSet, Metric
from rholoc.geometry import ByteArray

DESCRIPTOR_BYTES = 32
_PATCH_PX = 31  # what a descriptor is computed from: a smaller image has no features; OpenCV fails on a single pixel
_SCALE_STEP = 1.2
_LEVELS = 8
_FAST_THRESHOLD = 7  # grey levels; low, so that dim and soft images still give features: the best are kept anyway


def split(image: ArrayLike) -> list[ByteArray]:
    """An image (H, W, C) as C images (H, W)."""
    return [np.ascontiguousarray(plane) for plane in np.moveaxis(np.asarray(image, dtype=np.uint8), 2, 0)]


Split = Callable[[ByteArray], list[ByteArray]]


def as_bgr(image: ByteArray) -> ByteArray:
    """A grey (H, W) or BGR (H, W, 3) image as BGR."""
    return cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image  # type: ignore[return-value]


def as_gray(image: ByteArray) -> ByteArray:
    """A grey (H, W) or BGR (H, W, 3) image as grey."""
    return image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)  # type: ignore[return-value]


def to_feature_set(
    keypoints: list[cv2.KeyPoint], descriptors: ByteArray | None, channel: Channel, descriptor_bytes: int
) -> FeatureSet:
    """OpenCV's keypoints and descriptors of one channel as a feature set."""
    if descriptors is None or not keypoints:
        return FeatureSet.empty(descriptor_bytes)
    return FeatureSet(
        pixels=np.asarray(cv2.KeyPoint.convert(keypoints), dtype=np.float32),
        channels=np.full(len(keypoints), channel, dtype=np.uint8),
        descriptors=np.asarray(descriptors, dtype=np.uint8),
        sizes=np.array([k.size for k in keypoints], dtype=np.float32),
        angles=np.deg2rad(np.array([k.angle for k in keypoints], dtype=np.float32)),
    )


@dataclass(frozen=True)
class OrbExtractor:
    """ORB (Rublee et al., 2011) run separately on each channel, the paper's way (section 5).

    Attributes:
        name: the name by which users choose it.
        channels: the channels, in the order that ``split`` gives them.
        split: BGR image → one (H, W) image per channel.
        features_per_channel: maximum number of features of a channel.
    """

    name: str
    channels: tuple[Channel, ...]
    split: Split
    features_per_channel: int = 500
    metric: Metric = Metric.HAMMING
    descriptor_bytes: int = DESCRIPTOR_BYTES

    @property
    def quick(self) -> OrbExtractor:
        """This extractor itself."""
        return self

    def extract(self, image: ByteArray) -> FeatureSet:
        """Features of an image (H, W, 3) BGR or (H, W) grey, channel after channel; none if a side is below 31 px."""
        if min(image.shape[:2]) < _PATCH_PX:
            return FeatureSet.empty(DESCRIPTOR_BYTES)
        sets = []
        for channel, plane in zip(self.channels, self.split(image), strict=True):
            orb = cv2.ORB_create(  # type: ignore[attr-defined]
                self.features_per_channel, _SCALE_STEP, _LEVELS, fastThreshold=_FAST_THRESHOLD
            )
            keypoints, descriptors = orb.detectAndCompute(plane, None)
            sets.append(to_feature_set(keypoints, descriptors, channel, DESCRIPTOR_BYTES))
        return FeatureSet.concatenate(sets)
