"""Walks: sequences of a map's views that follow one another."""

import numpy as np
from scipy.spatial.distance import pdist

from rholoc.geometry import FloatArray, IntArray

_SHORT_STEP = 0.7  # of the median distance between any two places: maximum median step of a walk
_COMPARED = 300  # places, about


def walk_numbers(positions: FloatArray, sources: IntArray) -> IntArray:
    """Number (K,) of the walk that each view belongs to: the row of the walk's first view.

    The views of a recording are one walk if consecutive ones are close: their median distance is at most 0.7 × the
    median distance of any two. Otherwise (a set of pictures in no order) each view is a walk of its own.

    Args:
        positions: (K, 3) of the views.
        sources: (K,) number of the recording that each comes from.
    """
    numbers = np.arange(len(positions))
    for source in np.unique(sources):
        own = np.flatnonzero(sources == source)
        if _in_order(positions[own]):
            numbers[own] = own[0]
    return numbers


def consecutive(walks: IntArray) -> IntArray:
    """Rows (E, 2) of each two consecutive views of one walk."""
    following = np.flatnonzero(walks[1:] == walks[:-1])
    return np.column_stack([following, following + 1])


def _in_order(places: FloatArray) -> bool:
    """Whether the median step is at most 0.7 of the median distance between any two places. True for fewer
    than three places (N, 3). Pictures in no order are as far from the next as from any other.
    """
    some = places[:: max(1, len(places) // _COMPARED)]
    if len(some) < 3:
        return True
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    return float(np.median(steps)) <= _SHORT_STEP * float(np.median(pdist(some)))
