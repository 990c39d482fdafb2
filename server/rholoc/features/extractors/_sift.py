"""SIFT with the square-root normalisation, at a choice of scales and descriptor lengths."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files

import cv2
import numpy as np

from rholoc.features.extractors._orb import as_gray
from rholoc.features.feature_set import Channel, FeatureSet, Metric
from rholoc.geometry import ByteArray, FloatArray
from rholoc.lazy import lazy

FULL_BYTES = 128
LENGTH = 512.0  # of a whole descriptor, in the unit of its bytes
_CENTRE = 128  # the byte that stands for 0 in a shortened descriptor
_BASIS_FILE = "sift_basis.npy"


@dataclass(frozen=True)
class SiftExtractor:
    """OpenCV's SIFT (Lowe, 2004) with the square-root normalisation of Arandjelović and Zisserman (2012).

    Attributes:
        name: the name by which users choose it.
        features: maximum number of features of an image.
        contrast_threshold: of the difference of Gaussians; lower finds more in dim and soft pictures.
        longest_px: images with a longer side are shrunk to it first. SIFT doubles the image, so that most of its
            time goes into a scale finer than a camera resolves; at half the size it costs a third.
        quick_px: the same for its ``quick`` variant, or None if it has none.
        descriptor_bytes: 128 for RootSIFT, 512 √(d / Σd) clipped to 255. Fewer for its projection on principal
            components, rotated so that all bytes carry equal variance, and shifted by 128; distances nearly stay.
        exact: whether pixel positions are exact; otherwise all are a quarter of a pixel off in the searched image,
            to the right and below (OpenCV's default). That cancels between pictures of one size, and only there.
    """

    name: str = "sift"
    features: int = 1000
    contrast_threshold: float = 0.02
    longest_px: int | None = None
    quick_px: int | None = None
    descriptor_bytes: int = FULL_BYTES
    exact: bool = False
    channels: tuple[Channel, ...] = (Channel.SIFT,)
    metric: Metric = Metric.EUCLIDEAN

    @lazy
    def quick(self) -> SiftExtractor:
        """The same with ``quick_px`` as ``longest_px``; itself if ``quick_px`` is None."""
        return self if self.quick_px is None else replace(self, longest_px=self.quick_px, quick_px=None)

    def extract(self, image: ByteArray) -> FeatureSet:
        """The features of an image (H, W, 3) in BGR order or (H, W) grey, uint8."""
        grey = as_gray(image)
        height, width = grey.shape
        shrink = 1.0 if self.longest_px is None else min(1.0, self.longest_px / max(height, width))
        size = max(1, round(width * shrink)), max(1, round(height * shrink))
        if size != (width, height):
            grey = np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        sift = cv2.SIFT_create(  # type: ignore[attr-defined]
            nfeatures=self.features, contrastThreshold=self.contrast_threshold, enable_precise_upscale=self.exact
        )
        keypoints, descriptors = sift.detectAndCompute(grey, None)
        if descriptors is None or not keypoints:
            return FeatureSet.empty(self.descriptor_bytes)
        scale = np.array([width / size[0], height / size[1]])
        pixels = (np.asarray(cv2.KeyPoint.convert(keypoints)) + 0.5) * scale - 0.5  # pixel centres stay where they are
        sizes = np.array([k.size for k in keypoints]) * float(np.sqrt(scale.prod()))
        return FeatureSet(
            pixels=pixels.astype(np.float32),
            channels=np.full(len(keypoints), Channel.SIFT, dtype=np.uint8),
            descriptors=shortened(root_sift(descriptors), self.descriptor_bytes),
            sizes=sizes.astype(np.float32),
            angles=np.deg2rad(np.array([k.angle for k in keypoints], dtype=np.float32)),
        )


def root_sift(descriptors: FloatArray) -> FloatArray:
    """SIFT descriptors (N, 128) → their square roots, of length 512: Euclidean distances become Hellinger's."""
    total = np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-6)
    return np.asarray(LENGTH * np.sqrt(descriptors / total), dtype=np.float32)


def shortened(descriptors: FloatArray, size: int) -> ByteArray:
    """Descriptors (N, 128) of length 512 as ``size`` bytes each: rounded if 128, else projected and shifted by 128."""
    if size == FULL_BYTES:
        return np.asarray(np.minimum(np.rint(descriptors), 255).astype(np.uint8))
    mean, basis = _basis(size)
    return np.asarray(np.clip(np.rint((descriptors - mean) @ basis) + _CENTRE, 0, 255).astype(np.uint8))


@cache
def _basis(size: int) -> tuple[FloatArray, FloatArray]:
    """The mean (128,) and the basis (128, ``size``), made by benchmarks/train_bases.py."""
    with files(__package__).joinpath(_BASIS_FILE).open("rb") as file:
        stored = np.load(file, allow_pickle=False).astype(np.float32)
    mean, directions = stored[0], stored[1:]
    return mean, np.asarray(directions[:size].T @ evening_rotation(size), dtype=np.float32)


def evening_rotation(size: int) -> FloatArray:
    """A fixed random rotation (size, size) that spreads the variance of a projection evenly over its bytes."""
    q, r = np.linalg.qr(np.random.default_rng(size).normal(size=(size, size)))
    return np.asarray(q * np.sign(np.diag(r)), dtype=np.float32)
