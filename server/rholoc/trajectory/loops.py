"""Which pairs of keyframes to match: neighbours in time, and places seen again."""

from __future__ import annotations

from collections.abc import Sequence

import faiss
import numpy as np

from rholoc.features import FeatureSet
from rholoc.geometry import FloatArray
from rholoc.trajectory.two_view import VerifiedPair

Pair = tuple[int, int]

_WORDS = 64
_TRAINING_DESCRIPTORS = 20_000
_SEED = 1
_STRONG_INLIERS = 100
_BESIDE = 2  # keyframes


def sequential_pairs(count: int, overlap: int) -> list[Pair]:
    """Every keyframe with the next ``overlap``, and with those at distances 2ⁿ up to twice that."""
    distances = sorted({*range(1, overlap + 1), 2 * overlap})
    return [(i, i + d) for i in range(count) for d in distances if i + d < count]


def loop_candidates(features: Sequence[FeatureSet], apart: int, each: int) -> list[Pair]:
    """Pairs of keyframes at least ``apart`` in the sequence that look alike: at most ``each`` per keyframe.

    Retrieval by VLAD (Jégou et al., 2010), its words trained on these keyframes' own descriptors. Neighbours of a pair
    already chosen for the same keyframe are passed over, so that one place does not take all.
    """
    vectors = _vlad(features)
    alike = vectors @ vectors.T
    pairs: set[Pair] = set()
    for i, row in enumerate(alike):
        others = [j for j in np.argsort(-row, kind="stable") if abs(int(j) - i) >= apart]
        chosen: list[int] = []
        for j in others:
            if len(chosen) == each:
                break
            if all(abs(int(j) - k) > 1 for k in chosen):
                chosen.append(int(j))
        pairs.update((min(i, j), max(i, j)) for j in chosen)
    return sorted(pairs)


def supported_loops(pairs: Sequence[VerifiedPair]) -> list[VerifiedPair]:
    """The loop pairs with many inliers, or with another loop pair beside them: a chance likeness stands alone."""
    places = np.array([(pair.first, pair.second) for pair in pairs]).reshape(-1, 2)
    kept = []
    for pair, place in zip(pairs, places, strict=True):
        beside = np.abs(places - place).max(axis=1) <= _BESIDE
        if len(pair.matches) >= _STRONG_INLIERS or beside.sum() > 1:
            kept.append(pair)
    return kept


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
