"""Applies corrections, as a client sends them, to a map."""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from rholoc.errors import Conflict, InvalidInput
from rholoc.geometry import FloatArray
from rholoc.geometry.earth import EarthPlace, places_in
from rholoc.mapping.edit import correcting
from rholoc.maps import Map, MapLabels, MapNames, NamedArea, NamedPoint
from rholoc.service.http.models import Number, RequestModel, Vector2, Vector3

_FARTHEST_M = 1e6  # coordinates beyond it are refused


class _CorrectionIn(RequestModel):
    version: int | None = Field(
        default=None,
        description="the version to correct: if it is no longer the present one, nothing changes",
    )


class OriginIn(_CorrectionIn):
    """A point becomes the origin."""

    kind: Literal["origin"]
    at: Vector3 = Field(description="m, present frame")


class NorthIn(_CorrectionIn):
    """A direction, seen from above, becomes y; the map turns about its origin."""

    kind: Literal["north"]
    direction: Vector3 = Field(description="present frame; its length does not matter")


class WallIn(_CorrectionIn):
    """A direction along a wall, seen from above, becomes x; the map turns about its origin."""

    kind: Literal["wall"]
    direction: Vector3 = Field(description="present frame; its length does not matter")


class UpIn(_CorrectionIn):
    """A direction becomes z, and the map upright."""

    kind: Literal["up"]
    direction: Vector3 | None = Field(
        default=None, description="present frame; default: the direction that the map's views hold upright"
    )


class ScaleIn(_CorrectionIn):
    """A measured distance between two points: the map takes that scale, and is metric from then on."""

    kind: Literal["scale"]
    start: Vector3 = Field(description="present frame")
    end: Vector3 = Field(description="present frame")
    length_m: Number = Field(gt=0, description="the measured distance between them, m")


class PlanPoint(RequestModel):
    """A point of the map, and where it is on a floor plan."""

    map: Vector3 = Field(description="present frame")
    plan: Vector2 = Field(description="m, in the plan's frame: x and y")


class PlanIn(_CorrectionIn):
    """The map is aligned with a floor plan, whose frame becomes the map's; heights stay."""

    kind: Literal["plan"]
    points: list[PlanPoint] = Field(description="two pairs or more")
    scaled: bool = Field(default=False, description="whether the map takes the plan's scale, and is metric")


class RegionIn(_CorrectionIn):
    """The landmarks inside a region are removed, or all others."""

    kind: Literal["region"]
    outline: list[Vector2] = Field(description="its corners, seen from above, m: 3 to 200")
    bottom_m: Number | None = Field(default=None, description="its lowest z; default: no bound")
    top_m: Number | None = Field(default=None, description="its highest z; default: no bound")
    keep: Literal["inside", "outside"] = Field(description="what stays")


class WalkIn(_CorrectionIn):
    """A piece of a walk is removed: its views, and the landmarks that only they saw."""

    kind: Literal["walk"]
    first_view: int = Field(description="its first view, by number in the map, from 0")
    last_view: int = Field(description="its last view, inclusive")


class _NamedIn(RequestModel):
    name: str
    kind: str = Field(default="", description="such as door or room")
    fields: dict[str, str | int | Number | bool | None] = Field(
        default_factory=dict, description="anything else about it, by name: text, numbers, true, false, null"
    )


class NamedPointIn(_NamedIn):
    """A point with a name."""

    position: Vector3 = Field(description="m")


class NamedAreaIn(_NamedIn):
    """An area with a name, seen from above; areas may overlap."""

    outline: list[Vector2] = Field(description="its corners in order, m: 3 to 200")


class NamesIn(_CorrectionIn):
    """Names of points and areas, replacing those that the map has."""

    kind: Literal["names"]
    points: list[NamedPointIn] = Field(default_factory=list)
    areas: list[NamedAreaIn] = Field(default_factory=list)


class EarthPoint(RequestModel):
    """A point of the map, and where it is on Earth: WGS 84, or in the correction's `crs`."""

    map: Vector3 = Field(description="present frame")
    latitude_deg: Number | None = Field(default=None, description="WGS 84, without `crs`")
    longitude_deg: Number | None = Field(default=None, description="WGS 84, without `crs`")
    easting: Number | None = Field(default=None, description="in `crs`, in its unit")
    northing: Number | None = Field(default=None, description="in `crs`, in its unit")
    height_m: Number = Field(default=0.0, description="above the ellipsoid, or as `crs` counts heights")


class EarthIn(_CorrectionIn):
    """The map is placed on Earth by two points or more, or by one and a heading; its frame stays as it is."""

    kind: Literal["earth"]
    points: list[EarthPoint] = Field(min_length=1, max_length=100)
    heading_deg: Number | None = Field(
        default=None, description="of the map's y axis: degrees from true north, clockwise; default: by the points"
    )
    crs: str | None = Field(
        default=None,
        description="EPSG code of a national grid, with that of heights above the sea after a plus sign, such as "
        "EPSG:25833+7837; default: WGS 84, heights above the ellipsoid",
    )


class LabelsIn(_CorrectionIn):
    """The map's site, floor and tags, replacing those that it has."""

    kind: Literal["labels"]
    site: str = Field(default="", description="such as a building")
    floor: str = Field(default="", description="of the site")
    tags: list[str] = Field(default_factory=list, description="further words; 20 at most")


CorrectionIn = Annotated[
    OriginIn | NorthIn | WallIn | UpIn | ScaleIn | PlanIn | RegionIn | WalkIn | NamesIn | EarthIn | LabelsIn,
    Field(discriminator="kind"),
]


def corrected_map(map_: Map, wanted: CorrectionIn) -> Map:
    """The map's next version; ``map_`` stays as it is.

    Raises:
        Conflict: the map has another version by now, or the correction does not fit it.
        InvalidInput: a value of the correction is not valid.
    """
    if wanted.version not in (None, map_.info.version):
        raise Conflict(
            f"The map is now at version {map_.info.version}, not {wanted.version}.",
            "Fetch it again and repeat the correction.",
        )
    match wanted:
        case OriginIn():
            return correcting.set_origin(map_, _vector(wanted.at))
        case NorthIn():
            return correcting.set_north(map_, _vector(wanted.direction))
        case WallIn():
            return correcting.set_wall(map_, _vector(wanted.direction))
        case UpIn():
            return correcting.set_up(map_, None if wanted.direction is None else _vector(wanted.direction))
        case ScaleIn():
            return correcting.set_distance(map_, _vector(wanted.start), _vector(wanted.end), wanted.length_m)
        case PlanIn():
            points = _vector([pair.map for pair in wanted.points]).reshape(-1, 3)
            plan = _vector([pair.plan for pair in wanted.points]).reshape(-1, 2)
            return correcting.lay_over_plan(map_, points, plan, wanted.scaled)
        case RegionIn():
            outline = _vector(wanted.outline).reshape(-1, 2)
            inside = wanted.keep == "inside"
            return correcting.remove_region(map_, outline, wanted.bottom_m, wanted.top_m, keep_inside=inside)
        case WalkIn():
            return correcting.remove_views(map_, wanted.first_view, wanted.last_view)
        case NamesIn():
            return correcting.set_names(map_, _names(wanted))
        case EarthIn():
            points = _vector([one.map for one in wanted.points]).reshape(-1, 3)
            return correcting.set_earth(map_, points, _places(wanted), wanted.heading_deg)
        case LabelsIn():
            return correcting.set_labels(map_, MapLabels(wanted.site, wanted.floor, tuple(wanted.tags)))


def _places(wanted: EarthIn) -> list[EarthPlace]:
    """The points' places on Earth, converted from ``crs`` if given. Raises InvalidInput if one is incomplete."""
    first, second = ("latitude_deg", "longitude_deg") if wanted.crs is None else ("easting", "northing")
    given = [(getattr(one, first), getattr(one, second), one.height_m) for one in wanted.points]
    if any(None in one for one in given):
        where = "WGS 84" if wanted.crs is None else wanted.crs
        raise InvalidInput(f"A point has no place in {where}.", f"Give each {first} and {second}.")
    return [EarthPlace(*one) for one in given] if wanted.crs is None else places_in(wanted.crs, np.array(given))


def _names(wanted: NamesIn) -> MapNames:
    """The names as the map keeps them, not checked but for their coordinates."""
    points, areas = [], []
    for point in wanted.points:
        x, y, z = _vector(point.position).tolist()
        points.append(NamedPoint(point.name, (x, y, z), point.kind, point.fields))
    for area in wanted.areas:
        outline = _vector(area.outline).reshape(-1, 2).tolist()
        areas.append(NamedArea(area.name, tuple((x, y) for x, y in outline), area.kind, area.fields))
    return MapNames(tuple(points), tuple(areas))


def _vector(numbers: list[float] | list[list[float]]) -> FloatArray:
    """Coordinates as an array of the lists' shape. Raises InvalidInput: one is NaN or beyond ±1e6."""
    array = np.array(numbers, dtype=np.float64)
    if not np.all(np.abs(array) <= _FARTHEST_M):
        raise InvalidInput(
            f"A coordinate is beyond {_FARTHEST_M:g} m.", "Coordinates are in metres, in the map's frame."
        )
    return array
