"""Names that people gave to points and areas of a map."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from rholoc.errors import InvalidInput
from rholoc.geometry import FloatArray

MAX_NAMES = 500
MAX_CORNERS = 200
_MAX_LENGTH = 100
_MIN_CORNERS = 3


@dataclass(frozen=True)
class NamedPoint:
    """A point with a name.

    Attributes:
        name: what it is called.
        position: (3,) metres, map frame.
    """

    name: str
    position: tuple[float, float, float]


@dataclass(frozen=True)
class NamedArea:
    """An area with a name, seen from above.

    Attributes:
        name: what it is called.
        outline: (N, 2) corners in order, x and y, metres, map frame; the last is joined to the first.
    """

    name: str
    outline: tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class MapNames:
    """All names of a map.

    Attributes:
        points: such as a door or a charging station.
        areas: such as a room; they may overlap.
    """

    points: tuple[NamedPoint, ...] = field(default=())
    areas: tuple[NamedArea, ...] = field(default=())


def check_names(names: MapNames) -> MapNames:
    """The names, if a map may keep them.

    Raises:
        InvalidInput: there are too many; one is empty, too long, not printable or given twice; an area is not valid.
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
    for area in names.areas:
        check_outline(np.array(area.outline, dtype=np.float64), f"The area {area.name}")
    return names


def check_outline(outline: FloatArray, what: str) -> FloatArray:
    """The corners (N, 2) of an area, if they are those of one; ``what`` names it to users.

    Raises:
        InvalidInput: there are too few or too many corners, or they enclose nothing.
    """
    if not _MIN_CORNERS <= len(outline) <= MAX_CORNERS:
        raise InvalidInput(f"{what} has {len(outline)} corners.", f"Give {_MIN_CORNERS} to {MAX_CORNERS}.")
    x, y = (outline - outline.mean(axis=0)).T
    enclosed = abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1))) / 2
    if not enclosed > 0:
        raise InvalidInput(f"{what} encloses nothing.", "Give corners that do not lie on one line.")
    return outline
