"""Vanished landmarks: many cameras should have seen them and did not."""

from __future__ import annotations

import numpy as np

from rholoc.geometry import BoolArray
from rholoc.mapping.learn.expected_sightings import GONE_NATS, Sights

_MIN_MISSES = 6
_MIN_OCCASIONS = 2


def vanished(sights: Sights) -> BoolArray:
    """Mask (F,) of landmarks that are gone.

    Their absence explains the sightings better by ``GONE_NATS``, with at least six misses on at least two occasions.
    """
    everyone = np.ones(sights.camera_count, dtype=bool)
    nats = sights.sums(sights.evidence(everyone), everyone)
    pairs = np.column_stack([sights.landmarks, sights.occasions[sights.cameras]])[~sights.seen]
    misses = np.bincount(pairs[:, 0], minlength=sights.landmark_count)
    occasions = np.bincount(np.unique(pairs, axis=0)[:, 0], minlength=sights.landmark_count)
    return (nats <= -GONE_NATS) & (misses >= _MIN_MISSES) & (occasions >= _MIN_OCCASIONS)
