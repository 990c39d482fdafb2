"""VLAD: a picture's local descriptors as one vector, by which pictures of the same place are found.

Jégou et al., *Aggregating local descriptors into a compact image representation*, CVPR 2010; residuals of unit length:
Delhumeau et al., 2013; normalised within each word: Arandjelović and Zisserman, CVPR 2013.
"""

from __future__ import annotations

from collections.abc import Sequence

import faiss
import numpy as np
from scipy.sparse import csr_array

from rholoc.geometry import ByteArray, FloatArray

_MAX_WORDS = 64
_MIN_TRAINING_DESCRIPTORS = 40  # of a word
_TRAINING_DESCRIPTORS = 20_000
_ITERATIONS = 12
_PICTURES_AT_A_TIME = 100  # whose descriptors are in memory as floats
_SEED = 1
_TINY = 1e-9


class Vlad:
    """A vocabulary of words, and pictures as vectors on it.

    Args:
        descriptors: (N, D) of each of the pictures that the words are learned from; one of them has descriptors.
    """

    def __init__(self, descriptors: Sequence[ByteArray]) -> None:
        pooled = np.concatenate(descriptors)
        rng = np.random.default_rng(_SEED)
        training = pooled[rng.permutation(len(pooled))[:_TRAINING_DESCRIPTORS]].astype(np.float32)
        words = min(_MAX_WORDS, max(1, len(training) // _MIN_TRAINING_DESCRIPTORS))
        kmeans = faiss.Kmeans(training.shape[1], words, niter=_ITERATIONS, seed=_SEED)
        kmeans.train(training)
        self._take(np.asarray(kmeans.centroids))

    @classmethod
    def of_words(cls, words: FloatArray) -> Vlad:
        """The vocabulary of words (W, D) that were learned before."""
        vlad = cls.__new__(cls)
        vlad._take(np.ascontiguousarray(words, dtype=np.float32))
        return vlad

    def _take(self, words: FloatArray) -> None:
        self.words = words
        self._index = faiss.IndexFlatL2(words.shape[1])
        self._index.add(words)

    def vector(self, descriptors: ByteArray) -> FloatArray:
        """Vector (W · D,) of a picture's descriptors (N, D), of unit length; zeros if there are none.

        The scalar product of two pictures' vectors is their similarity.
        """
        return np.asarray(self.vectors([descriptors])[0])

    def vectors(self, descriptors: Sequence[ByteArray]) -> FloatArray:
        """Vectors (P, W · D) as of :meth:`vector` of each of P pictures."""
        starts = range(0, len(descriptors), _PICTURES_AT_A_TIME)
        parts = [self._vectors(descriptors[start : start + _PICTURES_AT_A_TIME]) for start in starts]
        return np.concatenate([np.zeros((0, self.words.size), np.float32), *parts])

    def _vectors(self, descriptors: Sequence[ByteArray]) -> FloatArray:
        total = np.zeros((len(descriptors), *self.words.shape), np.float32)
        pooled = np.concatenate(descriptors).astype(np.float32)
        if len(pooled):
            picture = np.repeat(np.arange(len(descriptors)), [len(some) for some in descriptors])
            _, found = self._index.search(pooled, 1)
            word = found[:, 0]
            cell = picture * len(self.words) + word
            entries = (np.ones(len(pooled), np.float32), (cell, np.arange(len(pooled))))
            sums = csr_array(entries, shape=(len(descriptors) * len(self.words), len(pooled)))
            total = (sums @ normalised(pooled - self.words[word])).reshape(total.shape)
        return normalised(normalised(total).reshape(len(descriptors), -1))


def normalised(rows: FloatArray) -> FloatArray:
    """Rows (…, D) at unit length; zeros stay."""
    return np.asarray(rows / np.maximum(np.linalg.norm(rows, axis=-1, keepdims=True), _TINY))
