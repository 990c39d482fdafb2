"""Matches between the query's detections and the map's landmarks, each with its probability of being true."""

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
        chances: (M,) probability that each match is true, from descriptors alone.
    """

    detections: IntArray
    landmarks: IntArray
    chances: FloatArray

    def __len__(self) -> int:
        return len(self.detections)

    def take(self, index: IntArray) -> Matches:
        """Matches in the rows ``index``, in that order."""
        return Matches(self.detections[index], self.landmarks[index], self.chances[index])

    def among(self, landmarks: IntArray) -> Matches:
        """Matches with the given landmarks (P,)."""
        return self.take(np.flatnonzero(np.isin(self.landmarks, landmarks)))

    def likeliest_first(self, most: int | None = None) -> Matches:
        """Matches sorted by descending probability; the first ``most`` of them, if given."""
        return self.take(np.argsort(-self.chances, kind="stable")[:most])

    @classmethod
    def none(cls) -> Matches:
        """An empty set of matches."""
        nothing = np.zeros(0, dtype=np.int64)
        return cls(nothing, nothing, np.zeros(0))


@dataclass(frozen=True, eq=False)
class NearestLandmarks:
    """The K nearest landmarks of each of N features, nearest first.

    Attributes:
        detections: (N,) rows of the query's features.
        landmarks: (N, K) rows of the map's features; -1 if there are fewer than K.
        distances: (N, K) descriptor distances.
        metric: metric of the distances.
    """

    detections: IntArray
    landmarks: IntArray
    distances: FloatArray
    metric: Metric

    def __len__(self) -> int:
        return len(self.detections)

    def joined(self, others: NearestLandmarks) -> NearestLandmarks:
        """Concatenation with the nearest landmarks of other features; their K must be equal."""
        return NearestLandmarks(
            np.concatenate([self.detections, others.detections]),
            np.concatenate([self.landmarks, others.landmarks]),
            np.concatenate([self.distances, others.distances]),
            self.metric,
        )

    def matches(self, mutual: bool = False) -> Matches:
        """Match each feature with its nearest landmark, if within the loose descriptor limit; if ``mutual``, only if no
        other feature is nearer to that landmark.
        """
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
        """Pair each feature with each of its nearest landmarks within the loose descriptor limit; probabilities by
        :func:`guided_chances`.
        """
        rows, ranks = np.nonzero((self.landmarks >= 0) & (self.distances <= LIMITS[self.metric].loose))
        chances = guided_chances(self.distances[rows, ranks], self.metric)
        return Matches(self.detections[rows], self.landmarks[rows, ranks], chances)


def match_chances(distances: FloatArray, rivals: FloatArray, metric: Metric) -> FloatArray:
    """Probability (M,), 0.02 to 0.95, that matches are true: logistic in the distance and in the margin over the rival.

    Args:
        distances: (M,) to the matched landmark.
        rivals: (M,) to the nearest other landmark; not finite if there is none.
        metric: metric of the distances.
    """
    limits = LIMITS[metric]
    lead = np.where(np.isfinite(rivals), rivals - distances, limits.strict)
    score = 2.0 * (lead / limits.spread - 1.0) + (limits.strict * 0.6 - distances) / limits.spread
    return np.asarray(np.clip(1 / (1 + np.exp(-score)), _MIN_CHANCE, _MAX_CHANCE))


def guided_chances(distances: FloatArray, metric: Metric) -> FloatArray:
    """Probability (M,), 0.1 to 0.95, that matches are true that were searched only near the projected landmark.

    Logistic in the descriptor ``distances`` (M,) alone: one half at the metric's strict limit.
    """
    limits = LIMITS[metric]
    return np.asarray(np.clip(1 / (1 + np.exp((distances - limits.strict) / limits.spread)), 0.1, _MAX_CHANCE))


def is_least(distances: FloatArray, groups: IntArray, count: int) -> BoolArray:
    """Mask (N,) of the smallest distance in each group (several if equal). ``groups`` (N,) are 0 to count-1, or -1 for
    none, which forms a group too.
    """
    least = np.full(count + 1, np.inf, dtype=distances.dtype)
    np.minimum.at(least, groups, distances)
    return np.asarray(distances <= least[groups])
