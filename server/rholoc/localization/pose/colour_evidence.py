"""Whether what a pose matches is as light as the map saw it: evidence that no descriptor of a grey picture has.

Chance puts any brightness on any landmark; so does a room with the same furniture in other covers. But light changes
colours, lamps are red, and many cameras are grey. So it is not asked whether colours are the same: only whether the
lightness that a picture shows follows, by some linear rule that is its own, from the colours that the map knows.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import rankdata

from rholoc.geometry import ByteArray, FloatArray
from rholoc.maps.map_tables import UNKNOWN_GREY

_FEWEST = 4
_MOST = 300  # matches that are compared with each other
_RIDGE = 1 / 3  # on the slopes, of ranks from -1/2 to 1/2
_SHRINK = 6.0  # matches: of so few that agree, half is taken for chance


def colour_agreement(shown: ByteArray | None, known: ByteArray | None) -> float:
    """How well the lightness of features can be told from the colours of their landmarks.

    The coefficient of determination of a ridge regression of ranks, each match left out in turn (PRESS): 0 by chance, 1
    at best; less where matches are few. It is the same by a light of another colour and by a grey camera.

    Args:
        shown: (M, 3) uint8, red, green and blue of the features of M matches; None where they are not known.
        known: (M, 3) uint8, the same of their landmarks.

    Returns:
        NaN where too few colours are known, or the picture is equally light all over.
    """
    if shown is None or known is None:
        return np.nan
    rows = np.flatnonzero((known != UNKNOWN_GREY).any(axis=1))
    if len(rows) < _FEWEST:
        return np.nan
    rows = rows[np.linspace(0, len(rows) - 1, min(len(rows), _MOST)).astype(np.int64)]
    return _foretold(_ranks(_opponent(known[rows])), _ranks(_opponent(shown[rows])[:, 0])) * float(
        np.sqrt(len(rows) / (len(rows) + _SHRINK))
    )


def _foretold(inputs: FloatArray, output: FloatArray) -> float:
    """The share 0..1 of the variance of ``output`` (M,) that ``inputs`` (M, D) foretell, both centred; or NaN."""
    count = len(output)
    total = float(output @ output) * (count / (count - 1)) ** 2  # each from the mean of the others
    if total == 0.0:
        return np.nan
    slopes = np.linalg.solve(inputs.T @ inputs + _RIDGE * np.eye(inputs.shape[1]), inputs.T)  # (D, M)
    leverage = 1 / count + (inputs * slopes.T).sum(axis=1)
    missed = (output - inputs @ (slopes @ output)) / (1 - leverage)
    return max(1 - float(missed @ missed) / total, 0.0)


def _opponent(colours: ByteArray) -> FloatArray:
    """Colours (M, 3): lightness, red or green, yellow or blue."""
    red, green, blue = colours.T.astype(np.float64)
    return np.stack([red + green + blue, red - green, (red + green) / 2 - blue], axis=1)


def _ranks(values: FloatArray) -> FloatArray:
    """The ranks of values (M, ...) among each other, centred, as a share."""
    ranks = rankdata(values, axis=0)
    return np.asarray((ranks - ranks.mean(axis=0)) / len(ranks))
