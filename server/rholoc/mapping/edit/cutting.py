"""Remove parts of a map: the landmarks of a region, or the views of a piece of a walk."""

from dataclasses import replace

import numpy as np

from rholoc.errors import Conflict, InvalidInput
from rholoc.geometry import BoolArray, FloatArray, IntArray
from rholoc.mapping.build.density_fitting import ray_form
from rholoc.mapping.build.stored_observations import keep_features, keep_view_rows, with_landmarks
from rholoc.maps import Map, MapInfo, Source, check_outline, memory_of, within_outline

_MIN_LEFT = 12  # landmarks; with fewer no camera can be localized


def in_region(
    positions: FloatArray, outline: FloatArray, bottom_m: float | None = None, top_m: float | None = None
) -> BoolArray:
    """Mask (N,) of positions (N, 3) inside an outline (M, 2), seen from above (even–odd rule), and between two heights
    (None: no bound).

    Raises:
        InvalidInput: the outline is not a valid polygon.
    """
    check_outline(outline, "The region")
    inside, z = within_outline(positions[:, :2].astype(np.float64), outline), positions[:, 2]
    inside &= z >= (-np.inf if bottom_m is None else bottom_m)
    return np.asarray(inside & (z <= (np.inf if top_m is None else top_m)))


def without_landmarks(map_: Map, removed: BoolArray, points_removed: BoolArray, vertices_removed: BoolArray) -> Map:
    """The map in ``ray`` form without the landmarks ``removed`` (F,), the cloud points ``points_removed`` (P,) and the
    vertices ``vertices_removed`` (V,) of its room.

    Raises:
        Conflict: ``removed`` has none, or fewer than 12 landmarks would be left.
    """
    if not removed.any():
        raise Conflict("There is no landmark to remove.", "Choose another region.")
    _check_left(int((~removed).sum()))
    shown = replace(ray_form(map_), cloud=map_.cloud.keep(~points_removed), room=map_.room.keep(~vertices_removed))
    return keep_features(shown, ~removed)


def without_views(map_: Map, first: int, last: int) -> Map:
    """The map in ``ray`` form without the views ``first`` to ``last`` (inclusive) and the landmarks that only they saw.

    If the map remembers its observations, the other landmarks are those of a map that never had these views.

    Raises:
        InvalidInput: there are no such views.
        Conflict: no view, or fewer than 12 landmarks, would be left.
    """
    count = len(map_.views)
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
    """The map in ``ray`` form with only the views where ``stays`` (K,) is true, without landmarks that only the others
    saw.

    If the map remembers its observations, the removed views' landmarks are triangulated again without them, and the
    sources' view counts are updated.
    """
    seen = stays[map_.observations.views]
    touched = np.zeros(len(map_), dtype=bool)
    touched[map_.observations.features[~seen]] = True
    memory = memory_of(map_)
    left = keep_view_rows(ray_form(map_), stays)
    if memory is not None:
        left = replace(left, info=replace(left.info, sources=_recounted(map_.info, memory.view_sources[stays])))
    if memory is None:
        still_seen = np.bincount(left.observations.features, minlength=len(left)) > 0
        left = keep_features(left, still_seen | ~touched)
    else:
        left = with_landmarks(left, touched)
    return left


def _recounted(info: MapInfo, view_sources: IntArray) -> tuple[Source, ...]:
    """The sources with their numbers of views, counted anew from the source (K,) of each view."""
    counts = np.bincount(view_sources, minlength=len(info.sources))
    return tuple(replace(source, views=int(views)) for source, views in zip(info.sources, counts, strict=True))


def _check_left(count: int) -> None:
    """Raise Conflict if fewer than 12 landmarks, ``count``, would be left."""
    if count < _MIN_LEFT:
        raise Conflict(f"Only {count} landmarks would be left.", "Remove less, or delete the map instead.")
