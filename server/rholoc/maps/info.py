"""A map's description: its sources and its report."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field

from rholoc.density import DensityKind
from rholoc.errors import InvalidInput, InvalidMap
from rholoc.geometry import Camera
from rholoc.maps.correction_record import Correction
from rholoc.maps.floor_plan import FloorPlan
from rholoc.maps.place_names import MapLabels, MapNames
from rholoc.maps.sites import SiteOnEarth, check_earth
from rholoc.reports import MapReport, report_from_json, report_to_json

_MAX_LENGTH = 2**24
_MAX_WORD = 64
_MAX_SHOWN = 300


@dataclass(frozen=True)
class Source:
    """A recording, or a table, that a map was made from.

    Attributes:
        name: its name.
        id: distinguishes it from other recordings, 16 hex digits.
        camera: its intrinsics.
        frames: number of frames.
        posed: number of frames with a pose.
        views: number of views of the map among them.
        held_out: number of frames held out for the report.
        poses: source of the poses: a pose method, or ``localized`` in the map.
    """

    name: str
    id: str | None = None
    camera: Camera | None = None
    frames: int | None = None
    posed: int | None = None
    views: int | None = None
    held_out: int | None = None
    poses: str | None = None


@dataclass(frozen=True)
class MapWaypoint:
    """A measured point of a map's recordings.

    Attributes:
        name: its name.
        position: (3,) metres, map frame.
        residual_m: distance of the trajectory from it; None if unknown.
    """

    name: str
    position: tuple[float, float, float]
    residual_m: float | None = None


@dataclass(frozen=True)
class MapInfo:
    """Description of a map.

    Attributes:
        id: unique for each built map, 32 hex digits.
        version: 1 for a new map, increased by every update.
        density: the form of its densities.
        features: the extractor's name.
        metric: whether the unit of length is the metre, not arbitrary; every answer says so.
        upright: whether z points up.
        created: when this version was made, ISO 8601, UTC.
        camera: the intrinsics of the first recording.
        sources: recordings or tables that it was made from.
        waypoints: measured points.
        names: of points and areas.
        labels: site, floor and tags.
        plan: its floor plan, if any.
        earth: pose of its frame on Earth, if known.
        corrections: by people since it was built, by version.
        report: figures from its construction.
    """

    id: str
    version: int
    density: DensityKind
    features: str
    metric: bool
    upright: bool
    created: str
    camera: Camera
    sources: tuple[Source, ...] = ()
    waypoints: tuple[MapWaypoint, ...] = ()
    names: MapNames = field(default_factory=MapNames)
    labels: MapLabels = field(default_factory=MapLabels)
    plan: FloorPlan | None = None
    earth: SiteOnEarth | None = None
    corrections: tuple[Correction, ...] = ()
    report: MapReport = field(default_factory=MapReport)


def info_to_json(info: MapInfo) -> str:
    """The description as JSON text; numbers that are not finite become null."""
    return json.dumps(report_to_json(info), ensure_ascii=False, allow_nan=False, separators=(",", ":"), sort_keys=True)


def info_from_json(text: str) -> MapInfo:
    """The description that :func:`info_to_json` wrote; unknown members are ignored.

    Raises:
        InvalidMap: not JSON, longer than 16 MiB, a member is missing or of another type, a number is not finite, the
            id, time or features are not 1 to 64 printable characters, or a camera or the pose on Earth is impossible.
    """
    try:
        if len(text) > _MAX_LENGTH:
            raise ValueError(f"it is longer than {_MAX_LENGTH} characters")
        info = report_from_json(MapInfo, json.loads(text, parse_constant=_finite, parse_float=_finite))
        if info.earth is not None:
            check_earth(info.earth)
        for name in ("id", "created", "features"):
            value = getattr(info, name)
            if not 0 < len(value) <= _MAX_WORD or not value.isprintable():
                raise ValueError(f"{name} is not a word of at most {_MAX_WORD} characters")
    except (ValueError, InvalidInput, RecursionError) as error:
        raise InvalidMap(f"The map's description is not valid: {str(error)[:_MAX_SHOWN]}.") from error
    return info


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError("it has a number that is not finite")
    return value
