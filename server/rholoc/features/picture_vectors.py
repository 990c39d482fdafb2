"""Pictures as short vectors, by which one place is found among tens of thousands.

VLAD (:mod:`rholoc.features.vlad`) cut to its principal components, those that all pictures share weighed down: Jégou
and Chum, *Negative evidences and co-occurrences in image retrieval*, ECCV 2012.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from rholoc.features.feature_set import Metric
from rholoc.features.vlad import Vlad, normalised
from rholoc.geometry import ByteArray, FloatArray

DIMENSIONS = 256
"""Of a vector."""

_PICTURES_AT_A_TIME = 100  # whose whole VLAD vectors are in memory
_WHITENING = 0.5  # the power of a component's spread that is divided out: 0 leaves it, 1 makes all alike
_SEED = 1
_MIN_SPREAD = 1e-3  # of the greatest: components below are noise


class PictureVectors:
    """Encoder of pictures as unit vectors, whose scalar product is their similarity.

    Args:
        vlad: the vocabulary.
        mean: (W · D,) of the VLAD vectors that were learned from.
        components: (W · D, ``DIMENSIONS``) what takes what differs from it to a vector.
        metric: how the descriptors are compared.
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
            KeyError, ValueError: it is something else.
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
    """Descriptors as numbers whose differences mean something: the bits (N, 8 B) of binary ones, others unchanged."""
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
