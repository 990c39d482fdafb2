"""Pictures as short vectors, for retrieval of a place among tens of thousands.

VLAD, a picture's local descriptors as one vector: Jégou et al., *Aggregating local descriptors into a compact image
representation*, CVPR 2010; residuals of unit length: Delhumeau et al., 2013; normalised within each word: Arandjelović
and Zisserman, CVPR 2013. It is cut to its principal components, those that all pictures share weighed down: Jégou and
Chum, *Negative evidences and co-occurrences in image retrieval*, ECCV 2012.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import faiss
import numpy as np
from scipy.sparse import csr_array

from rholoc.features.feature_set import Metric
from rholoc.geometry import ByteArray, FloatArray

_MAX_WORDS = 64
_MIN_TRAINING_DESCRIPTORS = 40  # of a word
_TRAINING_DESCRIPTORS = 20_000
_ITERATIONS = 12
_TINY = 1e-9
DIMENSIONS = 256
_PICTURES_AT_A_TIME = 100  # whose whole VLAD vectors are in memory
_WHITENING = 0.5  # the power of a component's spread that is divided out: 0 leaves it, 1 makes all alike
_SEED = 1
_MIN_SPREAD = 1e-3  # of the greatest: components below are noise


class Vlad:
    """Vocabulary of W visual words, and the VLAD vectors of pictures.

    Args:
        descriptors: (N, D) descriptors of each training picture; at least one picture has some.
    """

    def __init__(self, descriptors: Sequence[ByteArray]) -> None:
        pooled = np.concatenate(descriptors)
        rng = np.random.default_rng(_SEED)
        training = pooled[rng.permutation(len(pooled))[:_TRAINING_DESCRIPTORS]].astype(np.float32)
        words = min(_MAX_WORDS, max(1, len(training) // _MIN_TRAINING_DESCRIPTORS))
        kmeans = faiss.Kmeans(training.shape[1], words, niter=_ITERATIONS, seed=_SEED)
        kmeans.train(training)
        self._set_words(np.asarray(kmeans.centroids))

    @classmethod
    def of_words(cls, words: FloatArray) -> Vlad:
        """The vocabulary of words (W, D) that were learned before."""
        vlad = cls.__new__(cls)
        vlad._set_words(np.ascontiguousarray(words, dtype=np.float32))
        return vlad

    def _set_words(self, words: FloatArray) -> None:
        """Set the words (W, D) float32, and index them."""
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
        """Normalized VLAD vectors (P, W · D) of P pictures' descriptors."""
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


class PictureVectors:
    """Encoder of pictures as unit vectors, whose scalar product is their similarity.

    Args:
        vlad: the vocabulary.
        mean: (W · D,) mean of the training pictures' VLAD vectors.
        components: (W · D, ``DIMENSIONS``) projection of a VLAD vector minus the mean.
        metric: metric of the descriptors.
    """

    def __init__(self, vlad: Vlad, mean: FloatArray, components: FloatArray, metric: Metric) -> None:
        self._vlad, self._mean, self._components, self._metric = vlad, mean, components, metric

    @classmethod
    def learned(cls, pictures: Sequence[ByteArray], metric: Metric) -> PictureVectors:
        """Learn an encoder from the descriptors (N, B) of each of a thousand pictures or so; one must have some."""
        training = [_numbers(picture, metric) for picture in pictures]
        vlad = Vlad(training)
        whole = vlad.vectors(training)
        mean = whole.mean(axis=0)
        return cls(vlad, mean, _components(whole - mean), metric)

    @classmethod
    def of_arrays(cls, arrays: Mapping[str, FloatArray], metric: Metric) -> PictureVectors:
        """Encoder from the result of :meth:`arrays`.

        Raises:
            KeyError, ValueError: an array is missing or broken.
        """
        words, mean, components = (
            np.ascontiguousarray(arrays[name], dtype=np.float32) for name in ("words", "mean", "components")
        )
        if words.ndim != 2 or mean.shape != (words.size,) or components.shape != (words.size, DIMENSIONS):
            raise ValueError("The arrays are not those of picture vectors.")
        return cls(Vlad.of_words(words), mean, components, metric)

    def arrays(self) -> dict[str, FloatArray]:
        """Arrays by name from which :meth:`of_arrays` makes the encoder again."""
        return {"words": self._vlad.words, "mean": self._mean, "components": self._components}

    def vectors(self, pictures: Sequence[ByteArray]) -> FloatArray:
        """Unit vectors (P, ``DIMENSIONS``) float32 of the descriptors (N, B) of P pictures; zeros if N is 0."""
        parts = [np.zeros((0, DIMENSIONS), np.float32)]
        for start in range(0, len(pictures), _PICTURES_AT_A_TIME):
            some = [_numbers(picture, self._metric) for picture in pictures[start : start + _PICTURES_AT_A_TIME]]
            short = normalised((self._vlad.vectors(some) - self._mean) @ self._components)
            short[[len(picture) == 0 for picture in some]] = 0
            parts.append(short)
        return np.concatenate(parts)


def _numbers(descriptors: ByteArray, metric: Metric) -> ByteArray:
    """Descriptors (N, B) in a Euclidean space: the bits (N, 8 B) of binary descriptors, others unchanged."""
    return np.unpackbits(descriptors, axis=1) if metric is Metric.HAMMING else descriptors


def _components(centred: FloatArray) -> FloatArray:
    """Principal components (D, ``DIMENSIONS``) float32 of centred rows (N, D), each divided by the root of its singular
    value. Components below 1/1000 of the largest are dropped; random directions across the others, weighted by the
    median, take the rest.
    """
    values, vectors = np.linalg.eigh(centred @ centred.T)  # N is far below D
    spread = np.sqrt(np.maximum(values, 0))
    first = np.argsort(-spread)[:DIMENSIONS]
    first = first[spread[first] > max(_MIN_SPREAD * float(spread.max(initial=0)), 1e-9)]
    learned = centred.T @ (vectors[:, first] / spread[first])
    weights = 1 / spread[first] ** _WHITENING
    others = np.random.default_rng(_SEED).normal(size=(centred.shape[1], DIMENSIONS - len(first)))
    others -= learned @ (learned.T @ others)
    weight = float(np.median(weights)) if len(first) else 1.0
    return np.concatenate([learned * weights, weight * normalised(others.T).T], axis=1).astype(np.float32)
