"""Whether what a pose matches has the colours that the map saw: evidence that no descriptor of a grey picture has.

Chance puts any colour on any landmark; so does a room with the same furniture in other covers. Light changes colours,
but hardly their order: what is redder or darker than the rest stays so. So it is ranks that are compared.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.distance import cdist
from scipy.stats import rankdata

from rholoc.geometry import ByteArray, FloatArray

_FEWEST = 4
_MOST = 300  # matches that are compared with each other
_SHRINK = 6.0  # matches: of so few that agree, half is taken for chance
_UNKNOWN = 128  # of red, green and blue: what maps have for landmarks whose colour they do not know


def colour_agreement(shown: ByteArray | None, known: ByteArray | None) -> float:
    """How much more a feature's colour is like its own landmark's than like those of other matches.

    One less twice the mean rank of the own landmark among all, as a share: 0 by chance, 1 at best; less where matches
    are few.

    Args:
        shown: (M, 3) uint8, red, green and blue of the features of M matches; None where they are not known.
        known: (M, 3) uint8, the same of their landmarks.

    Returns:
        NaN where too few colours are known.
    """
    if shown is None or known is None:
        return np.nan
    rows = np.flatnonzero((known != _UNKNOWN).any(axis=1))
    if len(rows) < _FEWEST:
        return np.nan
    rows = rows[np.linspace(0, len(rows) - 1, min(len(rows), _MOST)).astype(np.int64)]
    apart = cdist(_ranks(shown[rows]), _ranks(known[rows]))
    count = len(rows)
    nearer = (apart <= np.diag(apart)[:, None]).sum(axis=1) - 0.5
    return float((1 - 2 * np.mean(nearer / count)) * np.sqrt(count / (count + _SHRINK)))


def _ranks(colours: ByteArray) -> FloatArray:
    """The ranks (M, 3) of colours (M, 3) among each other: lightness, red or green, yellow or blue."""
    red, green, blue = colours.T.astype(np.float64)
    opponent = np.stack([red + green + blue, red - green, (red + green) / 2 - blue], axis=1)
    return np.asarray(rankdata(opponent, axis=0))
