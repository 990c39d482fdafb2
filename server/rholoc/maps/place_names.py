"""Names of a map's points and areas, and labels of the map."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from rholoc.errors import InvalidInput
from rholoc.geometry import BoolArray, FloatArray
from rholoc.reports.json_values import check_json_value

MAX_NAMES = 500
MAX_CORNERS = 200
MAX_TAGS = 20
_MAX_FIELDS = 50
_MAX_LENGTH = 100
_MAX_VALUE_LENGTH = 1000
_MIN_CORNERS = 3

FieldValue = str | int | float | bool | None


@dataclass(frozen=True)
class NamedPoint:
    """A point with a name.

    Attributes:
        name: what it is called.
        position: (3,) metres, map frame.
        kind: such as "door"; empty if not given.
        fields: anything else about it, by name.
    """

    name: str
    position: tuple[float, float, float]
    kind: str = ""
    fields: Mapping[str, FieldValue] = field(default_factory=dict)


@dataclass(frozen=True)
class NamedArea:
    """An area with a name, seen from above.

    Attributes:
        name: what it is called.
        outline: (N, 2) corners in order, x and y, metres, map frame; the last is joined to the first.
        kind: such as "room"; empty if not given.
        fields: anything else about it, by name.
    """

    name: str
    outline: tuple[tuple[float, float], ...]
    kind: str = ""
    fields: Mapping[str, FieldValue] = field(default_factory=dict)


@dataclass(frozen=True)
class MapNames:
    """All names of a map.

    Attributes:
        points: such as a door or a charging station.
        areas: such as a room; they may overlap.
    """

    points: tuple[NamedPoint, ...] = field(default=())
    areas: tuple[NamedArea, ...] = field(default=())


@dataclass(frozen=True)
class MapLabels:
    """Labels by which lists of maps are grouped and searched.

    Attributes:
        site: such as a building; empty if not given.
        floor: of the site; empty if not given.
        tags: further words.
    """

    site: str = ""
    floor: str = ""
    tags: tuple[str, ...] = ()


def areas_at(names: MapNames, position: FloatArray) -> tuple[str, ...]:
    """Names of the areas that a position (3,) is in, seen from above, the smallest area first."""
    inside = [
        area for area in names.areas if within_outline(position[None, :2], np.array(area.outline, dtype=np.float64))[0]
    ]
    return tuple(area.name for area in sorted(inside, key=lambda area: _enclosed(np.array(area.outline))))


def points_near(names: MapNames, position: FloatArray, within_m: float) -> tuple[str, ...]:
    """The names of the points within ``within_m`` of a position (3,), the nearest first."""
    apart = {one.name: float(np.linalg.norm(np.array(one.position) - position)) for one in names.points}
    return tuple(sorted((name for name in apart if apart[name] <= within_m), key=apart.__getitem__))


def within_outline(positions: FloatArray, outline: FloatArray) -> BoolArray:
    """Mask (N,) of the positions (N, 2) within an outline (M, 2), by the even-odd rule."""
    x, y = positions.T
    inside = np.zeros(len(positions), dtype=bool)
    for (ax, ay), (bx, by) in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        crosses = (ay > y) != (by > y)
        with np.errstate(divide="ignore", invalid="ignore"):
            inside ^= crosses & (x < (bx - ax) * (y - ay) / (by - ay) + ax)
    return inside


def check_labels(labels: MapLabels) -> MapLabels:
    """Return the labels, stripped of surrounding spaces and checked.

    Raises:
        InvalidInput: over 20 tags; one is empty or given twice; or something is over 100 characters or not printable.
    """
    tags = tuple(tag.strip() for tag in labels.tags)
    if len(tags) > MAX_TAGS or len(set(tags)) < len(tags) or not all(tags):
        raise InvalidInput("The tags are not valid.", f"Give at most {MAX_TAGS}, each once, and none empty.")
    cleaned = MapLabels(labels.site.strip(), labels.floor.strip(), tags)
    for text in (cleaned.site, cleaned.floor, *tags):
        if len(text) > _MAX_LENGTH or (text and not text.isprintable()):
            raise InvalidInput(
                f"{text[:_MAX_LENGTH]!r} is not a valid label.", f"Use at most {_MAX_LENGTH} characters."
            )
    return cleaned


def check_names(names: MapNames) -> MapNames:
    """Return the names, checked.

    Raises:
        InvalidInput: there are over 500 names; a name is empty, over 100 characters or not printable; two points or two
            areas have the same name; a kind, a field or an outline is not valid.
    """
    if len(names.points) + len(names.areas) > MAX_NAMES:
        raise InvalidInput(f"A map keeps at most {MAX_NAMES} names.", "Leave some out.")
    for kind, all_names in (("point", names.points), ("area", names.areas)):
        seen: set[str] = set()
        for one in all_names:
            if not 0 < len(one.name.strip()) <= _MAX_LENGTH or not one.name.isprintable():
                raise InvalidInput(
                    f"{one.name[:_MAX_LENGTH]!r} is not a valid name.", f"Use 1 to {_MAX_LENGTH} characters."
                )
            if one.name in seen:
                raise InvalidInput(f"Two {kind}s are named {one.name}.", "Give each a name of its own.")
            seen.add(one.name)
            _check_details(one)
    for area in names.areas:
        check_outline(np.array(area.outline, dtype=np.float64), f"The area {area.name}")
    return names


def _check_details(one: NamedPoint | NamedArea) -> None:
    """Raise InvalidInput for an invalid kind (over 100 characters), over 50 fields, or a field that cannot be kept."""
    if len(one.kind) > _MAX_LENGTH or (one.kind and not one.kind.isprintable()):
        raise InvalidInput(f"The kind of {one.name} is not valid.", f"Use at most {_MAX_LENGTH} characters.")
    if len(one.fields) > _MAX_FIELDS:
        raise InvalidInput(f"{one.name} has {len(one.fields)} fields.", f"Give at most {_MAX_FIELDS}.")
    for key, value in one.fields.items():
        if not 0 < len(key) <= _MAX_LENGTH or not key.isprintable() or key in ("name", "kind"):
            raise InvalidInput(
                f"{key[:_MAX_LENGTH]!r} of {one.name} is not a valid field.", f"Use 1 to {_MAX_LENGTH} characters."
            )
        try:
            check_json_value(value)
        except ValueError as error:
            raise InvalidInput(
                f"The field {key} of {one.name} holds {error}.", "Use text and finite numbers."
            ) from error
        if isinstance(value, str) and len(value) > _MAX_VALUE_LENGTH:
            raise InvalidInput(
                f"The field {key} of {one.name} is too long.", f"Use at most {_MAX_VALUE_LENGTH} characters."
            )


def check_outline(outline: FloatArray, what: str) -> FloatArray:
    """Return the corners (N, 2) of an area, checked; error messages call it ``what``.

    Raises:
        InvalidInput: there are fewer than 3 or more than 200 corners, or they enclose nothing.
    """
    if not _MIN_CORNERS <= len(outline) <= MAX_CORNERS:
        raise InvalidInput(f"{what} has {len(outline)} corners.", f"Give {_MIN_CORNERS} to {MAX_CORNERS}.")
    if not _enclosed(outline) > 0:
        raise InvalidInput(f"{what} encloses nothing.", "Give corners that do not lie on one line.")
    return outline


def _enclosed(outline: FloatArray) -> float:
    """Area enclosed by a polygon (N, 2), in the square of its unit, never negative."""
    x, y = (outline - outline.mean(axis=0)).T
    return abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1))) / 2
