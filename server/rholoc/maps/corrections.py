"""What people corrected in a map after it was built."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class CorrectionKind(StrEnum):
    """What was corrected."""

    ORIGIN = "origin"  # which point is (0, 0, 0)
    NORTH = "north"  # which direction is y
    WALL = "wall"  # along which wall x runs
    UP = "up"  # which direction is z
    SCALE = "scale"  # how long a metre is
    PLAN = "plan"  # the map aligned with a floor plan, by points of both
    REGION = "region"  # landmarks of a region removed
    WALK = "walk"  # a piece of a walk removed
    NAMES = "names"  # names of points and areas
    FLOOR_PLAN = "floor-plan"  # the floor plan that the map keeps
    LABELS = "labels"  # site, floor and tags of the map


@dataclass(frozen=True)
class Correction:
    """One correction, which made a version of a map.

    If the map's frame moved, a point x of the previous version is now at ``scale`` · ``rotation`` x + ``translation``;
    otherwise these are None.

    Attributes:
        version: of the map.
        kind: what was corrected.
        created: ISO 8601 time, UTC.
        scale: of lengths.
        rotation: (3, 3), rows.
        translation: (3,) metres.
        residual_m: how far the map's points are from the plan's, root mean square.
        landmarks_removed, views_removed: how many were removed.
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
