"""The features of one image, as arrays."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum, StrEnum

import cv2
import numpy as np

from rholoc.errors import InvalidDescriptors
from rholoc.geometry import ByteArray, FloatArray, IntArray
from rholoc.lazy import lazy

_SAMPLED, _WORTH_SAMPLING = 250, 1.5  # features; times as many, below which all are taken
_COLOUR_PX = 5  # the side of the square over which a feature's colour is averaged


class Channel(IntEnum):
    """The image channel a feature was detected in; its value is the descriptor's prefix in files and requests.

    01 and 02 are the paper's prefixes for A and B.
    """

    L = 0  # lightness; also plain grey
    A = 1  # LAB's green–red axis
    B = 2  # LAB's blue–yellow axis
    RED = 3
    GREEN = 4
    BLUE = 5
    SIFT = 16  # SIFT on grey
    XFEAT = 32  # XFeat on grey


class Metric(StrEnum):
    """Metric between two descriptors."""

    HAMMING = "hamming"  # binary descriptors: the number of bits that differ
    EUCLIDEAN = "euclidean"  # byte vectors: the Euclidean distance


@dataclass(frozen=True, eq=False)
class FeatureSet:
    """N features of one image.

    Attributes:
        pixels: (N, 2) float32, u and v.
        channels: (N,) uint8, values of :class:`Channel`.
        descriptors: (N, D) uint8; D is the extractor's ``descriptor_bytes``: 32 (ORB), 128 or 48 (SIFT), 40 (XFeat).
        sizes: (N,) float32, the diameter of the described patch in pixels; 0 where unknown.
        angles: (N,) float32, the patch's orientation in radians, in the image, clockwise from +u; NaN where unknown.
        colours: (N, 3) uint8, red, green and blue of the image there; None where unknown. No match depends on them.

    Raises:
        InvalidDescriptors: the arrays disagree in length or shape, or pixels are not finite.
    """

    pixels: FloatArray
    channels: ByteArray
    descriptors: ByteArray
    sizes: FloatArray
    angles: FloatArray
    colours: ByteArray | None = None

    def __post_init__(self) -> None:
        n = len(self.pixels)
        shapes_agree = (
            self.pixels.shape == (n, 2)
            and self.descriptors.ndim == 2
            and all(len(a) == n for a in (self.channels, self.descriptors, self.sizes, self.angles))
            and (self.colours is None or self.colours.shape == (n, 3))
        )
        if not shapes_agree:
            raise InvalidDescriptors("The features' arrays differ in length.", "Give one row of each per feature.")
        if not np.isfinite(self.pixels).all():
            raise InvalidDescriptors("A feature's pixel is not a finite number.", "Leave such features out.")

    def __len__(self) -> int:
        return len(self.pixels)

    @lazy
    def sample(self) -> IntArray:
        """250 evenly spaced rows, enough to localize most frames; all rows if there are fewer than 375."""
        count = len(self)
        if count < _WORTH_SAMPLING * _SAMPLED:
            return np.arange(count)
        return np.linspace(0, count - 1, _SAMPLED).astype(np.int64)

    def take(self, index: IntArray) -> FeatureSet:
        """The features at ``index`` (K,), in that order."""
        return FeatureSet(
            self.pixels[index],
            self.channels[index],
            self.descriptors[index],
            self.sizes[index],
            self.angles[index],
            None if self.colours is None else self.colours[index],
        )

    def coloured(self, image: ByteArray) -> FeatureSet:
        """The same features with their colours in an image (H, W, 3) BGR: the mean of 5 × 5 pixels."""
        height, width = image.shape[:2]
        u, v = np.round(self.pixels).astype(np.int64).T
        mean = cv2.blur(image, (_COLOUR_PX, _COLOUR_PX))
        colours = mean[np.clip(v, 0, height - 1), np.clip(u, 0, width - 1), ::-1]
        return replace(self, colours=np.asarray(colours, dtype=np.uint8))

    @classmethod
    def empty(cls, descriptor_bytes: int) -> FeatureSet:
        """No features, with descriptors of the given length."""
        nothing = np.zeros(0, np.float32)
        return cls(
            np.zeros((0, 2), np.float32),
            np.zeros(0, np.uint8),
            np.zeros((0, descriptor_bytes), np.uint8),
            nothing,
            nothing,
        )

    @classmethod
    def concatenate(cls, sets: list[FeatureSet]) -> FeatureSet:
        """All features of one or more sets, in order, of one descriptor length; colours only if all sets have them."""
        return cls(
            np.concatenate([s.pixels for s in sets]),
            np.concatenate([s.channels for s in sets]),
            np.concatenate([s.descriptors for s in sets]),
            np.concatenate([s.sizes for s in sets]),
            np.concatenate([s.angles for s in sets]),
            None if any(s.colours is None for s in sets) else np.concatenate([s.colours for s in sets]),
        )
