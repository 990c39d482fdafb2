"""Evidence from colours: whether the lightness of matched features follows from the landmarks' colours in the map.

Grey descriptors do not contain it: false matches have random brightness, and so has a room with the same furniture in
other covers. But illumination changes colours, lamps are red, and many cameras are grey. Colours are therefore not
compared directly. The test is whether some linear function, fitted to this picture alone, predicts the picture's
lightness from the map's colours.
"""

import numpy as np

from rholoc.geometry import ByteArray, FloatArray
from rholoc.maps.map_tables import UNKNOWN_GREY

_FEWEST = 4
_MOST = 300  # matches that are compared with each other
_RIDGE = 1 / 3  # on the slopes, of ranks from -1/2 to 1/2
_SHRINK = 6.0  # matches: of so few that agree, half is taken for chance


def colour_agreement(shown: ByteArray | None, known: ByteArray | None) -> float:
    """Share of the variance of the features' lightness that the colours of their landmarks predict.

    Coefficient of determination of a ridge regression between ranks, with each match left out in turn (PRESS). It does
    not depend on the colour of the light, nor on whether the camera is grey.

    Args:
        shown: (M, 3) uint8, red, green and blue at the M matched features; None if unknown.
        known: (M, 3) uint8, red, green and blue of their landmarks; ``UNKNOWN_GREY`` in all three counts as unknown.

    Returns:
        0 by chance or worse, 1 at best, times √(k / (k + 6)) for k ≤ 300 of the known colours. NaN if
            either is None, k < 4, or the picture has no contrast.
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
    """Share 0 to 1 of the variance of ``output`` (M,) predicted by ``inputs`` (M, D), both centred; NaN if it is 0."""
    count = len(output)
    total = float(output @ output) * (count / (count - 1)) ** 2  # each from the mean of the others
    if total == 0.0:
        return np.nan
    slopes = np.linalg.solve(inputs.T @ inputs + _RIDGE * np.eye(inputs.shape[1]), inputs.T)  # (D, M)
    leverage = 1 / count + (inputs * slopes.T).sum(axis=1)
    missed = (output - inputs @ (slopes @ output)) / (1 - leverage)
    return max(1 - float(missed @ missed) / total, 0.0)


def _opponent(colours: ByteArray) -> FloatArray:
    """Opponent colours (M, 3) of red, green and blue (M, 3): R + G + B, R − G, (R + G) / 2 − B."""
    red, green, blue = colours.T.astype(np.float64)
    return np.stack([red + green + blue, red - green, (red + green) / 2 - blue], axis=1)


def _ranks(values: FloatArray) -> FloatArray:
    """Ranks of values (M, ...) along the first axis, equal values having their mean rank, centred, divided by M.
    ``scipy.stats`` has them, but importing it takes a tenth of every process's start-up time.
    """
    columns = values.reshape(len(values), -1).T
    ranks = np.reshape(np.transpose([_mean_ranks(column) for column in columns]), values.shape)
    return np.asarray((ranks - ranks.mean(axis=0)) / len(ranks))


def _mean_ranks(values: FloatArray) -> FloatArray:
    """Ranks (N,) of values, the lowest 0.5; equal values share their mean rank."""
    ordered = np.sort(values)
    return (np.searchsorted(ordered, values, "left") + np.searchsorted(ordered, values, "right")) / 2
