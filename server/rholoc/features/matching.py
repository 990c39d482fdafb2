"""Descriptor distances and mutual matches. Descriptors match only within their channel."""

import math
from dataclasses import dataclass

import cv2
import faiss
import numpy as np

from rholoc.features.feature_set import FeatureSet, Metric
from rholoc.geometry import ByteArray, FloatArray, IntArray

_NEVER = np.float32(np.inf)

# Of inverted files: descriptors in a list, at least and to learn it from; rounds of learning; lists searched.
_MIN_PER_LIST, _TRAINING_PER_LIST = 4, 20
_ITERATIONS, _SEED = 6, 1
_LISTS_SEARCHED = 8
_ADDED_AT_A_TIME = 2**16  # which are in memory as floats

# Searches here take milliseconds: threads that wait for each other cost more than they gain, and a busy service has
# a request for every core anyway.
faiss.omp_set_num_threads(1)


@dataclass(frozen=True)
class MatchLimits:
    """Maximum distances between two descriptors of the same point.

    Attributes:
        strict: limit for matching among all features, which chance rarely meets.
        loose: limit for matching among features that geometry has selected.
        spread: the scale at which a difference of distances matters (bits, or the Euclidean unit).
    """

    strict: float
    loose: float
    spread: float


LIMITS = {
    Metric.HAMMING: MatchLimits(strict=64, loose=80, spread=12),
    Metric.EUCLIDEAN: MatchLimits(strict=260, loose=340, spread=40),
}


class DescriptorIndex:
    """Nearest neighbours among descriptors (D, B) of one metric, by channel.

    Rows in the results are rows of the given descriptors.

    Args:
        descriptors: (D, B).
        channels: (D,) channel of each.
        metric: metric of the descriptors.
        inverted: whether to sort them into lists by similarity and search only the most likely lists (an inverted file;
            Sivic and Zisserman, ICCV 2003). Among a million descriptors, a query then takes as long as an exact one
            among some thousands, but misses the nearest descriptor of about one in ten features.
    """

    def __init__(self, descriptors: ByteArray, channels: ByteArray, metric: Metric, inverted: bool = False) -> None:
        self.metric = metric
        self._rows: dict[int, IntArray] = {}
        self._indices = {}
        for channel in np.unique(channels):
            rows = np.flatnonzero(channels == channel)
            self._rows[int(channel)] = rows
            make = _inverted_index if inverted else _flat_index
            self._indices[int(channel)] = make(descriptors[rows], metric)

    def nearest(self, features: FeatureSet, k: int) -> tuple[FloatArray, IntArray]:
        """The ``k`` nearest descriptors in the same channel for each of N features.

        Returns distances (N, k), ascending, and rows (N, k); inf and -1 where fewer than ``k`` are found.
        """
        distances = np.full((len(features), k), _NEVER, dtype=np.float32)
        rows = np.full((len(features), k), -1, dtype=np.int64)
        for channel, index in self._indices.items():
            mine = np.flatnonzero(features.channels == channel)
            if len(mine) == 0:
                continue
            count = min(k, index.ntotal)
            found, where = index.search(_for_faiss(features.descriptors[mine], self.metric), count)
            missing = where < 0  # the lists that were searched hold fewer
            distances[mine, :count] = np.where(missing, _NEVER, _as_distance(found, self.metric))
            rows[mine, :count] = np.where(missing, -1, self._rows[channel][where])
        return distances, rows


def descriptor_distances(a: ByteArray, b: ByteArray, metric: Metric) -> FloatArray:
    """The distances between descriptors of the same row: a (N, B), b (N, B) → (N,) float32."""
    if metric is Metric.HAMMING:
        differing = a ^ b
        words = differing.view(np.uint64) if a.shape[1] % 8 == 0 else differing  # eight bytes at a time are faster
        return np.asarray(np.bitwise_count(words).sum(axis=1, dtype=np.int32).astype(np.float32))
    if len(a) == 0:  # OpenCV fails on empty arrays
        return np.zeros(0, dtype=np.float32)
    difference = cv2.absdiff(a, b).astype(np.float32)  # of bytes: eight times as fast as of floats
    return np.asarray(np.sqrt(np.einsum("nd,nd->n", difference, difference)))


def mutual_matches(a: FeatureSet, b: FeatureSet, metric: Metric, limit: float) -> IntArray:
    """Rows (M, 2) in ``a`` and ``b`` of descriptors that are each other's nearest in one channel, within ``limit``."""
    if len(a) == 0 or len(b) == 0:
        return np.zeros((0, 2), dtype=np.int64)
    distances, to_b = DescriptorIndex(b.descriptors, b.channels, metric).nearest(a, 1)
    _, to_a = DescriptorIndex(a.descriptors, a.channels, metric).nearest(b, 1)
    rows = np.arange(len(a))
    near = distances[:, 0] <= limit
    mutual = near.copy()
    mutual[near] = to_a[to_b[near, 0], 0] == rows[near]
    return np.column_stack([rows[mutual], to_b[mutual, 0]])


def _flat_index(descriptors: ByteArray, metric: Metric) -> faiss.Index | faiss.IndexBinary:
    """Exact index of descriptors (D, B), which compares with all of them."""
    if metric is Metric.HAMMING:
        binary = faiss.IndexBinaryFlat(descriptors.shape[1] * 8)
        binary.add(np.ascontiguousarray(descriptors))
        return binary
    index = faiss.IndexFlatL2(descriptors.shape[1])
    index.add(descriptors.astype(np.float32))
    return index


def _inverted_index(descriptors: ByteArray, metric: Metric) -> faiss.Index | faiss.IndexBinary:
    """Inverted file of descriptors (D, B), stored as bytes in about 2 √D lists; a flat index below 4 per list."""
    count, size = descriptors.shape
    lists = 2 ** max(0, round(math.log2(2 * math.sqrt(count))))
    if count < _MIN_PER_LIST * lists:
        return _flat_index(descriptors, metric)
    index = _empty_lists(size, lists, metric)
    index.cp.niter, index.cp.seed = _ITERATIONS, _SEED
    index.cp.max_points_per_centroid, index.cp.min_points_per_centroid = _TRAINING_PER_LIST, 1
    chosen = np.random.default_rng(_SEED).permutation(count)[: _TRAINING_PER_LIST * lists]
    index.train(_for_faiss(descriptors[chosen], metric))
    for start in range(0, count, _ADDED_AT_A_TIME):
        index.add(_for_faiss(descriptors[start : start + _ADDED_AT_A_TIME], metric))
    index.nprobe = _LISTS_SEARCHED
    return index


def _empty_lists(size: int, lists: int, metric: Metric) -> faiss.IndexIVF | faiss.IndexBinaryIVF:
    """An inverted file with ``lists`` untrained lists for descriptors of ``size`` bytes."""
    if metric is Metric.HAMMING:
        return faiss.IndexBinaryIVF(faiss.IndexBinaryFlat(8 * size), 8 * size, lists)
    byte = faiss.ScalarQuantizer.QT_8bit_direct
    index = faiss.IndexIVFScalarQuantizer(faiss.IndexFlatL2(size), size, lists, byte)
    index.by_residual = False  # bytes are kept as they are
    return index


def _for_faiss(descriptors: ByteArray, metric: Metric) -> ByteArray | FloatArray:
    """Descriptors (N, B) as faiss takes them: contiguous bytes for the Hamming distance, else float32."""
    return np.ascontiguousarray(descriptors) if metric is Metric.HAMMING else descriptors.astype(np.float32)


def _as_distance(found: FloatArray, metric: Metric) -> FloatArray:
    """Distances float32 from what faiss found: Hamming distances, or squared Euclidean ones."""
    return found.astype(np.float32) if metric is Metric.HAMMING else np.sqrt(np.maximum(found, 0))
