"""Which cameras contradict each other? Trust those that see the same landmarks, and drop the others.

Furniture that was moved is as rigid as the room: a picture that shows little else is localized by it, confidently and
wrongly. Cameras that are localized by other landmarks and look at its old place miss it. The majority agrees on what
stayed, so cameras that rely on landmarks missed by the others are dropped, the most contradicted first.
"""

from __future__ import annotations

import numpy as np

from rholoc.geometry import BoolArray, FloatArray
from rholoc.mapping.learn.expected_sightings import Sights

_TELLING_NATS = 1.0  # by which a landmark is likelier there than gone, or gone than there
_MAX_CONTRADICTED = 0.2  # of the landmarks that a camera rests on; what noise brings about is less than that
_MISPLACED = 0.3  # of the cameras that look at a place, so many may be misled by what moved
_MIN_TELLING = 10  # landmarks that others know of: among fewer, each counts as one of so many


def agreeing(sights: Sights, speaking: BoolArray) -> BoolArray:
    """Mask (C,) of cameras that are not contradicted by the ``speaking`` (C,) cameras that agree with each other.

    A camera is contradicted if others miss more than a fifth of the landmarks that it sees.
    """
    believed = speaking.copy()
    while True:
        contradicted = _contradicted(sights, believed)
        doubtful = believed & (contradicted > _MAX_CONTRADICTED)
        if not doubtful.any():
            return contradicted <= _MAX_CONTRADICTED
        believed[np.argmax(np.where(doubtful, contradicted, 0.0))] = False


def _contradicted(sights: Sights, believed: BoolArray) -> FloatArray:
    """Share (C,) of the landmarks seen by each camera that the ``believed`` (C,) other cameras miss by over 1 nat."""
    nats = sights.evidence(believed, _MISPLACED)
    of_others = sights.sums(nats, believed)[sights.landmarks] - nats * believed[sights.cameras]
    missed = np.bincount(sights.cameras, sights.seen & (of_others < -_TELLING_NATS), sights.camera_count)
    known = np.bincount(sights.cameras, sights.seen & (np.abs(of_others) > _TELLING_NATS), sights.camera_count)
    return np.asarray(missed / np.maximum(known, _MIN_TELLING))
