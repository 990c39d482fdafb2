"""Matches: which detection of the query may be which landmark, and how believable that is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rholoc.features import Metric
from rholoc.features.matching import LIMITS
from rholoc.geometry import BoolArray, FloatArray, IntArray

_MIN_CHANCE = 0.02
_MAX_CHANCE = 0.95


@dataclass(frozen=True, eq=False)
class Matches:
    """M matches of detections with landmarks.

    Attributes:
        detections: (M,) rows of the query's features.
        landmarks: (M,) rows of the map's features.
        chances: (M,) 0..1, how likely the match is true by its descriptors alone.
    """

    detections: IntArray
    landmarks: IntArray
    chances: FloatArray

    def __len__(self) -> int:
        return len(self.detections)

    def take(self, index: IntArray) -> Matches:
        """The matches at ``index``, in that order."""
        return Matches(self.detections[index], self.landmarks[index], self.chances[index])

    def likeliest_first(self) -> Matches:
        """The matches by their chances, descending."""
        return self.take(np.argsort(-self.chances, kind="stable"))

    @classmethod
    def none(cls) -> Matches:
        """No matches."""
        nothing = np.zeros(0, dtype=np.int64)
        return cls(nothing, nothing, np.zeros(0))


@dataclass(frozen=True, eq=False)
class NearestLandmarks:
    """The landmarks that each of N features is most like, the most alike first.

    Attributes:
        detections: (N,) rows of the query's features.
        landmarks: (N, K) rows of the map's features, -1 where there are fewer.
        distances: (N, K) between descriptors.
        metric: theirs.
    """

    detections: IntArray
    landmarks: IntArray
    distances: FloatArray
    metric: Metric

    def __len__(self) -> int:
        return len(self.detections)

    def joined(self, others: NearestLandmarks) -> NearestLandmarks:
        """With those of other features."""
        return NearestLandmarks(
            np.concatenate([self.detections, others.detections]),
            np.concatenate([self.landmarks, others.landmarks]),
            np.concatenate([self.distances, others.distances]),
            self.metric,
        )

    def matches(self, mutual: bool = False) -> Matches:
        """Each feature with its nearest landmark; if ``mutual``, only where no other feature is nearer to that."""
        nearest, distances = self.landmarks[:, 0], self.distances[:, 0]
        other = (self.landmarks != nearest[:, None]) & (self.landmarks >= 0)
        rival = np.where(other, self.distances, np.inf).min(axis=1)
        good = (nearest >= 0) & (distances <= LIMITS[self.metric].loose)
        if mutual and len(nearest):
            good &= is_least(distances, nearest, int(nearest.max()) + 1)
        rival = np.where(np.isfinite(rival), rival, self.distances[:, -1])
        chances = match_chances(distances[good], rival[good], self.metric)
        return Matches(self.detections[good], nearest[good], chances)

    def pairs(self) -> Matches:
        """Each feature with every landmark that it is like, each pair's chance by its own likeness alone."""
        rows, ranks = np.nonzero((self.landmarks >= 0) & (self.distances <= LIMITS[self.metric].loose))
        chances = guided_chances(self.distances[rows, ranks], self.metric)
        return Matches(self.detections[rows], self.landmarks[rows, ranks], chances)


def match_chances(distances: FloatArray, rivals: FloatArray, metric: Metric) -> FloatArray:
    """How likely matches are true, from their distance (M,) and that of the nearest rival landmark (M,).

    A logistic in the distance itself and in the lead over the rival.
    """
    limits = LIMITS[metric]
    lead = np.where(np.isfinite(rivals), rivals - distances, limits.strict)
    score = 2.0 * (lead / limits.spread - 1.0) + (limits.strict * 0.6 - distances) / limits.spread
    return np.asarray(np.clip(1 / (1 + np.exp(-score)), _MIN_CHANCE, _MAX_CHANCE))


def guided_chances(distances: FloatArray, metric: Metric) -> FloatArray:
    """How likely matches (M,) are true that were looked for only where the landmark should appear."""
    limits = LIMITS[metric]
    return np.asarray(np.clip(1 / (1 + np.exp((distances - limits.strict) / limits.spread)), 0.1, _MAX_CHANCE))


def is_least(distances: FloatArray, groups: IntArray, count: int) -> BoolArray:
    """Which entries (N,) have the least distance of their group; groups are 0..count-1, or -1."""
    least = np.full(count + 1, np.inf, dtype=distances.dtype)
    np.minimum.at(least, groups, distances)
    return np.asarray(distances <= least[groups])
