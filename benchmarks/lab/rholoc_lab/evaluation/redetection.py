"""Repeatability of features under a change, and precision of mutual matches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from rholoc.features import FeatureSet, Metric
from rholoc.features.matching import mutual_matches
from rholoc.geometry import BoolArray, FloatArray

SAME_POINT_PX = 3.0
"""Features no further apart than this are at the same point."""


@dataclass(frozen=True)
class Redetection:
    """Counts of one pair of images, or of many.

    Attributes:
        visible: features of the first image with a visible point in the second.
        redetected: visible features with a feature of the same channel at the same point of the second image.
        matches: mutual nearest neighbours by descriptor, at any distance.
        right: matches at the same point.
    """

    visible: int
    redetected: int
    matches: int
    right: int

    @classmethod
    def total(cls, parts: Sequence[Redetection]) -> Redetection:
        """The sums over several pairs of images."""
        return cls(
            sum(p.visible for p in parts),
            sum(p.redetected for p in parts),
            sum(p.matches for p in parts),
            sum(p.right for p in parts),
        )

    @property
    def repeatability(self) -> float | None:
        """The share 0..1 of visible features that are redetected; None where none is visible."""
        return self.redetected / self.visible if self.visible else None

    @property
    def precision(self) -> float | None:
        """The share 0..1 of matches that are right; None where there is none."""
        return self.right / self.matches if self.matches else None

    def figures(self) -> dict[str, Any]:
        """The figures, JSON-serialisable."""
        return {"repeatability": self.repeatability, "precision": self.precision, "right_matches": self.right}


def redetection(a: FeatureSet, b: FeatureSet, where_in_b: FloatArray, metric: Metric) -> Redetection:
    """Compare the features of two images.

    Args:
        where_in_b: (N, 2) the pixel of the second image that shows the point of each of ``a``'s N features; NaN where
            it is hidden there.
    """
    visible = np.asarray(np.isfinite(where_in_b).all(axis=1))
    matches = mutual_matches(a, b, metric, np.inf)
    apart = np.linalg.norm(where_in_b[matches[:, 0]] - b.pixels[matches[:, 1]], axis=1)
    return Redetection(
        visible=int(visible.sum()),
        redetected=int(_redetected(a, b, where_in_b, visible).sum()),
        matches=len(matches),
        right=int((apart <= SAME_POINT_PX).sum()),  # NaN is not
    )


def _redetected(a: FeatureSet, b: FeatureSet, where_in_b: FloatArray, visible: BoolArray) -> BoolArray:
    found = np.zeros(len(a), dtype=bool)
    for channel in np.unique(a.channels):
        mine = np.flatnonzero(visible & (a.channels == channel))
        others = b.pixels[b.channels == channel]
        if len(mine) and len(others):
            found[mine] = cKDTree(others).query(where_in_b[mine])[0] <= SAME_POINT_PX
    return found
