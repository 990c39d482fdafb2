"""Which pairs of keyframes to match: neighbours in time, and places seen again."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rholoc.features import FeatureSet
from rholoc.features.vlad import Vlad

Pair = tuple[int, int]


def sequential_pairs(count: int, distances: Sequence[int]) -> list[Pair]:
    """Every keyframe with those that many keyframes later."""
    return [(i, i + d) for i in range(count) for d in distances if i + d < count]


def loop_candidates(features: Sequence[FeatureSet], apart: int, each: int) -> list[Pair]:
    """Pairs of keyframes at least ``apart`` in the sequence that look alike: at most ``each`` per keyframe.

    Retrieval by VLAD (:mod:`rholoc.features.vlad`), its words trained on these keyframes' own descriptors.
    Neighbours of a pair already chosen for the same keyframe are passed over, so that one place does not take all.
    """
    if not any(len(found) for found in features):
        return []
    descriptors = [found.descriptors for found in features]
    vectors = Vlad(descriptors).vectors(descriptors)
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
