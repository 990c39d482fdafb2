"""A map's description: its sources, its report, and what people corrected in it."""

import json
import math
from dataclasses import dataclass, field
from enum import StrEnum

from rholoc.density import DensityKind
from rholoc.errors import InvalidInput, InvalidMap
from rholoc.geometry import Camera
from rholoc.maps.floor_plan import FloorPlan
from rholoc.maps.place_names import MapLabels, MapNames
from rholoc.maps.sites import SiteOnEarth, check_earth
from rholoc.reports import MapReport, report_from_json, report_to_json

_MAX_LENGTH = 2**24
_MAX_WORD = 64
_MAX_SHOWN = 300


class CorrectionKind(StrEnum):
    """Kind of a correction."""

    ORIGIN = "origin"  # the point (0, 0, 0)
    NORTH = "north"  # the direction of y
    WALL = "wall"  # a wall along x
    UP = "up"  # the direction of z
    SCALE = "scale"  # the unit of length
    PLAN = "plan"  # the map aligned with a floor plan, by points of both
    REGION = "region"  # landmarks of a region removed
    WALK = "walk"  # a piece of a walk removed
    NAMES = "names"  # names of points and areas
    FLOOR_PLAN = "floor-plan"  # the floor plan that the map keeps
    EARTH = "earth"  # the pose on Earth
    LABELS = "labels"  # site, floor and tags of the map


@dataclass(frozen=True)
class Correction:
    """One correction, which made a new version of a map.

    If it moved the map's frame, a point x of the previous version is now at ``scale`` · ``rotation`` x +
    ``translation``; otherwise these are None.

    Attributes:
        version: of the map.
        kind: what was corrected.
        created: ISO 8601 time, UTC.
        scale: of lengths.
        rotation: (3, 3), rows.
        translation: (3,) metres.
        residual_m: RMS distance between the map's and the floor plan's points, or the places on Earth.
        landmarks_removed, views_removed: their numbers.
    """

    version: int
    kind: CorrectionKind
    created: str
    scale: float | None = None
    rotation: tuple[tuple[float, float, float], ...] | None = None
    translation: tuple[float, float, float] | None = None
    residual_m: float | None = None
    landmarks_removed: int = 0
    views_removed: int = 0


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
    """The number that a text of JSON says. Raises ValueError if it is not finite."""
    value = float(text)
    if not math.isfinite(value):
        raise ValueError("it has a number that is not finite")
    return value
