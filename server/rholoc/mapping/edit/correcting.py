"""A map corrected by people who know the place: its frame, its scale, what is to go, what is called what.

Each function gives the map's next version, which keeps in ``info.corrections`` what was done.
"""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime

from rholoc.errors import Conflict, InvalidInput
from rholoc.geometry import FloatArray, Similarity
from rholoc.mapping.edit import frame_from_people as frames
from rholoc.mapping.edit.cutting import in_region, without_landmarks, without_views
from rholoc.mapping.edit.moving import move_map
from rholoc.mapping.edit.versions import as_corrected, noted
from rholoc.maps import (
    Correction,
    CorrectionKind,
    FloorPlan,
    Map,
    MapInfo,
    MapLabels,
    MapNames,
    check_labels,
    check_names,
    check_plan,
)

_Y_DEG = 90.0
_MIN_PLAN_POINTS, _MAX_PLAN_POINTS = 2, 100


def set_origin(map_: Map, point: FloatArray) -> Map:
    """The point (3,) of the present frame becomes the origin.

    Raises:
        InvalidInput: the map would lie too far from it.
    """
    return _moved(map_, frames.origin_at(point), CorrectionKind.ORIGIN)


def set_north(map_: Map, direction: FloatArray) -> Map:
    """The direction (3,), seen from above, becomes y; the map turns about the origin.

    Raises:
        InvalidInput: it is not level.
        Conflict: the map is not upright.
    """
    return _moved(_upright(map_), frames.level_direction(direction, _Y_DEG), CorrectionKind.NORTH)


def set_wall(map_: Map, direction: FloatArray) -> Map:
    """The direction (3,) along a wall, seen from above, becomes x; the map turns about the origin.

    Raises:
        InvalidInput: it is not level.
        Conflict: the map is not upright.
    """
    return _moved(_upright(map_), frames.level_direction(direction, 0.0), CorrectionKind.WALL)


def set_up(map_: Map, direction: FloatArray | None = None) -> Map:
    """The direction (3,) becomes z, and the map upright; where none is given, the one that its views hold upright.

    Raises:
        InvalidInput: it is not a valid direction, or the views do not show one.
    """
    up = frames.estimated_up(map_) if direction is None else direction
    return _moved(map_, frames.upward(up), CorrectionKind.UP, upright=True)


def set_distance(map_: Map, start: FloatArray, end: FloatArray, length_m: float) -> Map:
    """Two points (3,) of the present frame are ``length_m`` apart: the map takes that scale, and is metric.

    Raises:
        InvalidInput: the points are the same, or the length is absurd.
    """
    return _moved(map_, frames.measured(start, end, length_m), CorrectionKind.SCALE, metric=True)


def lay_over_plan(map_: Map, points: FloatArray, plan: FloatArray, scaled: bool) -> Map:
    """Points (N, 3) of the present frame come to lie over those of a floor plan (N, 2), in metres.

    Args:
        map_: the map.
        points: two or more.
        plan: as many.
        scaled: whether the map takes the plan's scale, and is metric; else two points fix where it lies and how it is
            turned.

    Raises:
        InvalidInput: there are too few, or they lie above each other.
        Conflict: the map is not upright.
    """
    if len(points) != len(plan) or not _MIN_PLAN_POINTS <= len(points) <= _MAX_PLAN_POINTS:
        raise InvalidInput(
            f"{len(points)} points of the map and {len(plan)} of the plan were given.",
            f"Give {_MIN_PLAN_POINTS} to {_MAX_PLAN_POINTS} pairs.",
        )
    similarity, missed_m = frames.laid_over(points, plan, scaled)
    return _moved(_upright(map_), similarity, CorrectionKind.PLAN, metric=scaled, residual_m=missed_m)


def remove_region(
    map_: Map, outline: FloatArray, bottom_m: float | None, top_m: float | None, keep_inside: bool
) -> Map:
    """The map without the landmarks within a region, or without those outside of it.

    Args:
        map_: the map.
        outline: (N, 2) the region's corners, seen from above.
        bottom_m, top_m: its lowest and highest z; None where it has none.
        keep_inside: whether what is outside goes.

    Raises:
        InvalidInput: the outline is not a valid polygon.
        Conflict: there is nothing to remove, or too little would be left.
    """
    landmarks, points = (
        in_region(positions, outline, bottom_m, top_m) for positions in (map_.landmarks.positions, map_.cloud.positions)
    )
    left = without_landmarks(map_, landmarks != keep_inside, points != keep_inside)
    return _cut(map_, left, CorrectionKind.REGION)


def remove_views(map_: Map, first: int, last: int) -> Map:
    """The map without its views ``first`` to ``last``, and without what only they saw.

    Raises:
        InvalidInput: there are no such views.
        Conflict: too little would be left.
    """
    return _cut(map_, without_views(map_, first, last), CorrectionKind.WALK)


def set_names(map_: Map, names: MapNames) -> Map:
    """The map with these names in place of those it has.

    Raises:
        InvalidInput: a name or an area is not valid.
    """
    named = replace(map_, info=replace(map_.info, names=check_names(names)))
    return replace(named, info=noted(named.info, _correction(map_.info, CorrectionKind.NAMES)))


def set_floor_plan(map_: Map, content: bytes, plan: FloorPlan | None) -> Map:
    """The map with a floor plan to be kept with it: the file's ``content``, and where it lies; or without, for None.

    Raises:
        TooLarge, InvalidInput: it cannot be kept.
    """
    kept = None if plan is None else check_plan(content, plan)
    planned = replace(map_, info=replace(map_.info, plan=kept), plan=content if kept else b"")
    return replace(planned, info=noted(planned.info, _correction(map_.info, CorrectionKind.FLOOR_PLAN)))


def set_labels(map_: Map, labels: MapLabels) -> Map:
    """The map with this site, floor and tags in place of its own.

    Raises:
        InvalidInput: one is not valid.
    """
    info = replace(map_.info, labels=check_labels(labels))
    return replace(map_, info=noted(info, _correction(map_.info, CorrectionKind.LABELS)))


def _moved(
    map_: Map,
    similarity: Similarity,
    kind: CorrectionKind,
    upright: bool = False,
    metric: bool = False,
    residual_m: float | None = None,
) -> Map:
    moved = move_map(map_, similarity)
    info = replace(moved.info, upright=moved.info.upright or upright, metric=moved.info.metric or metric)
    moved = replace(moved, info=info)
    rows = similarity.rotation.tolist()
    x, y, z = similarity.translation.tolist()
    correction = replace(
        _correction(map_.info, kind),
        scale=similarity.scale,
        rotation=tuple(tuple(row) for row in rows),
        translation=(x, y, z),
        residual_m=residual_m,
    )
    return as_corrected(map_, moved, correction)


def _cut(before: Map, after: Map, kind: CorrectionKind) -> Map:
    removed = replace(
        _correction(before.info, kind),
        landmarks_removed=len(before) - len(after),
        views_removed=len(before.views) - len(after.views),
    )
    return as_corrected(before, after, removed)


def _correction(info: MapInfo, kind: CorrectionKind) -> Correction:
    return Correction(info.version + 1, kind, datetime.now(UTC).isoformat(timespec="seconds"))


def _upright(map_: Map) -> Map:
    if not map_.info.upright:
        raise Conflict("The map is not upright: z does not point up.", "Correct which direction is up first.")
    return map_
