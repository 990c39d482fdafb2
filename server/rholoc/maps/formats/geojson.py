"""Named points and areas as GeoJSON (RFC 7946), in both directions."""

import json
from collections.abc import Iterator, Mapping
from typing import Any, TypeGuard

import numpy as np

from rholoc.errors import InvalidInput
from rholoc.geometry import FloatArray
from rholoc.geometry.earth import EarthPlace, enu_of
from rholoc.maps.place_names import FieldValue, MapNames, NamedArea, NamedPoint, check_names
from rholoc.maps.sites import SiteOnEarth

MAX_GEOJSON_BYTES = 8 * 2**20
_MAP_FRAME = "map"  # the member "frame" of a collection whose coordinates are metres of the map
_DIGITS = 10  # of degrees: 0.01 mm
_MILLIMETRES = 6  # digits of a metre
_MAX_M = 1e6
_MAX_NUMBER = 1e9  # of a coordinate: JSON's integers have no bound


def names_to_geojson(names: MapNames, earth: SiteOnEarth | None) -> dict[str, Any]:
    """Names of a map as a FeatureCollection.

    Coordinates are longitude, latitude and, for points only, height of WGS 84. Without a pose on Earth they are metres
    in the map frame, and the collection's member ``frame`` is ``map``.
    """
    features = [
        _feature(one, {"type": "Point", "coordinates": _coordinates(one.position, earth)}) for one in names.points
    ]
    for area in names.areas:
        outline = np.array(area.outline)
        x, y = outline.T
        left_handed = x @ np.roll(y, -1) < y @ np.roll(x, -1)
        corners = [*(outline[::-1] if left_handed else outline).tolist()]
        ring = [_coordinates((*corner, 0.0), earth)[:2] for corner in [*corners, corners[0]]]
        features.append(_feature(area, {"type": "Polygon", "coordinates": [ring]}))
    frame = {} if earth is not None else {"frame": _MAP_FRAME}
    return {"type": "FeatureCollection", **frame, "features": features}


def names_from_geojson(content: bytes, earth: SiteOnEarth | None) -> MapNames:
    """Names of a map from GeoJSON: points and polygons with a ``name`` among their properties.

    ``kind``, or without it IMDF's ``category``, becomes the kind; other plain properties become fields. Features of
    IMDF without a name are left out.

    Args:
        content: a FeatureCollection or a Feature in UTF-8, of WGS 84, or of the map frame if its ``frame`` is ``map``.
        earth: the map's pose on Earth, if known.

    Raises:
        InvalidInput: not GeoJSON, a feature cannot be kept or is over 1000 km away, or the pose on Earth is needed and
            not known.
    """
    document = read_geojson(content)
    in_map = document.get("frame") == _MAP_FRAME
    if not in_map and earth is None:
        raise InvalidInput(
            "The map's pose on Earth is unknown, so longitude and latitude cannot be converted.",
            'Place it on Earth first, or send metres of the map with "frame": "map" beside "type".',
        )
    place = None if in_map else earth
    points, areas = [], []
    for feature in features_of(document):
        name, kind, fields = _properties(feature)
        if not name and "feature_type" in feature:
            continue
        geometry, what = feature.get("geometry") or {}, f"The feature {name[:60] or 'without a name'}"
        match geometry.get("type"):
            case "Point":
                x, y, z = _metres(geometry.get("coordinates"), place, what)
                points.append(NamedPoint(name, (x, y, z), kind, fields))
            case "Polygon" | "MultiPolygon":
                corners = [_metres(one, place, what)[:2] for one in _ring(geometry, what)]
                areas.append(NamedArea(name, tuple(corners), kind, fields))
            case other:
                raise InvalidInput(f"{what} is a {str(other)[:30]}.", "Send points and polygons.")
    return check_names(MapNames(tuple(points), tuple(areas)))


def read_geojson(content: bytes) -> dict[str, Any]:
    """GeoJSON in UTF-8 as a dictionary.

    Raises:
        InvalidInput: it is no JSON object, or has a number that is not finite.
    """
    try:
        document = json.loads(content, parse_constant=_refuse)
    except (ValueError, RecursionError) as error:
        raise InvalidInput("The GeoJSON is not valid JSON.", "Send it as it was written, in UTF-8.") from error
    if not isinstance(document, dict):
        raise InvalidInput("GeoJSON is an object with a type.", "Send a FeatureCollection.")
    return document


def features_of(document: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The features of a FeatureCollection or of a single Feature.

    Raises:
        InvalidInput: the document is something else, or a feature is not an object.
    """
    found = [document] if document.get("type") == "Feature" else document.get("features")
    if document.get("type") not in ("Feature", "FeatureCollection") or not isinstance(found, list):
        raise InvalidInput("The GeoJSON is not a collection of features.", "Send a FeatureCollection.")
    members = ("geometry", "properties")
    if not all(isinstance(one, dict) and all(isinstance(one.get(key) or {}, dict) for key in members) for one in found):
        raise InvalidInput("The GeoJSON has a feature that is none.", "Give each a geometry and properties.")
    return found


def positions_of(node: Any) -> Iterator[tuple[float, float]]:
    """Iterate over the first two coordinates of all positions in a GeoJSON object, in no particular order."""
    waiting = [node]
    while waiting:
        one = waiting.pop()
        if isinstance(one, Mapping):
            waiting.extend(one.get(member) for member in ("features", "geometries", "geometry", "coordinates"))
        elif _is_position(one):
            yield float(one[0]), float(one[1])
        elif isinstance(one, list):
            waiting.extend(one)


def _feature(one: NamedPoint | NamedArea, geometry: dict[str, Any]) -> dict[str, Any]:
    """GeoJSON feature with the name, kind and fields of a point or area as properties."""
    return {
        "type": "Feature",
        "geometry": geometry,
        "properties": {"name": one.name, "kind": one.kind, **one.fields},
    }


def _coordinates(position: tuple[float, float, float], earth: SiteOnEarth | None) -> list[float]:
    """Longitude, latitude [°] and height [m]; without ``earth`` the position itself [m]."""
    if earth is None:
        return [round(value, _MILLIMETRES) for value in position]
    place = earth.place(np.array(position))
    return [
        round(place.longitude_deg, _DIGITS),
        round(place.latitude_deg, _DIGITS),
        round(place.height_m, _MILLIMETRES),
    ]


def _metres(position: object, earth: SiteOnEarth | None, what: str) -> tuple[float, float, float]:
    """Convert a position of GeoJSON to the map frame [m].

    It is longitude, latitude and height, or metres in the map frame if ``earth`` is None. Without a height it is at the
    height of the map's origin. Raises InvalidInput, naming the feature ``what``, if it is not a position, not on Earth,
    or over 1000 km away.
    """
    if not _is_position(position):
        raise InvalidInput(f"{what} has no valid coordinates.", "Positions are two or three numbers.")
    values = [float(value) for value in position[:3]]
    if earth is not None and not (abs(values[0]) <= 180 and abs(values[1]) <= 90):
        raise InvalidInput(
            f"{what} is not on Earth: its coordinates are not longitude and latitude.",
            'For metres of the map, write "frame": "map" beside "type".',
        )
    x, y, z = np.array([*values, 0.0][:3]) if earth is None else _in_frame(values, earth)
    if max(abs(x), abs(y), abs(z)) > _MAX_M:
        raise InvalidInput(f"{what} is further than {_MAX_M / 1000:g} km from the map.", "Check its coordinates.")
    return float(x), float(y), float(z)


def _in_frame(values: list[float], earth: SiteOnEarth) -> FloatArray:
    """Position (3,) [m] in the map or site's frame, of longitude, latitude [°] and perhaps height [m]."""
    height_m = values[2] if len(values) > 2 else earth.height_m
    return np.asarray(earth.R_enu_site.T @ enu_of(EarthPlace(values[1], values[0], height_m), earth.origin))


def _ring(geometry: Mapping[str, Any], what: str) -> list[Any]:
    """The corners of a polygon's only ring, each once. Raises InvalidInput, naming ``what``, for several rings."""
    rings = geometry.get("coordinates")
    if geometry.get("type") == "MultiPolygon" and isinstance(rings, list) and len(rings) == 1:
        rings = rings[0]
    if not isinstance(rings, list) or len(rings) != 1 or not isinstance(rings[0], list):
        raise InvalidInput(f"{what} is not one outline.", "Send polygons without holes, each as a feature of its own.")
    ring = rings[0]
    return ring[:-1] if len(ring) > 1 and ring[0] == ring[-1] else ring


def _properties(feature: Mapping[str, Any]) -> tuple[str, str, dict[str, FieldValue]]:
    """Name, kind (empty if there is none) and fields of a feature; properties that are lists or objects are ignored."""
    properties = feature.get("properties") or {}
    kind_key = "kind" if "kind" in properties else "category"
    fields = {
        key: value
        for key, value in properties.items()
        if key not in ("name", kind_key) and (value is None or isinstance(value, str | int | float))
    }
    return plain_label(properties.get("name")), str(properties.get(kind_key) or ""), fields


def plain_label(label: object) -> str:
    """Text of a label of GeoJSON or IMDF; of texts by language the English one, else the first. Empty for None."""
    if isinstance(label, dict):
        label = label.get("en") or next(iter(label.values()), None)
    return "" if label is None else str(label)


def _is_position(value: object) -> TypeGuard[list[float]]:
    """Whether a value of JSON is a list of two or more numbers, each below 1e9 in magnitude."""
    return (
        isinstance(value, list)
        and len(value) >= 2
        and all(isinstance(one, int | float) and not isinstance(one, bool) and abs(one) < _MAX_NUMBER for one in value)
    )


def _refuse(text: str) -> float:
    """Raise ValueError: for a number such as NaN."""
    raise ValueError(text)
