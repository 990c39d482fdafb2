"""Applies corrections, as a client sends them, to a map."""

from __future__ import annotations

import numpy as np

from rholoc import mapping
from rholoc.errors import Conflict, InvalidInput
from rholoc.geometry import FloatArray
from rholoc.maps import Map, MapLabels, MapNames, NamedArea, NamedPoint
from rholoc.service.schemas import (
    CorrectionIn,
    LabelsIn,
    NamesIn,
    NorthIn,
    OriginIn,
    PlanIn,
    RegionIn,
    ScaleIn,
    UpIn,
    WalkIn,
    WallIn,
)

_FARTHEST_M = 1e6  # coordinates beyond it are refused


def corrected_map(map_: Map, wanted: CorrectionIn) -> Map:
    """The map's next version.

    Raises:
        Conflict: the map has another version by now, or the correction does not fit it.
        InvalidInput: the correction makes no sense.
    """
    if wanted.version not in (None, map_.info.version):
        raise Conflict(
            f"The map is now at version {map_.info.version}, not {wanted.version}.",
            "Fetch it again and repeat the correction.",
        )
    match wanted:
        case OriginIn():
            return mapping.set_origin(map_, _vector(wanted.at))
        case NorthIn():
            return mapping.set_north(map_, _vector(wanted.direction))
        case WallIn():
            return mapping.set_wall(map_, _vector(wanted.direction))
        case UpIn():
            return mapping.set_up(map_, None if wanted.direction is None else _vector(wanted.direction))
        case ScaleIn():
            return mapping.set_distance(map_, _vector(wanted.start), _vector(wanted.end), wanted.length_m)
        case PlanIn():
            points = _vector([pair.map for pair in wanted.points]).reshape(-1, 3)
            plan = _vector([pair.plan for pair in wanted.points]).reshape(-1, 2)
            return mapping.lay_over_plan(map_, points, plan, wanted.scaled)
        case RegionIn():
            outline = _vector(wanted.outline).reshape(-1, 2)
            inside = wanted.keep == "inside"
            return mapping.remove_region(map_, outline, wanted.bottom_m, wanted.top_m, keep_inside=inside)
        case WalkIn():
            return mapping.remove_views(map_, wanted.first_view, wanted.last_view)
        case NamesIn():
            return mapping.set_names(map_, _names(wanted))
        case LabelsIn():
            return mapping.set_labels(map_, MapLabels(wanted.site, wanted.floor, tuple(wanted.tags)))


def _names(wanted: NamesIn) -> MapNames:
    points, areas = [], []
    for point in wanted.points:
        x, y, z = _vector(point.position).tolist()
        points.append(NamedPoint(point.name, (x, y, z)))
    for area in wanted.areas:
        outline = _vector(area.outline).reshape(-1, 2).tolist()
        areas.append(NamedArea(area.name, tuple((x, y) for x, y in outline)))
    return MapNames(tuple(points), tuple(areas))


def _vector(numbers: list[float] | list[list[float]]) -> FloatArray:
    """Coordinates as an array.

    Raises:
        InvalidInput: one is out of range.
    """
    array = np.array(numbers, dtype=np.float64)
    if not np.all(np.abs(array) <= _FARTHEST_M):
        raise InvalidInput(
            f"A coordinate is beyond {_FARTHEST_M:g} m.", "Coordinates are in metres, in the map's frame."
        )
    return array
