"""Parallax: image shifts between two pictures that no rotation explains."""

from collections.abc import Sequence

import numpy as np

from rholoc.geometry import FloatArray, aligning_rotation
from rholoc.trajectory.visual.matching import VerifiedPair

_MIN_SHIFT_RAD = 0.0025  # of a walk; twice the detector's noise
_MIN_SHARE = 0.95  # of the pairs
_FITS = 3  # of the rotation, each to the best half of the matches


def only_turned(pairs: Sequence[VerifiedPair], rays: Sequence[FloatArray]) -> bool:
    """Whether the camera only rotated (95 % of the pairs shift by less than 2.5 mrad), so that depths are unobservable.

    Args:
        pairs: of keyframes close in time; without any the answer is False.
        rays: for each keyframe the unit rays (N, 3) of its features.
    """
    return bool(pairs) and float(np.quantile(shifts(pairs, rays), _MIN_SHARE)) < _MIN_SHIFT_RAD


def shifts(pairs: Sequence[VerifiedPair], rays: Sequence[FloatArray]) -> FloatArray:
    """For each pair of keyframes (P,), the median residual of its matches under their best rotation [rad].

    Detector noise if the camera only turns, parallax if it moves.
    """
    return np.array([_shift(pair, rays) for pair in pairs])


def _shift(pair: VerifiedPair, rays: Sequence[FloatArray]) -> float:
    """Median residual [rad] of a pair's matches under their best rotation, fitted to the better half."""
    first, second = (rays[keyframe][pair.matches[:, side]] for side, keyframe in enumerate((pair.first, pair.second)))
    fitted = np.ones(len(first), dtype=np.bool_)
    for _ in range(_FITS):
        R_second_first = aligning_rotation(first[fitted], second[fitted])
        off = np.linalg.norm(second - first @ R_second_first.T, axis=1)
        fitted = off <= np.median(off)
    return float(np.median(off))
