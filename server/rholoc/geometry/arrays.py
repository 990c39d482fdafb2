"""Names for the array types that signatures use, and helpers for index arrays."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.floating[Any]]
IntArray = NDArray[np.integer[Any]]
ByteArray = NDArray[np.uint8]
BoolArray = NDArray[np.bool_]


def ranges(first: IntArray, last: IntArray) -> IntArray:
    """All numbers of the ranges ``first`` (N,) to ``last`` (N,), each without its end, one range after the other."""
    counts = np.subtract(last, first, dtype=np.int64)
    return np.repeat(first - np.cumsum(counts) + counts, counts) + np.arange(counts.sum())


def evenly(count: int, most: int) -> IntArray:
    """At most ``most`` evenly spaced numbers of 0..count-1, ascending, first and last included; 0 if ``most`` is 1."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.int64))
