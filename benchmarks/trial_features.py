"""Features that are only tried, beside those that rholoc has: what benchmarks/features_table.py compares."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import cv2
import numpy as np

from rholoc.features import Extractor, FeatureSet, Metric
from rholoc.features import extractors as installed
from rholoc.features.extractors._sift import SiftExtractor
from rholoc.features.extractors.xfeat import XFeatExtractor
from rholoc.geometry import ByteArray

_small = partial(SiftExtractor, longest_px=400, exact=True)
_RINGS = (1.0, 3.0)  # times a feature's size: the squares that its colours are taken over
_COLOUR_WEIGHT = 2.0  # descriptor units for a unit of LAB


@dataclass(frozen=True)
class ColouredSift:
    """SIFT on lightness with the colour (LAB's A and B) of its patch and of what is around behind each descriptor."""

    name: str
    sift: SiftExtractor

    @property
    def channels(self) -> Any:
        """SIFT's."""
        return self.sift.channels

    @property
    def metric(self) -> Metric:
        """SIFT's."""
        return self.sift.metric

    @property
    def descriptor_bytes(self) -> int:
        """Two more for each square."""
        return self.sift.descriptor_bytes + 2 * len(_RINGS)

    @property
    def quick(self) -> ColouredSift:
        """The same in smaller pictures."""
        return self if self.sift.quick is self.sift else replace(self, sift=self.sift.quick)

    def extract(self, image: ByteArray) -> FeatureSet:
        """The features of an image (H, W, 3) in BGR order."""
        lab = cv2.cvtColor(image, cv2.COLOR_BGR2LAB)
        found = self.sift.extract(np.ascontiguousarray(lab[..., 0]))
        sums = cv2.integral(lab[..., 1:])
        height, width = lab.shape[:2]
        colours = []
        for ring in _RINGS:
            half = np.maximum(0.5 * ring * found.sizes, 1)[:, None]
            low = np.clip(found.pixels - half, 0, (width - 1, height - 1)).astype(int)
            high = np.clip(found.pixels + half + 1, low + 1, (width, height)).astype(int)
            (left, top), (right, bottom) = low.T, high.T
            total = sums[bottom, right] - sums[top, right] - sums[bottom, left] + sums[top, left]
            colours.append(128 + _COLOUR_WEIGHT * (total / ((right - left) * (bottom - top))[:, None] - 128))
        shown = np.clip(np.rint(np.hstack(colours)), 0, 255).astype(np.uint8)
        return replace(found, descriptors=np.hstack([found.descriptors, shown]))


TRIALS: tuple[Extractor, ...] = (
    _small("sift, 400 px"),
    _small("sift, 400 px, 64 bytes", quick_px=288, descriptor_bytes=64),
    _small("sift, 400 px, 32 bytes", quick_px=288, descriptor_bytes=32),
    SiftExtractor("sift, 48 bytes", descriptor_bytes=48, exact=True),
    XFeatExtractor("xfeat, 416 px", longest_px=416),
    ColouredSift("sift48 with colour", _small("", quick_px=288, descriptor_bytes=48)),
)


def install() -> None:
    """Make them known to rholoc by name, in this process."""
    installed._registry().update({trial.name: trial for trial in TRIALS})
