"""Corrections of a map by people who know the place: frame, scale, removal of parts, names.

Each function returns the map's next version, with the correction recorded in ``info.corrections``.
"""

from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime

from rholoc.errors import Conflict, InvalidInput
from rholoc.geometry import FloatArray, Similarity
from rholoc.geometry.earth import EarthPlace
from rholoc.mapping.edit import frame_corrections as frames
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
    SiteOnEarth,
    check_earth,
    check_labels,
    check_names,
    check_plan,
)

_Y_DEG = 90.0
_MIN_PLAN_POINTS, _MAX_PLAN_POINTS = 2, 100


def set_origin(map_: Map, point: FloatArray) -> Map:
    """Next version of the map, its origin moved to ``point`` (3,) of the present frame.

    Raises:
        InvalidInput: a part of the map would be more than 10 km from its origin.
    """
    return _moved(map_, frames.origin_at(point), CorrectionKind.ORIGIN)


def set_north(map_: Map, direction: FloatArray) -> Map:
    """Next version of the map, rotated about its origin so that ``direction`` (3,), seen from above, becomes y.

    Raises:
        InvalidInput: the direction is too short, or within 3° of the vertical.
        Conflict: the map is not upright.
    """
    return _moved(_upright(map_), frames.level_direction(direction, _Y_DEG), CorrectionKind.NORTH)


def set_wall(map_: Map, direction: FloatArray) -> Map:
    """Next version of the map, rotated about its origin so that ``direction`` (3,), seen from above, becomes x.

    Raises:
        InvalidInput: the direction is too short, or within 3° of the vertical.
        Conflict: the map is not upright.
    """
    return _moved(_upright(map_), frames.level_direction(direction, 0.0), CorrectionKind.WALL)


def set_up(map_: Map, direction: FloatArray | None = None) -> Map:
    """Next version of the map, rotated so that ``direction`` (3,) becomes z; it is upright from then on.

    By default the up direction is estimated from its views.

    Raises:
        InvalidInput: the direction is shorter than 1e-6, or the views do not agree on one.
    """
    up = frames.estimated_up(map_) if direction is None else direction
    return _moved(map_, frames.upward(up), CorrectionKind.UP, upright=True)


def set_distance(map_: Map, start: FloatArray, end: FloatArray, length_m: float) -> Map:
    """Next version of the map, scaled so that points ``start`` (3,) and ``end`` (3,) are ``length_m`` apart; it is
    metric.

    Raises:
        InvalidInput: the points coincide, the scale is not within 1e-4 to 1e4, or the map gets too large.
    """
    return _moved(map_, frames.measured(start, end, length_m), CorrectionKind.SCALE, metric=True)


def lay_over_plan(map_: Map, points: FloatArray, plan: FloatArray, scaled: bool) -> Map:
    """Next version of the map, its points (N, 3) aligned with points (N, 2) [m] of a floor plan by least squares.

    Args:
        map_: the map.
        points: 2 to 100 points of the present frame, not all above each other.
        plan: the corresponding points of the plan.
        scaled: whether the map takes the plan's scale and becomes metric; heights are scaled, but not shifted.

    Raises:
        InvalidInput: other than 2 to 100 pairs, points above each other, or a scale outside 1e-4 to 1e4.
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
    """Next version of the map without the landmarks, cloud points and room surfaces inside a region, or without all
    others.

    Args:
        map_: the map.
        outline: (N, 2) corners of the region, seen from above, in the map's unit.
        bottom_m: lowest z of the region, in the map's unit; None for no bound.
        top_m: highest z of the region; None for no bound.
        keep_inside: whether to remove what is outside instead.

    Raises:
        InvalidInput: the outline is not a valid polygon.
        Conflict: there is no landmark to remove, or fewer than 12 would be left.
    """
    shown = (map_.landmarks.positions, map_.cloud.positions, map_.room.vertices.positions)
    removed = (in_region(positions, outline, bottom_m, top_m) != keep_inside for positions in shown)
    left = without_landmarks(map_, *removed)
    return _cut(map_, left, CorrectionKind.REGION)


def remove_views(map_: Map, first: int, last: int) -> Map:
    """Next version of the map without the views ``first`` to ``last`` (inclusive), and the landmarks that only they
    saw.

    Raises:
        InvalidInput: there are no such views.
        Conflict: no view, or fewer than 12 landmarks, would be left.
    """
    return _cut(map_, without_views(map_, first, last), CorrectionKind.WALK)


def set_names(map_: Map, names: MapNames) -> Map:
    """Next version of the map with ``names`` in place of all its names of points and areas.

    Raises:
        InvalidInput: a name or an area is invalid.
    """
    named = replace(map_, info=replace(map_.info, names=check_names(names)))
    return replace(named, info=noted(named.info, _correction(map_.info, CorrectionKind.NAMES)))


def set_floor_plan(map_: Map, content: bytes, plan: FloorPlan | None) -> Map:
    """Next version of the map with a floor plan, the file's ``content`` and its placement; with none if ``plan`` is
    None.

    Raises:
        TooLarge: the file is too large.
        InvalidInput: it is not a picture that can be shown, or its placement is invalid.
    """
    kept = None if plan is None else check_plan(content, plan)
    planned = replace(map_, info=replace(map_.info, plan=kept), plan=content if kept else b"")
    return replace(planned, info=noted(planned.info, _correction(map_.info, CorrectionKind.FLOOR_PLAN)))


def set_earth(map_: Map, points: FloatArray, places: Sequence[EarthPlace], heading_deg: float | None) -> Map:
    """Next version of the map with a pose on Earth, from points (N, 3) [m] in the map frame and their N ``places``.

    ``heading_deg`` is the direction of y, clockwise from true north; with None, at least two points determine it.

    Raises:
        InvalidInput: as :meth:`SiteOnEarth.through`, or a number is out of range.
        Conflict: the map is not upright, or not metric.
    """
    if not _upright(map_).info.metric:
        raise Conflict("The map's unit of length is not the metre.", "Correct its scale first.")
    for place in places:
        check_earth(SiteOnEarth(place.latitude_deg, place.longitude_deg, place.height_m, heading_deg or 0.0))
    earth, missed_m = SiteOnEarth.through(points, places, heading_deg)
    correction = replace(_correction(map_.info, CorrectionKind.EARTH), residual_m=missed_m)
    return replace(map_, info=noted(replace(map_.info, earth=earth), correction))


def set_labels(map_: Map, labels: MapLabels) -> Map:
    """Next version of the map with other labels: site, floor and tags.

    Raises:
        InvalidInput: over 20 tags, an empty or repeated one, or a text over 100 characters or not printable.
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
    """Next version of the map, moved; ``upright`` and ``metric`` are set if True. The correction has ``residual_m``."""
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
    """``after`` as the next version of ``before``, with the numbers of removed landmarks and views noted."""
    removed = replace(
        _correction(before.info, kind),
        landmarks_removed=len(before) - len(after),
        views_removed=len(before.views) - len(after.views),
    )
    return as_corrected(before, after, removed)


def _correction(info: MapInfo, kind: CorrectionKind) -> Correction:
    """Correction of this kind, made now, that leads to the version after that of ``info``; it has no figures yet."""
    return Correction(info.version + 1, kind, datetime.now(UTC).isoformat(timespec="seconds"))


def _upright(map_: Map) -> Map:
    """The map itself. Raises Conflict if it is not upright."""
    if not map_.info.upright:
        raise Conflict("The map is not upright: z does not point up.", "Correct which direction is up first.")
    return map_
