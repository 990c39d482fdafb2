"""Which pairs of keyframes to match: neighbours in time, and places seen again."""

from __future__ import annotations

from collections.abc import Sequence

import faiss
import numpy as np

from rholoc.features import FeatureSet
from rholoc.geometry import FloatArray

Pair = tuple[int, int]

_WORDS = 64
_TRAINING_DESCRIPTORS = 20_000
_SEED = 1


def sequential_pairs(count: int, distances: Sequence[int]) -> list[Pair]:
    """Every keyframe with those that many keyframes later."""
    return [(i, i + d) for i in range(count) for d in distances if i + d < count]


def loop_candidates(features: Sequence[FeatureSet], apart: int, each: int) -> list[Pair]:
    """Pairs of keyframes at least ``apart`` in the sequence that look alike: at most ``each`` per keyframe.

    Retrieval by VLAD (Jégou et al., 2010), its words trained on these keyframes' own descriptors. Neighbours of a pair
    already chosen for the same keyframe are passed over, so that one place does not take all.
    """
    if not any(len(found) for found in features):
        return []
    vectors = _vlad(features)
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


def _vlad(features: Sequence[FeatureSet]) -> FloatArray:
    descriptors = np.concatenate([f.descriptors for f in features]).astype(np.float32)
    image = np.repeat(np.arange(len(features)), [len(f) for f in features])
    rng = np.random.default_rng(_SEED)
    training = descriptors[rng.permutation(len(descriptors))[:_TRAINING_DESCRIPTORS]]
    words = min(_WORDS, max(1, len(training) // 40))
    kmeans = faiss.Kmeans(descriptors.shape[1], words, niter=12, seed=_SEED)
    kmeans.train(training)
    centroids = np.asarray(kmeans.centroids)
    _, word = kmeans.index.search(descriptors, 1)
    residuals = descriptors - centroids[word[:, 0]]
    residuals /= np.maximum(np.linalg.norm(residuals, axis=1, keepdims=True), 1e-9)
    vectors = np.zeros((len(features), words, descriptors.shape[1]), np.float32)
    np.add.at(vectors, (image, word[:, 0]), residuals)
    vectors /= np.maximum(np.linalg.norm(vectors, axis=2, keepdims=True), 1e-9)
    flat = vectors.reshape(len(features), -1)
    return np.asarray(flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-9))
