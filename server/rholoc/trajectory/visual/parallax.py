"""Whether the camera went anywhere: what shifts between two pictures beyond what turning explains."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rholoc.geometry import FloatArray, aligning_rotation
from rholoc.trajectory.visual.matching import VerifiedPair

_LEAST_SHIFT_RAD = 0.0025  # of a walk; the detector's noise is half of it
_MOST = 0.95  # of the pairs
_FITS = 3  # of the rotation, each to the half of the matches that the last one fits best


def only_turned(pairs: Sequence[VerifiedPair], rays: Sequence[FloatArray]) -> bool:
    """Whether the camera turned where it stood: then nothing shows how far away anything is.

    Args:
        pairs: of keyframes close in time.
        rays: of each keyframe, its features' unit rays (N, 3).
    """
    return bool(pairs) and float(np.quantile(shifts(pairs, rays), _MOST)) < _LEAST_SHIFT_RAD


def shifts(pairs: Sequence[VerifiedPair], rays: Sequence[FloatArray]) -> FloatArray:
    """(P,) of each pair of keyframes, the median over its matches of what the best rotation leaves, radians.

    A camera that turns where it stands leaves the detector's noise; one that walks leaves the parallax of what it sees.
    """
    return np.array([_shift(pair, rays) for pair in pairs])


def _shift(pair: VerifiedPair, rays: Sequence[FloatArray]) -> float:
    first, second = (rays[keyframe][pair.matches[:, side]] for side, keyframe in enumerate((pair.first, pair.second)))
    fitted = np.ones(len(first), dtype=np.bool_)
    for _ in range(_FITS):
        R_second_first = aligning_rotation(first[fitted], second[fitted])
        off = np.linalg.norm(second - first @ R_second_first.T, axis=1)
        fitted = off <= np.median(off)
    return float(np.median(off))
