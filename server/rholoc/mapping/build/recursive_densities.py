"""Recursive learning of ``observed`` densities: a map's densities are updated one observation at a time, with
forgetting.
"""

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
    """Check a forgetting factor, and that the map's densities can learn recursively.

    Raises:
        InvalidInput: the factor is not in (0, 1], or the densities cannot learn recursively.
    """
    if not 0 < forgetting <= 1:
        raise InvalidInput(f"{forgetting:g} is not a valid forgetting factor.", "Give a number above 0, at most 1.")
    if map_.info.density is not DensityKind.OBSERVED:
        raise InvalidInput(
            f"The map's densities are '{map_.info.density}', which are not learned one observation at a time.",
            "Omit --forgetting, or build a map with 'observed' densities.",
        )


def with_learned_densities(before: Map, after: Map, forgetting: float) -> Map:
    """``after`` with the ``observed`` densities of ``before``, updated by the new observations in their order.

    Observations from elsewhere and new features get densities of their own.

    Args:
        before: a map with ``observed`` densities.
        after: the same map in ``ray`` form, with further observations and features appended.
        forgetting: factor in (0, 1] by which each observation reduces the weight of all earlier ones.

    Raises:
        InvalidInput: a map does not remember its observations, or :func:`check_forgetting` fails.
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
    """Mask (V,) of the sightings that were used, and the updated densities. Of the rows ``new``, a density learns those
    within its radius whose bearing is within 30° of its direction.
    """
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
    """The sightings in ``rows``, of the same landmarks."""
    assert sightings.bearings is not None
    return Sightings(sightings.landmarks, sightings.features[rows], sightings.positions[rows], sightings.bearings[rows])


def _sorted(a: ObservedDensities, b: ObservedDensities) -> ObservedDensities:
    """Densities of both sets, sorted by feature (stably, ``a`` first), of the degree of ``a``."""
    order = np.argsort(np.concatenate([a.features, b.features]), kind="stable")

    def joined(name: str) -> np.ndarray:
        return np.asarray(np.concatenate([getattr(a, name), getattr(b, name)])[order])

    names = ("coefficients", "features", "landmarks", "places", "radii", "middles", "moments", "counts")
    return ObservedDensities(a.degree, *(joined(name) for name in names))
