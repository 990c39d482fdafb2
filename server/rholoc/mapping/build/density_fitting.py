"""Fit a map's densities in a given form."""

from dataclasses import replace

import numpy as np

from rholoc.density import FORMS, DensityKind, RayDensities, Sightings
from rholoc.mapping.build.stored_observations import observed_rays
from rholoc.maps import Map
from rholoc.progress import ProgressListener, Stage, silent

DEFAULT_DEGREE = 2


def fit_densities(
    map_: Map, kind: DensityKind, degree: int = DEFAULT_DEGREE, progress: ProgressListener = silent
) -> Map:
    """The map with densities of form ``kind``, and of degree P = ``degree`` if that form has one, fitted to its
    observations.

    Raises:
        InvalidInput: ``observed`` densities are requested, but the map does not remember its observations.
    """
    sightings = sightings_of(map_) if kind is DensityKind.OBSERVED else _without_bearings(map_)
    densities = FORMS[kind].fit(sightings, degree, lambda done, text: progress(Stage.DENSITIES, done, text))
    return replace(map_, info=replace(map_.info, density=kind), densities=densities)


def sightings_of(map_: Map) -> Sightings:
    """All observations of a map as bearings and camera positions, in the map's order.

    Raises:
        InvalidInput: the map does not remember its observations.
    """
    return replace(_without_bearings(map_), bearings=observed_rays(map_).bearings)


def _without_bearings(map_: Map) -> Sightings:
    """All observations of a map as features and camera positions, in the map's order; bearings are None."""
    return Sightings(
        map_.landmarks.positions.astype(np.float64),
        map_.observations.features,
        map_.views.positions[map_.observations.views],
    )


def ray_form(map_: Map) -> Map:
    """The map with ``ray`` densities, on which learning operates; the other forms can be fitted again."""
    return replace(map_, info=replace(map_.info, density=DensityKind.RAY), densities=RayDensities())
