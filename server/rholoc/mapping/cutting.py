"""Parts of a map removed: the landmarks of a region, the views of a piece of a walk."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rholoc.errors import Conflict, InvalidInput
from rholoc.geometry import BoolArray, FloatArray
from rholoc.mapping.fitting import ray_form
from rholoc.mapping.memory import keep_features, with_landmarks
from rholoc.maps import Map, Observations, Source, check_outline, within_outline

_LEAST_LEFT = 12  # landmarks; fewer than that no camera is localized by


def in_region(
    positions: FloatArray, outline: FloatArray, bottom_m: float | None = None, top_m: float | None = None
) -> BoolArray:
    """Which positions (N, 3) are within an outline (M, 2), seen from above, and between two heights (even-odd rule).

    Raises:
        InvalidInput: the outline is not a valid polygon.
    """
    check_outline(outline, "The region")
    inside, z = within_outline(positions[:, :2].astype(np.float64), outline), positions[:, 2]
    inside &= z >= (-np.inf if bottom_m is None else bottom_m)
    return np.asarray(inside & (z <= (np.inf if top_m is None else top_m)))


def without_landmarks(map_: Map, removed: BoolArray, points_removed: BoolArray) -> Map:
    """The map, in ``ray`` form, without the landmarks where ``removed`` (F,) holds.

    The points of its cloud where ``points_removed`` (P,) holds go, too.

    Raises:
        Conflict: none is there, or too few would be left.
    """
    if not removed.any():
        raise Conflict("There is no landmark to remove.", "Choose another region.")
    _check_left(int((~removed).sum()))
    return keep_features(replace(ray_form(map_), cloud=map_.cloud.keep(~points_removed)), ~removed)


def without_views(map_: Map, first: int, last: int) -> Map:
    """The map, in ``ray`` form, without the views ``first`` to ``last``, both included, and what only they saw.

    Where the map remembers its observations, landmarks that they saw too are those of a map that never had them.

    Raises:
        InvalidInput: there are no such views.
        Conflict: too little would be left.
    """
    count = len(map_.view_times)
    if not 0 <= first <= last < count:
        raise InvalidInput(f"The map has the views 0 to {count - 1}.", "Give the first and the last to remove.")
    stays = np.ones(count, dtype=bool)
    stays[first : last + 1] = False
    if not stays.any():
        raise Conflict("No view would be left.", "Delete the map instead.")
    left = keep_views(map_, stays)
    _check_left(len(left))
    return left


def keep_views(map_: Map, stays: BoolArray) -> Map:
    """The map, in ``ray`` form, with only the views where ``stays`` (K,) holds, and without what only the others saw.

    Where the map remembers its observations, landmarks that the others saw too are those of a map that never had them.
    """
    seen = stays[map_.observation_views]
    touched = np.zeros(len(map_), dtype=bool)
    touched[map_.observation_features[~seen]] = True
    kept = map_.observations
    left = replace(
        map_,
        info=map_.info if kept is None else replace(map_.info, sources=_recounted(map_, kept, stays)),
        view_times=map_.view_times[stays],
        T_map_camera=map_.T_map_camera[stays],
        view_covariances=None if map_.view_covariances is None else map_.view_covariances[stays],
        pictures=map_.pictures_of(stays),
        observation_views=(np.cumsum(stays) - 1)[map_.observation_views[seen]].astype(np.int32),
        observation_features=map_.observation_features[seen],
        observations=(
            None if kept is None else Observations(kept.pixels[seen], kept.view_sources[stays], kept.descriptor_sources)
        ),
    )
    left = ray_form(left)
    if kept is None:
        still_seen = np.bincount(left.observation_features, minlength=len(left)) > 0
        left = keep_features(left, still_seen | ~touched)
    else:
        left = with_landmarks(left, touched)
    return left


def _recounted(map_: Map, kept: Observations, stays: BoolArray) -> tuple[Source, ...]:
    counts = np.bincount(kept.view_sources[stays], minlength=len(map_.info.sources))
    return tuple(replace(source, views=int(views)) for source, views in zip(map_.info.sources, counts, strict=True))


def _check_left(count: int) -> None:
    if count < _LEAST_LEFT:
        raise Conflict(f"Only {count} landmarks would be left.", "Remove less, or delete the map instead.")
