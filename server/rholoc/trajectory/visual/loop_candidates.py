"""Choose pairs of keyframes to match: neighbours in time, and loop candidates."""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Collection, Sequence

import numpy as np

from rholoc.features import FeatureSet
from rholoc.features.picture_vectors import Vlad
from rholoc.geometry import FloatArray, IntArray

Pair = tuple[int, int]

MAX_EXHAUSTIVE = 100  # pictures, up to which all pairs are matched
_ALIKE_EACH = 20  # most similar pictures to match each picture of a larger set with
_BESIDE = (1, 2, 3, 4, 6, 8)  # offsets of neighbours in a larger set, which may be in the order of a walk


def sequential_pairs(count: int, distances: Sequence[int]) -> list[Pair]:
    """Pairs of each of ``count`` keyframes with those ``distances`` numbers later."""
    return [(i, i + d) for i in range(count) for d in distances if i + d < count]


def loop_candidates(features: Sequence[FeatureSet], apart: int, each: int) -> list[Pair]:
    """Sorted pairs of each keyframe with the ``each`` most similar ones at least ``apart`` in the sequence; none
    without features.

    Retrieval by VLAD (:mod:`rholoc.features.picture_vectors`), trained on these keyframes' descriptors. Skips the
    neighbours of a chosen pair, so that one place does not take all.
    """
    vectors = _vectors(features)
    if not vectors.any():
        return []
    pairs: set[Pair] = set()
    for i, vector in enumerate(vectors):
        row = vectors @ vector
        chosen: list[int] = []
        for j in np.argsort(-row, kind="stable").tolist():
            if len(chosen) == each:
                break
            if abs(j - i) >= apart and all(abs(j - k) > 1 for k in chosen):
                chosen.append(j)
        pairs.update((min(i, j), max(i, j)) for j in chosen)
    return sorted(pairs)


def picture_pairs(features: Sequence[FeatureSet]) -> list[Pair]:
    """Sorted pairs of unordered pictures that may overlap.

    All pairs of up to ``MAX_EXHAUSTIVE`` pictures; else neighbours by number and each one's 20 most similar by VLAD.
    """
    count = len(features)
    if count <= MAX_EXHAUSTIVE:
        return list(itertools.combinations(range(count), 2))
    return sorted({*sequential_pairs(count, _BESIDE), *most_alike(features, _ALIKE_EACH)})


def most_alike(features: Sequence[FeatureSet], each: int) -> list[Pair]:
    """Pairs of every picture with its ``each`` most similar pictures by VLAD."""
    alike = _similarities(features)
    nearest = np.argsort(-alike, axis=1, kind="stable")[:, :each]
    return sorted({(min(i, j), max(i, j)) for i, row in enumerate(nearest.tolist()) for j in row})


def least_alike(features: Sequence[FeatureSet], sharpness: FloatArray, count: int) -> IntArray:
    """Choose ``count`` of N pictures, by repeatedly dropping the less sharp of the two most similar ones.

    Returns their rows (count,), increasing. They cover as much as all pictures, with as little redundancy as possible.

    Args:
        features: of N pictures.
        sharpness: (N,) any measure that grows with sharpness.
        count: number of pictures to keep.
    """
    alike, kept = _similarities(features), np.ones(len(features), dtype=np.bool_)
    for _ in range(len(features) - count):
        first, second = np.unravel_index(alike.argmax(), alike.shape)
        out = first if sharpness[first] < sharpness[second] else second
        kept[out] = False
        alike[out] = alike[:, out] = -np.inf
    return np.flatnonzero(kept)


def _similarities(features: Sequence[FeatureSet]) -> FloatArray:
    """Similarity (N, N) of pictures by VLAD; -inf on the diagonal."""
    vectors = _vectors(features)
    alike = vectors @ vectors.T
    np.fill_diagonal(alike, -np.inf)
    return np.asarray(alike)


def _vectors(features: Sequence[FeatureSet]) -> FloatArray:
    """VLAD vectors (N, D) of pictures on words learned from them; zeros without any feature."""
    if not any(len(found) for found in features):
        return np.zeros((len(features), 1))
    descriptors = [found.descriptors for found in features]
    return Vlad(descriptors).vectors(descriptors)


def transitive_pairs(pairs: Sequence[Pair], tried: Collection[Pair]) -> list[Pair]:
    """Sorted pairs of pictures that both overlap a third one by ``pairs`` and have not been ``tried``."""
    beside: dict[int, set[int]] = defaultdict(set)
    for a, b in pairs:
        beside[a].add(b)
        beside[b].add(a)
    both = {pair for others in beside.values() for pair in itertools.combinations(sorted(others), 2)}
    return sorted(both.difference(tried))
