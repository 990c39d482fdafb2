"""Choose pairs of keyframes to match: neighbours in time, and loop candidates."""

import itertools
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from rholoc.features import FeatureSet
from rholoc.features.picture_vectors import Vlad
from rholoc.geometry import FloatArray, IntArray
from rholoc.trajectory.visual.two_view import ratio_matches, unit_descriptors

Pair = tuple[int, int]

_THREADS = 2
_MAX_EXHAUSTIVE = 50  # pictures, up to which all pairs are matched …
_MAX_COMPARED = 300  # … and up to which all are compared by their largest features
_ALIKE_EACH = 60  # most similar pictures to compare each picture of a larger set with
_BESIDE = (1, 2, 3, 4, 6, 8)  # offsets of neighbours in a larger set, which may be in the order of a walk
_LARGEST = 200  # features of a picture, by which pictures are compared
_MIN_LARGEST = 2  # matches of these, of a pair that may overlap
# Ranks of the pairs to match of each picture: all would be of one place where many pictures show it.
_RANKS = (*range(20), *np.geomspace(20, _MAX_COMPARED, 12).astype(int).tolist())


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
    """Sorted pairs of unordered pictures to match: all of up to 50; of more, each picture's 20 best and some others.

    Pairs are ranked by the matches of their 200 largest features, two or more (Wu, *Towards linear-time incremental
    structure from motion*, 3DV 2013): all pairs of up to 300 pictures; of more, neighbours by number and each one's 60
    most similar by VLAD.
    """
    count = len(features)
    pairs = list(itertools.combinations(range(count), 2))
    if count <= _MAX_EXHAUSTIVE:
        return pairs
    if count > _MAX_COMPARED:
        pairs = sorted({*sequential_pairs(count, _BESIDE), *most_alike(features, _ALIKE_EACH)})
    first, second = np.array(pairs).T
    matches = np.zeros((count, count), np.int64)
    matches[first, second] = matches[second, first] = _matches_of_largest(features, pairs)
    return _best_pairs(matches)


def _best_pairs(matches: IntArray) -> list[Pair]:
    """Sorted pairs of each picture with those at ``_RANKS`` by ``matches`` (N, N), at least ``_MIN_LARGEST`` each."""
    ranked = np.argsort(-matches, axis=1, kind="stable")[:, [rank for rank in _RANKS if rank < len(matches)]]
    is_chosen = np.zeros(matches.shape, np.bool_)
    np.put_along_axis(is_chosen, ranked, True, axis=1)
    return [(i, j) for i, j in np.argwhere(np.triu((is_chosen | is_chosen.T) & (matches >= _MIN_LARGEST))).tolist()]


def _matches_of_largest(features: Sequence[FeatureSet], pairs: Sequence[Pair]) -> list[int]:
    """Number of matches of each pair among the ``_LARGEST`` largest features of either picture."""
    descriptors = [unit_descriptors(found)[np.argsort(-found.sizes, kind="stable")[:_LARGEST]] for found in features]
    with ThreadPoolExecutor(_THREADS) as pool:
        return list(pool.map(lambda pair: len(ratio_matches(*(descriptors[k] for k in pair))), pairs))


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
