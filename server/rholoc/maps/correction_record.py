"""Corrections of a map by people after it was built."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


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
        residual_m: RMS distance between the map's and the floor plan's points.
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
