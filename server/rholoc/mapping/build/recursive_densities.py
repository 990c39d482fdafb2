"""``observed`` densities that learn as observations come: a map's go on from where they stand, with forgetting."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rholoc.density import DensityKind, ObservedDensities, Sightings
from rholoc.density.observed import fit_observed
from rholoc.errors import InvalidInput
from rholoc.geometry import BoolArray, IntArray
from rholoc.mapping.build.density_fitting import sightings_of
from rholoc.maps import Map

_SAME_SIDE = np.cos(np.deg2rad(30.0))  # between a density's direction and a bearing that it learns from


def check_forgetting(map_: Map, forgetting: float) -> None:
    """Refuse a forgetting that is none, or densities that do not learn one observation at a time.

    Raises:
        InvalidInput: they do not, or it is not above 0 and at most 1.
    """
    if not 0 < forgetting <= 1:
        raise InvalidInput(f"{forgetting:g} is not a valid forgetting factor.", "Give a number above 0, at most 1.")
    if map_.info.density is not DensityKind.OBSERVED:
        raise InvalidInput(
            f"The map's densities are '{map_.info.density}', which are not learned one observation at a time.",
            "Omit --forgetting, or build a map with 'observed' densities.",
        )


def with_learned_densities(before: Map, after: Map, forgetting: float) -> Map:
    """``after``, of ``ray`` form, with the ``observed`` densities of ``before`` gone on with.

    Each takes the observations that are new, in their order, as far as they are of its place; what is seen from
    elsewhere, and features that are new, get densities of their own.

    Args:
        before: a map.
        after: the same with further observations and features behind its own.
        forgetting: what the weight of all before is multiplied by at each observation, 0 < forgetting ≤ 1.

    Raises:
        InvalidInput: a map does not remember its observations, or :func:`check_forgetting` refuses.
    """
    check_forgetting(before, forgetting)
    known = before.densities
    assert isinstance(known, ObservedDensities)
    sightings = sightings_of(after)
    is_new = np.arange(len(sightings.features)) >= len(before.observations)
    taken, learned = _learned(known, sightings, np.flatnonzero(is_new), forgetting)
    left = is_new & ~taken
    left |= ~np.isin(sightings.features, known.features)  # features without a density so far
    fresh = fit_observed(_some(sightings, np.flatnonzero(left)), known.degree)
    densities = _sorted(replace(learned, landmarks=sightings.landmarks[known.features]), fresh)
    return replace(after, info=replace(after.info, density=DensityKind.OBSERVED), densities=densities)


def _learned(
    known: ObservedDensities, sightings: Sightings, new: IntArray, forgetting: float
) -> tuple[BoolArray, ObservedDensities]:
    """Which of all sightings were taken in, and the densities after it."""
    assert sightings.bearings is not None
    taken = np.zeros(len(sightings.features), dtype=bool)
    coefficients, moments, counts = known.coefficients.copy(), known.moments.copy(), known.counts.copy()
    new = new[np.argsort(sightings.features[new], kind="stable")]
    starts = np.searchsorted(sightings.features[new], known.features)
    ends = np.searchsorted(sightings.features[new], known.features, side="right")
    for t in np.flatnonzero(ends > starts).tolist():
        rows = new[starts[t] : ends[t]]
        near = np.linalg.norm(sightings.positions[rows] - known.places[t], axis=1) <= known.radii[t]
        rows = rows[near & (sightings.bearings[rows] @ known.middles[t] >= _SAME_SIDE)]
        if len(rows):
            fit = known.learned(t, sightings.bearings[rows], sightings.positions[rows], forgetting)
            coefficients[t], moments[t], counts[t] = known.with_fit(t, fit, len(rows))
            taken[rows] = True
    return taken, replace(known, coefficients=coefficients, moments=moments, counts=counts)


def _some(sightings: Sightings, rows: IntArray) -> Sightings:
    assert sightings.bearings is not None
    return Sightings(sightings.landmarks, sightings.features[rows], sightings.positions[rows], sightings.bearings[rows])


def _sorted(a: ObservedDensities, b: ObservedDensities) -> ObservedDensities:
    """The densities of both, by feature."""
    order = np.argsort(np.concatenate([a.features, b.features]), kind="stable")

    def joined(name: str) -> np.ndarray:
        return np.asarray(np.concatenate([getattr(a, name), getattr(b, name)])[order])

    names = ("coefficients", "features", "landmarks", "places", "radii", "middles", "moments", "counts")
    return ObservedDensities(a.degree, *(joined(name) for name in names))
