"""A floor plan that is kept with a map, and where it lies in the map's frame."""

from __future__ import annotations

import json
from dataclasses import dataclass

import numpy as np

from rholoc.errors import InvalidInput, TooLarge
from rholoc.geometry import Similarity

MAX_PLAN_BYTES = 8 * 2**20
GEOJSON = "application/geo+json"
_STARTS = {"image/png": b"\x89PNG\r\n\x1a\n", "image/jpeg": b"\xff\xd8\xff", "image/webp": b"RIFF"}
MEDIA_TYPES = (*_STARTS, GEOJSON)
_LEVEL = 1e-6  # how far the cosine of a tilt may be from one


@dataclass(frozen=True)
class FloorPlan:
    """What a floor plan is, and where it lies.

    Attributes:
        media_type: of its file, one of ``MEDIA_TYPES``.
        corner: (2,) where its lower left corner lies: x and y, metres, map frame.
        turn_deg: how far its lower edge is turned from the map's x towards y.
        m_per_unit: how long one unit of it is: a pixel, or a metre of GeoJSON.
    """

    media_type: str
    corner: tuple[float, float]
    turn_deg: float
    m_per_unit: float

    def moved(self, similarity: Similarity) -> FloorPlan | None:
        """The plan after the map's frame moved; None if that tilts the map, so that the plan is no longer level."""
        R = similarity.rotation
        if R[2, 2] < 1 - _LEVEL:
            return None
        x, y, _ = similarity.points(np.array([[*self.corner, 0.0]]))[0].tolist()
        turn = self.turn_deg + float(np.degrees(np.arctan2(R[1, 0], R[0, 0])))
        return FloorPlan(self.media_type, (x, y), turn, self.m_per_unit * similarity.scale)


def check_plan(content: bytes, plan: FloorPlan) -> FloorPlan:
    """The plan, if a map may keep it.

    Raises:
        TooLarge: it is longer than ``MAX_PLAN_BYTES``.
        InvalidInput: the file is not of its type, or its place is not valid.
    """
    if len(content) > MAX_PLAN_BYTES:
        raise TooLarge(f"The floor plan is longer than {MAX_PLAN_BYTES} bytes.", "Make the picture smaller.")
    if plan.media_type not in MEDIA_TYPES:
        raise InvalidInput(f"{plan.media_type[:50]} is not a floor plan.", f"Send one of {', '.join(MEDIA_TYPES)}.")
    if not (_is_geojson(content) if plan.media_type == GEOJSON else content.startswith(_STARTS[plan.media_type])):
        raise InvalidInput(f"The floor plan is not {plan.media_type}.", "Send the file as it is, with its own type.")
    if not (np.isfinite([*plan.corner, plan.turn_deg]).all() and np.isfinite(plan.m_per_unit) and plan.m_per_unit > 0):
        raise InvalidInput("The floor plan's place makes no sense.", "Give finite numbers, and a positive size.")
    return plan


def _is_geojson(content: bytes) -> bool:
    try:
        return isinstance(json.loads(content), dict)
    except (ValueError, RecursionError):
        return False
